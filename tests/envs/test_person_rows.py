"""The numbers of persons: ranges, sources, sides, identity, and the bits of ten thousand rows."""

import hashlib
from pathlib import Path
from unittest.mock import Mock

import jax
import numpy as np
import pytest

from assistax_envs.persons import rows
from assistax_envs.persons.player import draw_persons
from assistax_envs.persons.rows import (
    BEYOND,
    COUNT,
    FAMILIES,
    INNER,
    PARAMETERS,
    ROWS,
    SIDES,
    UNSEEN,
    WIDTH,
    Parameter,
    card,
    drawn,
    family,
    made_rows,
    numbers,
    person,
    persons,
    side,
)

SCRATCH = "gentle_scratch"
# SHA-256 of the rows of all persons of a task, little-endian float32.
TABLES = {
    "scratch": "cc38bab27e3ddda9bdcb1b1360e49f9a3c573b4d1fefe3189461185d477e2f47",
    "bed_bath": "56177e0930b4d77ef12248eba252bae4c97db3df0cbbbcb485b9d12b7f6c9ec0",
    "arm_assist": "545b0c343b6271a99a4c10373a6bc6f130f1cee7732dfd331b2bb00e3c469ccc",
    "gentle_scratch": "cc817b246a7b1382badba99e277216bda484a822dc0faf23f4f9d27f55cf419e",
    "gentle_bath": "802f6a5b849ef3790ae8b42462cda766e3dd863273df0dc8b887febc9060113a",
    "gentle_feeding": "d7f8f84187967cf8a21588fff7e4eaa4e34fc82c0db1b1511a966c5a08ffdcef",
    "gentle_brushing": "c38641a0e1757d3fb8cb70aca4b066cb14615c8e80a7addfd428e1572487a42e",
    "gentle_lift": "c0bcf131c1a84e401c62e6f5eaf43c3748c68c0db36655c1bd6f5a1f423829d6",
}


@pytest.mark.parametrize("task", PARAMETERS)
def test_numbers_of_persons_lie_in_range(task: str) -> None:
    table = persons(task)
    assert table.shape == (ROWS, WIDTH) and WIDTH == len(PARAMETERS[task]) == 30
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
    assert hashlib.sha256(made_rows(task).astype("<f4").tobytes()).hexdigest() == TABLES[task]


def test_person_is_named_by_its_numbers() -> None:
    someone = person("gentle_scratch", 42)
    assert someone.name == "person-00042" and someone.side == "training"
    assert someone.identity == person("gentle_scratch", 42).identity
    others = {person("gentle_scratch", number).identity for number in range(0, COUNT, 500)}
    assert len(others) == 60 and someone.identity not in others
    same = [person("gentle_scratch", 42 + place * ROWS) for place in range(len(FAMILIES))]
    assert tuple(one.family for one in same) == FAMILIES == ("spring", "muscle", "stepper")
    assert all((one.row == someone.row).all() for one in same)
    assert len({one.identity for one in same}) == len(FAMILIES)
    printed = card(someone)
    for parameter, value in zip(PARAMETERS["gentle_scratch"], someone.row, strict=True):
        assert f"{parameter.name} " in printed and f"{value:.4g}" in printed
        assert f"[{parameter.low:g} to {parameter.high:g}" in printed
    with pytest.raises(ValueError, match="allowed are 0 to 29999"):
        person("gentle_scratch", COUNT)
    with pytest.raises(ValueError, match="allowed are scratch"):
        persons("gentle_walk")


def test_sides_are_inside_corners_and_the_unseen_family() -> None:
    of = {name: np.array([side(n) == name for n in range(COUNT)]) for name in SIDES}
    assert {name: int(mine.sum()) for name, mine in of.items()} == {
        "training": 14_400,
        "validation": 1_600,
        "test": 14_000,
    }
    corners = np.arange(COUNT) % ROWS >= INNER
    unseen = np.array([family(number) == UNSEEN for number in range(COUNT)])
    np.testing.assert_array_equal(of["test"], corners | unseen)
    # A person and those of its row in the other family that trains lie on one side.
    np.testing.assert_array_equal(of["validation"][:ROWS], of["validation"][ROWS : 2 * ROWS])


