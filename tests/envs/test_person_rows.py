"""The numbers of persons: ranges, sources, sides, identity, and the bits of ten thousand rows."""

import hashlib

import jax
import numpy as np
import pytest

from assistax_envs.persons.parameters import PARAMETERS, WIDTH, Parameter
from assistax_envs.persons.player import draw_persons
from assistax_envs.persons.rows import (
    BEYOND,
    CORNERS,
    COUNT,
    INNER,
    SIDES,
    card,
    drawn,
    numbers,
    person,
    persons,
    side,
)

# SHA-256 of the rows of all persons of a task, little-endian float32.
TABLES = {
    "scratch": "33ef462c02265f7ff6896aa86e401559fe5f6421c569d2f973c2d41925a37d08",
    "bed_bath": "d9a02e82f8f60240bfac49d81c1c08593e1b73d838afb9cd47169a5dc1a987cb",
    "arm_assist": "60bae69990237bf8fb9f9faa42ad31fd25ba88e34533435540796510a91cb537",
    "gentle_scratch": "018edcf029b6a7c411c739a74cc8bafcf260b25a4484e75e86c161b325bccb69",
    "gentle_bath": "6c73358893d5b7b705499b4b54d54b8366a4dc79ad94c09b204c042165659970",
    "gentle_feeding": "f4e9f839acdf1871c4dfa52932dd0fabd77ebd9b35ca1e4483bb331800088831",
    "gentle_brushing": "bbcd632b480c574e8a528d3ce9c372ab0c175e619700435319d8b9cb4d3df37f",
    "gentle_lift": "9c7292f6121872b320933a39ccc21bd03159473e9c36242a61286dd1d6ee8813",
}


@pytest.mark.parametrize("task", PARAMETERS)
def test_numbers_of_persons_lie_in_range(task: str) -> None:
    table = persons(task)
    assert table.shape == (COUNT, WIDTH) and WIDTH == len(PARAMETERS[task]) == 25
    for parameter, column in zip(PARAMETERS[task], table.T, strict=True):
        low, high = np.float32(parameter.low), np.float32(parameter.high)
        inside = (low <= column) & (column <= high)
        inside |= (parameter.none > 0.0) & (column == 0.0)
        assert inside.all(), parameter.name
        assert len(np.unique(column)) > 100, parameter.name
        assert parameter.source and parameter.meaning


def test_parameter_knows_its_range_and_distribution() -> None:
    force = next(p for p in PARAMETERS["gentle_scratch"] if p.name == "liked_force")
    shares = [force.quantile(share) for share in (0.0, 0.5, 1.0)]
    assert shares[0] == force.low and shares[2] == force.high
    assert 3.5 < shares[1] < 4.5  # N, the median before both ends are cut
    assert force.holds(4.0) and not force.holds(force.high * 1.01) and not force.holds(0.0)
    tremor = next(p for p in PARAMETERS["gentle_scratch"] if p.name == "tremor")
    assert tremor.quantile(0.3) == 0.0 and tremor.holds(0.0) and not tremor.holds(0.01)
    with pytest.raises(ValueError, match="give low < high"):
        Parameter("nothing", "1", 1.0, 1.0, "", "")


@pytest.mark.parametrize("task", PARAMETERS)
def test_persons_are_the_same_to_the_bit(task: str) -> None:
    assert hashlib.sha256(persons(task).astype("<f4").tobytes()).hexdigest() == TABLES[task]


def test_person_is_named_by_its_numbers() -> None:
    someone = person("gentle_scratch", 42)
    assert someone.name == "person-00042" and someone.side == "training"
    assert someone.identity == person("gentle_scratch", 42).identity
    others = {person("gentle_scratch", number).identity for number in range(0, COUNT, 500)}
    assert len(others) == 20 and someone.identity not in others
    assert person("gentle_scratch", CORNERS).family == "muscle"
    printed = card(someone)
    for parameter, value in zip(PARAMETERS["gentle_scratch"], someone.row, strict=True):
        assert f"{parameter.name} " in printed and f"{value:.4g}" in printed
        assert f"[{parameter.low:g} to {parameter.high:g}" in printed
    with pytest.raises(ValueError, match="allowed are 0 to 9999"):
        person("gentle_scratch", COUNT)
    with pytest.raises(ValueError, match="allowed are scratch"):
        persons("gentle_walk")


@pytest.mark.parametrize("task", ["gentle_scratch", "gentle_lift"])
def test_training_lies_inside_and_corners_lie_beyond(task: str) -> None:
    counts = {name: sum(side(number) == name for number in range(COUNT)) for name in SIDES}
    assert counts == {"training": 7200, "validation": 800, "test": 2000}
    table = persons(task)
    low, high = (
        np.array([parameter.quantile(share) for parameter in PARAMETERS[task]], np.float32)
        for share in (0.1, 0.9)
    )
    beyond = ((table < low) | (table > high)).sum(axis=1)
    assert (beyond[:INNER] == 0).all() and (beyond[CORNERS:] == 0).all()
    # Below 0.4 or 0.5 everybody has no tremor and no spasticity: those two hide a lower end.
    assert (beyond[INNER:CORNERS] >= BEYOND - 2).all()


def test_key_draws_the_person() -> None:
    training = numbers("training")
    assert len(training) == 7200 and all(side(int(number)) == "training" for number in training)
    keys = jax.random.split(jax.random.key(5), 4000)
    met = np.asarray(draw_persons(keys, training))
    np.testing.assert_array_equal(met, draw_persons(keys, training))
    assert set(met.tolist()) <= set(training.tolist())
    assert len(np.unique(met)) > 3000  # of 4000 draws with replacement among 7200, some 3069
    np.testing.assert_array_equal(met[7:9], draw_persons(keys[7:9], training))
    with pytest.raises(ValueError, match="allowed are training, validation, test"):
        numbers("hidden")


def test_secret_draws_the_same_hidden_persons() -> None:
    rows = drawn("gentle_bath", b"a season", 50)
    np.testing.assert_array_equal(rows, drawn("gentle_bath", b"a season", 50))
    assert not np.array_equal(rows, drawn("gentle_bath", b"another season", 50))
    for parameter, column in zip(PARAMETERS["gentle_bath"], rows.T, strict=True):
        assert all(parameter.holds(float(f"{value:.6g}")) for value in column), parameter.name
