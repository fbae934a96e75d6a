"""`python -m tools.seat build [TASK ...]` writes evaluation/seat/modules anew."""

import argparse
import json
from pathlib import Path

from assistax_base.files import atomic_write
from assistax_envs.registered import CARE, TRACKS
from evaluation.seat.modules import MANIFEST, file_name
from tools.seat.build import ZIG, build
from zoo.registry import load_registry

MODULES = Path(__file__).parents[2] / "evaluation" / "seat" / "modules"
TASKS = TRACKS[CARE]
ROBOT = "{task}/dagger-ego-s0"  # robots of its shape can be played


def main() -> None:
    """Build the modules of the tasks named, or of all."""
    parser = argparse.ArgumentParser(prog="python -m tools.seat", description=__doc__)
    parser.add_argument("action", choices=["build"])
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=", ".join(TASKS))
    parser.add_argument("--out", type=Path, default=MODULES)
    asked = parser.parse_intermixed_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    manifest = asked.out / MANIFEST
    entries = json.loads(manifest.read_text())["tasks"] if manifest.exists() else {}
    registry = load_registry()
    for task in asked.tasks or TASKS:
        spec = registry.policy(ROBOT.format(task=task)).spec
        parts, entries[task] = build(task, spec)
        for part, content in parts.items():
            atomic_write(asked.out / file_name(task, part), content)
        known = {"ziglang": ZIG, "tasks": {name: entries[name] for name in sorted(entries)}}
        atomic_write(manifest, (json.dumps(known, indent=1) + "\n").encode())
        print(f"{task}: {len(parts['wasm']):,} bytes", flush=True)


if __name__ == "__main__":
    main()