@pytest.mark.parametrize("task", ["gentle_scratch", "gentle_lift", "gentle_feeding", "scratch"])
def test_training_lies_inside_and_corners_lie_beyond(task: str) -> None:
    table = persons(task)
    low, high = (
        np.array([parameter.quantile(share) for parameter in PARAMETERS[task]], np.float32)
        for share in (0.1, 0.9)
    )
    assert not ((table < low) | (table > high))[:INNER].any()
    # Numbers that some persons have none of hide a lower end: at 10% everybody has none. All others
    # are rounded to float32, which may take a corner's back to the bound.
    hides = np.array([parameter.none > 0.0 for parameter in PARAMETERS[task]])
    corners = table[INNER:]
    out = np.where(hides, corners < low, corners <= low) | (corners >= high)
    wishes = [n for n, p in enumerate(PARAMETERS[task]) if p.name.startswith("liked_")]
    all_wishes = out[:, wishes].all(axis=1)
    assert ((out.sum(axis=1) >= BEYOND - hides.sum()) | all_wishes).all()
    assert 0.2 < all_wishes.mean() < 0.8  # both kinds of corners are there


@pytest.mark.parametrize("task", ["gentle_scratch", "gentle_feeding"])
def test_a_tenth_of_persons_never_speaks(task: str) -> None:
    talkative = persons(task)[:INNER, [p.name for p in PARAMETERS[task]].index("talkative")]
    assert (talkative == 0.0).mean() == pytest.approx(0.1, abs=0.005)
    assert talkative[talkative > 0.0].min() > 0.4


def test_key_draws_the_person() -> None:
    training = numbers("training")
    assert len(training) == 14_400 and all(side(int(number)) == "training" for number in training)
    keys = jax.random.split(jax.random.key(5), 4000)
    met = np.asarray(draw_persons(keys, training))
    np.testing.assert_array_equal(met, draw_persons(keys, training))
    assert set(met.tolist()) <= set(training.tolist())
    # Of 4000 draws with replacement among 14,400, some 3,492 persons.
    assert len(np.unique(met)) > 3400
    np.testing.assert_array_equal(met[7:9], draw_persons(keys[7:9], training))
    with pytest.raises(ValueError, match="allowed are training, validation, test"):
        numbers("hidden")


def test_a_secret_draws_corners_the_unseen_family_and_some_inside() -> None:
    families = [rows.hidden_family(place) for place in range(1000)]
    assert [families.count(name) for name in ("spring", "muscle", UNSEEN)] == [300, 300, 400]
    # A row's numbers are rounded, so the points behind them are looked at.
    points = np.stack([rows._hidden_point(SCRATCH, b"a season", place) for place in range(200)])
    corner, beyond = rows._corners(SCRATCH, points), np.abs(points - 0.5) > 0.4
    assert corner[::5].all() and corner[2::5].all()
    assert not beyond[4::5].any() and 0.0 < corner[1::2].mean() < 0.7
    assert len(np.unique(points, axis=0)) == 200


def test_secret_draws_the_same_hidden_persons() -> None:
    table = drawn("gentle_bath", b"a season", 50)
    np.testing.assert_array_equal(table, drawn("gentle_bath", b"a season", 50))
    assert not np.array_equal(table, drawn("gentle_bath", b"another season", 50))
    for parameter, column in zip(PARAMETERS["gentle_bath"], table.T, strict=True):
        assert all(parameter.holds(float(f"{value:.6g}")) for value in column), parameter.name


def test_rows_are_kept_and_made_again_where_they_cannot_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept, made = persons(SCRATCH), Mock(side_effect=made_rows)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(rows, "made_rows", made)
    anew = persons.__wrapped__
    for _ in range(2):
        np.testing.assert_array_equal(anew(SCRATCH), kept)
    assert made.call_count == 1
    [file] = tmp_path.glob("*/*/*.npy")
    file.write_bytes(file.read_bytes()[:-1])
    np.testing.assert_array_equal(anew(SCRATCH), kept)
    assert made.call_count == 2
    file.parent.chmod(0o777)  # others could plant rows there
    np.testing.assert_array_equal(anew(SCRATCH), kept)
    assert made.call_count == 3
