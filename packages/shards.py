"""Build hook of the data packages: puts the shards of a track into its wheel, named by sha256."""

import json
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Shards(BuildHookInterface):
    """Adds each shard of the folder `zoo/shards/TRACK` that the registry names."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the files of the wheel; see `BuildHookInterface`.

        Raises:
            FileNotFoundError: The checkout lacks a shard.
        """
        package = Path(self.root)
        checkout = package.parents[1]
        shards = json.loads((checkout / "registry.json").read_text(encoding="utf-8"))["shards"]
        for path, shard in shards.items():
            if not path.startswith(f"zoo/shards/{package.name}/"):
                continue
            if not (checkout / path).is_file():
                raise FileNotFoundError(f"{path} is not here; clone the repository whole")
            name = f"assistax_zoo_{package.name}/{shard['sha256']}.safetensors"
            build_data["force_include"][str(checkout / path)] = name
