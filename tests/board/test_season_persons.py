"""Seasons whose hidden partners are persons: drawn from a secret that is committed to."""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest
import sqlalchemy as sa
from starlette.testclient import TestClient

from assistax_base.digest import leaf_sha256, merkle_root
from assistax_board.app import create_app
from assistax_board.problems import Problem
from assistax_board.rules import release_pack, seasons
from assistax_board.rules.catalogue import ZooCatalogue
from assistax_board.rules.release_pack import add_persons, hidden_partners, pack
from assistax_board.rules.scoring import GENTLE_COLUMNS, decode_table, encode_table
from assistax_board.service import Service
from assistax_board.store import schema

# What `submit --check` runs of a robot: no public name reaches it without a server.
from assistax_board.submitting import _try_work
from assistax_board.work.zoo_scorer import ZooScorer
from assistax_envs.persons.rows import COUNT, FAMILIES, PROGRAM_VERSION, drawn, hidden_family
from assistax_envs.registered import REGISTERED
from assistax_envs.versions import VERSIONS
from assistax_zoo.shell.main import run
from evaluation.cast.cast import choose_partners
from evaluation.figures.by_parameter import outcomes
from evaluation.figures.normalised import SELF_PLAY
from evaluation.play.how import PlaySettings
from evaluation.record.record import Record
from tests.board.fakes import TASK as OTHER_TASK
from tests.board.fakes import draft, new_submitter, work_off
from tests.board.test_zoo_scorer import short_episodes  # noqa: F401  # of all tests here
from tests.studies import evaluate_policies
from tests.untrained import gentle_specs, params_of, published, teams_of
from zoo.exports.card import find_cards
from zoo.parameters.storage import policy_bytes
from zoo.registry import Registry, load_registry
from zoo.verify import verify

TASK = "gentle_scratch"
NOBODY: Any = SimpleNamespace(policies=())  # is public


def season_of(service: Service, folder: Path, count: int = 8) -> dict[str, Any]:
    """Open a season of so many persons alone; return what it keeps to itself."""
    add_persons(folder, TASK, count)
    service.create_season(seasons.Plan("spring", TASK, small=True), folder, NOBODY)
    service.open_season("spring")
    with service.database.read() as connection:
        row = connection.execute(sa.select(schema.seasons)).mappings().one()
    return dict(row)


def secret_of(folder: Path) -> str:
    table = load_registry(folder / "registry.json").data.releases["v1"].persons[TASK]
    assert table.secret is not None
    return table.secret


def test_a_command_hides_persons_for_its_owner_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "private"
    words = ["season", "persons", str(folder), "--task", TASK, "--count", "6"]
    assert run(words) == 0
    assert "hides 6 persons; keep it secret" in capsys.readouterr().out
    assert folder.stat().st_mode & 0o077 == 0
    assert (folder / "registry.json").stat().st_mode & 0o777 == 0o600
    registry = load_registry(folder / "registry.json")
    people = hidden_partners(registry, TASK)
    assert [entry.seed for entry in people] == list(range(COUNT, COUNT + 6)), "nobody's public id"
    assert {registry.env_version(entry) for entry in people} == {VERSIONS[TASK]}
    assert {entry.algorithm for entry in people} == {*FAMILIES}
    assert (verify(registry).persons, verify(registry).problems) == (6, ())
    before = secret_of(folder)
    assert run(words) == 1 and "whose secret stays" in capsys.readouterr().err
    assert secret_of(folder) == before
    add_persons(tmp_path / "another", TASK, 6)
    assert secret_of(tmp_path / "another") != before


