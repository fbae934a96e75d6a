"""Persons in the registry: found by id and glob, dealt into splits, held against their sha256."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from assistax_base.digest import json_sha256
from assistax_base.errors import (
    ExportError,
    IntegrityError,
    LockError,
    RegistryError,
    RegistryVersionError,
    SplitError,
    UnknownIdError,
)
from assistax_envs.persons.rows import (
    COUNT,
    PROGRAM_VERSION,
    WIDTH,
    drawn,
    marked,
    person,
    persons,
    side,
)
from assistax_envs.versions import VERSIONS
from zoo.exports.card import find_cards, markdown_card
from zoo.exports.policies import export_policy
from zoo.history.merkle import leaves, lost_leaves, with_roots
from zoo.locking import make_lock
from zoo.namespaces import merge
from zoo.parameters.storage import load_stacks
from zoo.partners.person_ids import parse_person
from zoo.partners.person_tables import described, person_splits
from zoo.partners.persons import Persons
from zoo.registry import Registry, load_registry, read_registry
from zoo.schema import Split
from zoo.splits import check_split, split_id
from zoo.transport.fetch import check_local
from zoo.verify import verify

ROOT = Path(__file__).parents[2]
NOW = "v1"  # the release with persons of the installed program
LATER = PROGRAM_VERSION + 1
TASK, SOMEBODY = "gentle_scratch", f"gentle_scratch/person-00042-{NOW}/human"


@pytest.fixture(scope="module")
def official() -> Registry:
    return read_registry(ROOT / "registry.json")


def changed(official: Registry, folder: Path, **fields: object) -> Registry:
    """Return a registry whose table of scratch's persons has other fields, with its roots."""
    release = official.data.releases[NOW]
    table = release.persons[TASK].model_copy(update=fields)
    release = release.model_copy(update={"persons": {**release.persons, TASK: table}})
    releases = {**official.data.releases, NOW: release}
    data = with_roots(official.data.model_copy(update={"releases": releases}))
    return dataclasses.replace(official, data=data, path=folder / "registry.json")


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("person-99999", "00000"),
        ("person-30000", "00000"),
        ("person-123", "00123"),
        (f"person-{'9' * 5000}", "00000"),
    ],
)
def test_an_unknown_number_gets_the_range(official: Registry, name: str, near: str) -> None:
    ranges = "00000 to 29999 (00000 to 09999 spring, 10000 to 19999 muscle, 20000 to 29999 stepper)"
    names = f"{TASK}/{name}", f"{TASK}/{name}/human", f"{TASK}/{name}-{NOW}"
    for text in names:
        for asking in (
            lambda text=text: official.policy(text),
            lambda text=text: official.select(text, role="human"),
            lambda text=text: official.source_of(text).choose(TASK, None, text),
            lambda text=text: find_cards(official, text),
        ):
            with pytest.raises(UnknownIdError) as caught:
                asking()
            assert f"a number of five digits from {ranges}, found" in str(caught.value)
            assert f"such as {TASK}/person-{near}" in str(caught.value)


def test_a_secret_has_its_own_numbers(official: Registry, tmp_path: Path) -> None:
    table = described(TASK, "ab" * 32, 5)
    hidden = changed(official, tmp_path, **table.model_dump())
    with pytest.raises(UnknownIdError, match=r"from 30000 to 30004, found '00042'; .*person-30000"):
        hidden.policy(f"{TASK}/person-00042")


def test_a_release_has_thirty_thousand_persons_of_three_families(official: Registry) -> None:
    release = official.data.releases[NOW]
    assert {table.count for table in release.persons.values()} == {COUNT} == {30_000}
    assert len({person(TASK, number).identity for number in range(COUNT)}) == COUNT
    names = [f"{TASK}/person-{number}0042-{NOW}/human" for number in range(3)]
    entries = official.known(names)
    assert [entry.algorithm for entry in entries] == ["spring", "muscle", "stepper"]
    stacks = load_stacks(official, entries)
    [stack] = stacks  # each family has a person with each row
    rows = np.tile(person(TASK, 42).row, (3, 1))
    np.testing.assert_array_equal(stack.params["row"], marked(rows, range(3)))
    assert len({entry.sha256 for entry in entries}) == 3


def test_persons_of_an_older_program_are_read_and_not_played(
    official: Registry, tmp_path: Path
) -> None:
    """Such a registry loads, lists its robots, and says in one error who is gone."""
    older = changed(official, tmp_path, program=2)
    assert older.select(f"{TASK}/*-{NOW}")
    words = f"persons of program {PROGRAM_VERSION}, as installed, found program 2"
    for look in (
        lambda: older.policy(SOMEBODY),
        lambda: older.select(f"{TASK}/person-0004*-{NOW}"),
        lambda: older.split(TASK, "persons"),
        lambda: older.split(TASK),
        lambda: older.split(TASK, f"persons-s0-{NOW}"),
    ):
        with pytest.raises(RegistryVersionError, match=words):
            look()
    assert list(person_splits(older.data, TASK)) == []
    assert Persons(older).offered(TASK, NOW) is None
    others = len(official.data.releases[NOW].persons) - 1
    assert list(Persons(older).problems()) == []
    assert Persons(older).table_sizes() == [COUNT] * others


