"""The kept modules are those that this code builds, and a changed one is refused."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from assistax_envs.versions import VERSIONS
from evaluation.seat import modules
from evaluation.seat.modules import PARTS, file_name, playable, read_manifest, read_module
from tests.seat.trajectories import TASKS
from tools.seat.__main__ import ROBOT
from tools.seat.build import ZIG, build
from zoo.registry import load_registry


def test_each_gentle_task_has_a_module_of_its_version() -> None:
    assert playable() == tuple(sorted(task for task in VERSIONS if task.startswith("gentle_")))
    manifest = read_manifest()
    assert manifest["ziglang"] == ZIG
    for task in playable():
        assert manifest["tasks"][task]["version"] == VERSIONS[task]
        assert set(read_module(task)) == set(PARTS)


def test_a_changed_module_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "modules"
    folder.mkdir()
    for file in (resources.files("evaluation.seat") / "modules").iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    path = folder / file_name("gentle_scratch", "wasm")
    path.write_bytes(path.read_bytes()[:-1] + b"\x00")
    monkeypatch.setattr(modules.resources, "files", lambda package: tmp_path)
    with pytest.raises(ValueError, match=r"gentle_scratch\.wasm has the sha256 .* install"):
        read_module("gentle_scratch")


def test_another_task_is_refused() -> None:
    with pytest.raises(ValueError, match="scratch cannot be played in a page; allowed are gentle_"):
        read_module("scratch")


@pytest.mark.slow
@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("task", TASKS)
def test_the_kept_modules_are_built_again_to_the_byte(task: str) -> None:
    pytest.importorskip("ziglang", reason="needs ziglang: pip install ziglang")
    parts, entry = build(task, load_registry().policy(ROBOT.format(task=task)).spec)
    kept = read_module(task)
    # Starts are drawn by XLA, whose last bits a processor without fused multiply-add changes.
    starts = [np.frombuffer(one["starts"], np.float32) for one in (parts, kept)]
    np.testing.assert_allclose(*starts, rtol=1e-6, atol=1e-6)
    assert [parts[part] == kept[part] for part in ("wasm", "layout")] == [True, True]
    same = {name: entry[name] for name in entry if name != "starts"}
    assert same.items() <= read_manifest()["tasks"][task].items()
