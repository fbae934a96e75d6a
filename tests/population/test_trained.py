"""What a finished run made is read by one reader, which trusts no file of the folder."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assistax_base.errors import FormatError
from population.config import TrainConfig, make_members
from population.hyperparameters import PPOConfig
from population.networks.spec import ROLES, PolicySpec
from population.runs.folder import RunFolder
from population.runs.trained import read_teams, read_trained_run

SPECS = {role: PolicySpec(role, 3, 2, hidden=(4,)) for role in ROLES}


def write(folder: Path, precision: str = "float32") -> dict[str, Any]:
    """Write a run of two teams; return its parameters."""
    members = make_members((0, 1), ("d1",))
    config = TrainConfig("scratch", "ippo", members, steps=100, trainer=PPOConfig(hidden=(4,)))
    kernel = np.random.default_rng(0).normal(size=(2, 3, 4)).astype(precision)
    params = {role: {"Dense_0": {"kernel": kernel + len(role)}} for role in ROLES}
    run = RunFolder(folder)
    run.open(config, {"env_version": 1}, resume=False)
    self_play = [{"mean": 1.0, "mean_ci": [0.0, 2.0]}, None]
    run.write_teams(config, SPECS, params, {"steps": 100}, self_play)
    return dict(params)


@pytest.mark.parametrize("precision", ["float32", "float16"])
def test_a_run_is_read_bit_for_bit(tmp_path: Path, precision: str) -> None:
    params = write(tmp_path / "run", precision)
    run = read_trained_run(tmp_path / "run")
    for role in ROLES:
        read, written = (
            tree["Dense_0"]["kernel"] for tree in (run.policies[role].params, params[role])
        )
        assert read.dtype == precision and np.array_equal(read, written)
        assert run.policies[role].ids == tuple(f"scratch/ippo-d1-s{n}/{role}" for n in (0, 1))
    assert run.self_play == ({"mean": 1.0, "mean_ci": [0.0, 2.0]}, None)
    assert run.training == {"steps": 100}
    assert [team.seed for team in read_teams(tmp_path / "run")] == [0, 1]


@pytest.mark.parametrize(
    ("role", "change", "words"),
    [
        ("robot", {"file": "../run/robot.safetensors"}, "without a folder"),
        ("robot", {"row": 2}, "a row from 0 to 1"),
        ("human", {"file": "robot.safetensors"}, "spec"),
        ("human", {"file": "absent.safetensors"}, "no such file"),
    ],
)
def test_a_hostile_folder_is_refused_for_every_user(
    tmp_path: Path, role: str, change: dict[str, Any], words: str
) -> None:
    write(tmp_path / "run")
    path = tmp_path / "run" / "teams.json"
    teams = json.loads(path.read_text())
    teams[0]["roles"][role].update(change)
    path.write_text(json.dumps(teams))
    with pytest.raises(FormatError, match=words):
        read_trained_run(tmp_path / "run")


def test_parameters_with_nan_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "run")
    path = tmp_path / "run" / "robot.safetensors"
    path.write_bytes(path.read_bytes()[:-4] + np.float32(np.nan).tobytes())
    with pytest.raises(FormatError, match="NaN"):
        read_trained_run(tmp_path / "run")


@pytest.mark.parametrize("damage", ["[{", "{}", "[]", '[{"team": 0, "team": 1}]'])
def test_team_items_are_checked_like_teams(tmp_path: Path, damage: str) -> None:
    write(tmp_path / "run")
    run = RunFolder(tmp_path / "run")
    assert [item["team"]["seed"] for item in run.team_items()] == [0, 1]
    run.teams.write_text(damage)
    with pytest.raises(FormatError, match=r"teams\.json"):
        run.team_items()
    with pytest.raises(ValueError, match="is damaged"):
        run.finished(run.config())