@pytest.mark.parametrize(
    ("task", "count", "message"),
    [("scratch", 6, "has no persons"), (TASK, 1, "allowed are 2 to"), (TASK, 10**6, "allowed are")],
)
def test_what_cannot_be_hidden_is_said(tmp_path: Path, task: str, count: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        add_persons(tmp_path / "private", task, count)
    assert not (tmp_path / "private").exists()


def test_persons_refuse_partners_of_another_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        older = dataclasses.replace(REGISTERED[TASK], version=2)
        # The kinds that were loaded: a version that this installation does not have.
        patch.setitem(REGISTERED._kinds, TASK, older)
        published(teams_of(2, task=TASK), tmp_path)
    now = VERSIONS[TASK]
    with pytest.raises(ValueError, match=f"play version 2 of {TASK}, and persons version {now}"):
        add_persons(tmp_path, TASK, 6)


def test_revealed_secret_redraws_committed_persons(service: Service, tmp_path: Path) -> None:
    row = season_of(service, tmp_path / "private")
    leaves = row["secret"]["leaves"]
    assert row["panel_sizes"] == {"A": 4, "B": 4}
    families = {}
    for panel in "AB":  # as many of each family
        people = [leaf["policy"] for leaf in leaves if leaf.get("panel") == panel]
        families[panel] = [hidden_family(int(name.split("-")[1]) - COUNT) for name in people]
    for name in FAMILIES:
        assert abs(families["A"].count(name) - families["B"].count(name)) <= 1
    service.close_season("spring")
    statement = seasons.revealed(service.database, "spring")
    packed = seasons.revealed_release(service.database, service.artefacts, "spring")
    assert seasons.verify_season(statement, packed, row["root"], tmp_path / "revealed") == 8
    revealed = load_registry(tmp_path / "revealed" / "registry.json")
    secret = bytes.fromhex(secret_of(tmp_path / "private"))
    [leaf] = [leaf for leaf in statement["leaves"] if "seeds" in leaf]
    assert leaf["persons"]["v1"]["secret"] == secret.hex()
    rows = drawn(TASK, secret, 8)
    person = find_cards(revealed, f"{TASK}/person-{COUNT + 3}-v1")[0]
    numbers = [number["value"] for number in person["numbers"].values()]
    np.testing.assert_allclose(numbers, rows[3], rtol=1e-3)


def test_another_secret_proves_nothing(service: Service, tmp_path: Path) -> None:
    row = season_of(service, tmp_path / "private")
    statement = {"task": TASK, "leaves": row["secret"]["leaves"]}
    add_persons(tmp_path / "another", TASK, 8)
    forged = json.loads(json.dumps(statement))
    forged["leaves"][0]["persons"]["v1"]["secret"] = "0" * 64
    root = merkle_root(map(leaf_sha256, forged["leaves"]))
    for said, release, announced, message in (
        (statement, "another", row["root"], "other partners"),
        (forged, "private", row["root"], "not those whose root"),
        (forged, "private", root, "another secret"),
    ):
        packed, place = pack(tmp_path / release), tmp_path / message
        with pytest.raises(ValueError, match=message):
            seasons.verify_season(said, packed, announced, place)


def test_nothing_of_the_secret_is_in_any_answer(service: Service, tmp_path: Path) -> None:
    secret_season = season_of(service, tmp_path / "private")
    http = TestClient(app := create_app(service), raise_server_exceptions=False)
    paths = [path for path, methods in app.openapi()["paths"].items() if "get" in methods]
    names = (secret_season["id"], "spring")
    texts = [
        http.get(p.replace("{id}", n).replace("{task}", TASK)).text for p in paths for n in names
    ]
    assert any(secret_season["root"] in text for text in texts)
    # The bare word may stand in a key or a signature by chance.
    hidden = [secret_of(tmp_path / "private"), "person-1", '"salt"']
    assert [word for word in hidden for text in texts if word in text] == []


def test_season_of_persons_requires_one_program(
    service: Service, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    season_of(service, tmp_path / "private")
    add_persons(tmp_path / "summer", TASK, 8)
    plan = seasons.Plan("summer", TASK, small=True)
    service.create_season(plan, tmp_path / "summer", NOBODY)
    monkeypatch.setattr("assistax_envs.persons.rows.PROGRAM_VERSION", 99)
    with pytest.raises(
        Problem, match=rf"season spring act by program {PROGRAM_VERSION},.* program 99"
    ):
        service.adopt_version()
    with pytest.raises(Problem, match="season summer act by program"):
        service.open_season("summer")
    identity = ZooCatalogue(load_registry(), "native").identity(TASK)
    assert identity["persons"] == 99, "no worker of another program takes a job"
    assert "persons" not in ZooCatalogue(load_registry(), "native").identity("scratch")


def test_persons_have_no_robot_of_their_own(service: Service, tmp_path: Path) -> None:
    """Panel B is measured by the other references."""
    season = season_of(service, tmp_path / "private")["id"]
    with service.database.write() as connection:
        connection.execute(sa.update(schema.seasons).values(task=OTHER_TASK))  # the fakes' own
    service.add_references()
    service.submit(new_submitter(service), draft(2.0, season=season))
    work_off(service)
    service.close_season("spring")
    work_off(service)
    played = {score.method for score in service.queries.scores(season=season, panel="B")}
    assert played == {"mine", "zero-action"}


@pytest.mark.slow
def test_a_task_of_persons_alone_has_a_board(tmp_path: Path) -> None:
    """Its public half is persons of the test side, the same that `evaluate` plays."""
    registry, task = load_registry(), "gentle_feeding"
    catalogue = ZooCatalogue(registry, "native")
    assert {task, "gentle_brushing"} < {*catalogue.tasks}
    panel = catalogue.public_panel(task)
    _, usual = choose_partners(registry, task, None, None)
    assert set(panel) == {entry.id for entry in usual} and len(panel) == 200
    references = catalogue.references(task)
    robots = {entry.team.rpartition("/")[2] for entry in registry.of_task(task, "robot")}
    assert SELF_PLAY not in references and robots & {*references}
    spec = registry.select(f"{task}/*/robot")[0].spec
    robot = policy_bytes(spec, params_of(spec, 7))
    families = {entry.id: entry.algorithm for entry in usual}
    names = panel[0], next(name for name in panel if families[name] != families[panel[0]])
    asked = dataclasses.replace(_try_work(task, "safetensors", names), episodes=1)
    table = ZooScorer(registry, catalogue, "native").play(asked, robot, None)
    arrived = decode_table(encode_table(table), names, 1, asked.preferences)
    assert set(arrived["algorithm"]) == {families[name] for name in names}
    assert set(arrived["preference"]) == {"own"}


@pytest.fixture(scope="module")
def private(tmp_path_factory: pytest.TempPathFactory) -> Registry:
    """Trained partners and persons in one release."""
    folder = tmp_path_factory.mktemp("private")
    published(teams_of(1, *gentle_specs(TASK), TASK), folder)
    add_persons(folder, TASK, 3)
    return load_registry(folder / "registry.json")


@pytest.mark.slow
def test_server_and_evaluate_play_persons_alike(private: Registry, tmp_path: Path) -> None:
    """After the reveal anybody evaluates with the release: the same returns, person by person."""
    robot, people = tmp_path / "robot.safetensors", hidden_partners(private, TASK)
    spec = private.select(task=TASK, role="robot")[0].spec
    robot.write_bytes(policy_bytes(spec, params_of(spec, 7)))
    names = tuple(release_pack.ordinal(index) for index in range(len(people)))
    asked = dataclasses.replace(_try_work(TASK, "safetensors", names), episodes=2)
    assert [entry.disability for entry in people] == ["d1", "d9", "own", "own", "own"]
    catalogue = ZooCatalogue(private, "native")
    table = ZooScorer(private, catalogue, "native").play(
        asked, robot.read_bytes(), pack(private.path.parent)
    )
    arrived = decode_table(encode_table(table), asked.partners, 2, asked.preferences)
    assert set(arrived.columns) > set(GENTLE_COLUMNS)
    persons = arrived.filter(pl.col("disability") == "own").sort("partner", "episode")
    assert set(persons["preference"]) == {"own"} and persons.height == 3 * 2
    assert set(persons["algorithm"]) == {*FAMILIES}

    how = PlaySettings(TASK, 2, int(asked.seed, 16), "native")
    evaluate_policies(private, [robot], how, tmp_path / "home", partners="persons")
    home = pl.read_parquet(tmp_path / "home" / "episodes.parquet").sort("partner", "episode")
    assert home["partner"].unique().sort().to_list() == [entry.id for entry in people[2:]]
    for column in ("return", "success", "violated"):
        assert home[column].equals(persons[column]), column
    with pytest.raises(ValueError, match="persons of a season's secret"):
        outcomes(Record.read(tmp_path / "home"))