def test_release_without_teams_has_split_of_persons(official: Registry) -> None:
    """And each release has its own, however many follow it."""
    older = official.split("gentle_feeding", release=NOW)
    assert (older.release, older.held_out) == (NOW, None)
    newer = official.data.releases[NOW].model_copy(update={"root": None})
    releases = {**official.data.releases, "v10": newer}
    data = official.data.model_copy(update={"release": "v10", "releases": releases})
    grown = dataclasses.replace(official, data=data)
    assert grown.split("gentle_feeding", release=NOW) == older
    assert grown.split("gentle_feeding").release == "v10"
    assert grown.split("gentle_feeding", older.id) == older
    assert grown.split("gentle_feeding", "persons").release == "v10"
    assert grown.split("scratch", release="v1").rule == "half"  # it has teams
    glob = f"gentle_feeding/person-0900?-{NOW}"
    split, chosen = Persons(grown).choose("gentle_feeding", None, glob)
    assert split == older and {entry.release for entry in chosen} == {NOW} and len(chosen) == 10
    added = merge(official.data, {"lab": official.data})
    lab = dataclasses.replace(official, data=added, parts={"": official, "lab": official})
    assert lab.split("gentle_feeding", "lab:") == lab.split("gentle_feeding", "lab:persons")
    assert lab.split("gentle_feeding", "lab:").id == f"lab:{older.id}"
    split, chosen = Persons(lab).choose("gentle_feeding", None, f"lab:{glob}")
    assert split.id == f"lab:{older.id}" and len(chosen) == 10


def test_a_person_is_found_by_its_id(official: Registry) -> None:
    entry, someone = official.policy(SOMEBODY), person(TASK, 42)
    assert (entry.id, entry.role, entry.seed, entry.release) == (SOMEBODY, "human", 42, NOW)
    assert entry.sha256 == someone.identity and entry.algorithm == "spring"
    assert official.env_version(entry) == VERSIONS[TASK]
    [stack] = load_stacks(official, [entry])
    np.testing.assert_array_equal(stack.params["row"], marked(someone.row[None]))
    check_local(official, [entry])
    assert official.known([SOMEBODY, "scratch/ippo-d1-s0-v1/human", "nobody"])[1] == entry


@pytest.mark.parametrize(
    "missing",
    [
        f"gentle_scratch/person-{COUNT}-{NOW}/human",
        "gentle_scratch/person-00042-v2/human",
        f"gentle_scratch/person-00042-{NOW}/robot",
        f"gentle_scratch/person-42-{NOW}/human",
        f"scratch/person-00042-{NOW}/human",
        f"lab:gentle_scratch/person-00042-{NOW}/human",
    ],
)
def test_nobody_else_is_found(official: Registry, missing: str) -> None:
    with pytest.raises(UnknownIdError):
        official.policy(missing)


def test_globs_find_persons_only_where_they_say_so(official: Registry) -> None:
    corners = official.select(f"gentle_scratch/person-08*-{NOW}")
    assert [entry.row for entry in corners] == list(range(8000, 9000))
    [stack] = load_stacks(official, corners)
    np.testing.assert_array_equal(stack.params["row"], marked(persons(TASK)[8000:9000]))
    some = load_stacks(official, official.select(f"gentle_scratch/person-*999-{NOW}"))
    assert [len(stack) for stack in some] == [30]  # of three families
    assert not any("person" in entry.id for entry in official.select("gentle_scratch/*"))
    with pytest.raises(UnknownIdError):
        official.select(f"gentle_scratch/person-*-{NOW}", role="robot")
    mixed = official.select([f"gentle_scratch/person-0004*-{NOW}", "scratch/ippo-d1-s0-v1"])
    assert len(mixed) == 12


def test_ids_of_persons_have_one_spelling() -> None:
    assert parse_person(SOMEBODY) == ("", TASK, 42, NOW)
    assert parse_person("lab:gentle_scratch/person-00042-v1") == ("lab", TASK, 42, "v1")
    for text in ("gentle_scratch/person-042-v1", "gentle_scratch/person-00042", "person-00042-v1"):
        assert parse_person(text) is None


