"""Robots learn with persons and play with strangers; a result is what each earned with each."""

import json
from pathlib import Path

import numpy as np
import pytest

from assistax_workshop.gates import persons
from assistax_workshop.gates.persons import train_with_persons


@pytest.mark.slow
def test_each_robot_plays_with_each_stranger(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(persons, "SIDE", 3)
    lines: list[str] = []
    earned = train_with_persons(
        "gentle_scratch",
        tmp_path,
        seeds=(0, 1),
        steps=600,
        num_envs=4,
        horizon=30,
        progress=lines.append,
    )
    assert json.loads((tmp_path / persons.RESULT).read_text()) == earned
    assert [line.partition(":")[0] for line in lines] == [
        f"{robot} with {side}" for robot in persons.ROBOTS for side in persons.STRANGERS
    ]
    for sides in earned.values():
        for figures in sides.values():
            assert np.shape(figures["return"]) == np.shape(figures["safe_success"]) == (2, 3)
    returns = [np.array(sides["muscle"]["return"]) for sides in earned.values()]
    assert not np.array_equal(returns[0], returns[1]), "who is told plays otherwise"
