"""Robots learn with persons and play with strangers; a result is what each earned with each."""

import json
from pathlib import Path

import numpy as np
import pytest

import assistax_envs
from assistax_envs.persons import PersonPlayer
from assistax_envs.persons import persons as rows_of
from assistax_workshop.gates import persons
from assistax_workshop.gates.persons import PersonPartners, train_with_persons


def test_there_is_a_person_for_each_simulation() -> None:
    partners = PersonPartners(PersonPlayer("gentle_scratch"), rows_of("gentle_scratch")[:4])
    env = assistax_envs.make("gentle_scratch", "native")
    partners.check(env, 4)
    with pytest.raises(ValueError, match="num_envs is 8 with 4 persons"):
        partners.check(env, 8)


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