def test_persons_are_dealt_as_their_numbers_say(official: Registry) -> None:
    split = official.split(TASK, "persons")
    for name, dealt in {"train": "training", "validation": "validation", "test": "test"}.items():
        numbers = [int(team.split("-")[1]) for team in getattr(split, name)]
        assert numbers == [number for number in range(COUNT) if side(number) == dealt]
    assert official.split(TASK, split.id) == split == official.split(TASK)
    assert official.split(TASK, split.id.removeprefix(f"{TASK}/")) == split
    with pytest.raises(SplitError, match=f"persons-s0-{NOW}"):
        official.split(TASK, f"persons-s0-{NOW}-00000000")
    with pytest.raises(SplitError, match="no persons"):
        official.split("scratch", "persons")


def test_secret_persons_are_no_public_ones(official: Registry, tmp_path: Path) -> None:
    """A season's private release: the rows follow from what it names, and all are tested with."""
    table = described(TASK, "ab" * 32, 6).model_dump()
    private = changed(official, tmp_path, **table)
    people = private.select(f"{TASK}/person-*-{NOW}")
    assert [entry.seed for entry in people] == list(range(COUNT, COUNT + 6))
    [stack] = load_stacks(private, people)
    rows = drawn(TASK, bytes.fromhex("ab" * 32), 6)
    np.testing.assert_array_equal(stack.params["row"], marked(rows, [0, 2, 1, 2, 0, 0]))
    split = private.split(TASK, "persons")
    assert (split.train, split.test) == ((), tuple(entry.team for entry in people))
    with pytest.raises(UnknownIdError):
        private.policy(SOMEBODY)
    other = changed(official, tmp_path, **table | {"secret": "cd" * 32})
    with pytest.raises(IntegrityError, match="6 rows of sha256"):
        other.select(f"{TASK}/person-*-{NOW}")


def test_split_of_persons_is_checked(official: Registry) -> None:
    for split in person_splits(official.data, TASK):
        check_split(split)  # as who reads the split of a robot's run does
        stranger = (*split.train[:-1], "gentle_lift/person-00042-v1")
        content = split.model_copy(update={"train": tuple(sorted(stranger))}).content
        changed = {**content, "id": split_id(content), "sha256": json_sha256(content)}
        with pytest.raises(SplitError, match="gentle_lift/person-00042-v1"):
            check_split(Split.model_validate(changed))


@pytest.mark.parametrize(
    ("fields", "error", "words"),
    [
        ({"program": LATER}, RegistryVersionError, f"program {LATER}"),
        ({"sha256": "0" * 64}, IntegrityError, "sha256 000"),
        ({"count": 9999}, IntegrityError, "9999 rows"),
    ],
)
def test_rows_unlike_the_releases_are_refused(
    official: Registry, tmp_path: Path, fields: dict, error: type, words: str
) -> None:
    registry = changed(official, tmp_path, **fields)
    for look in (
        lambda: registry.policy(SOMEBODY),
        lambda: registry.select(f"*/person-00042-{NOW}"),
    ):
        with pytest.raises(error, match=words):
            look()
    problems = verify(registry).problems
    assert any(words in problem for problem in problems)


def test_verify_counts_persons_and_finds_changes(official: Registry, tmp_path: Path) -> None:
    report = verify(official)
    assert report.ok and report.persons == 5 * COUNT
    assert f"persons {TASK}" in leaves(official.data, NOW)
    other = changed(official, tmp_path, program=LATER)
    assert lost_leaves(official.data, other.data) == [f"persons {TASK}"]


def test_persons_of_no_environment_are_refused(tmp_path: Path) -> None:
    data = json.loads((ROOT / "registry.json").read_text())
    tables = data["releases"][NOW]["persons"]
    tables["swim"] = tables[TASK]
    path = tmp_path / "registry.json"
    path.write_text(json.dumps(data))
    with pytest.raises(RegistryError, match=r"releases.v1.persons"):
        load_registry(path)


def test_a_card_prints_each_number_beside_its_range(official: Registry) -> None:
    for name in (SOMEBODY, SOMEBODY.removesuffix("/human")):
        [card] = find_cards(official, name)
    assert card["side"] == "training" and len(card["numbers"]) == WIDTH
    assert card["numbers"]["liked_force"] == {
        "value": 7.014, "unit": "N", "low": 1.5, "high": 10.0, "none": 0.0,
    }  # fmt: skip
    assert json.loads(json.dumps(card)) == card
    assert "| liked_force | 7.014 N | 1.5 to 10.0 |" in markdown_card([card])


def test_a_lock_and_an_export_refuse_persons(official: Registry, tmp_path: Path) -> None:
    with pytest.raises(LockError, match="the release's root pins"):
        make_lock(official, [official.policy(SOMEBODY)])
    with pytest.raises(ExportError, match="a person, who is a program"):
        export_policy(SOMEBODY, "safetensors", tmp_path / "x.safetensors", lambda: official)
