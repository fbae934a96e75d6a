"""Labs and readers are told what is played: of which kind, in which environment version."""

from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.client import Client
from assistax_board.robots.admission import Admission
from assistax_board.rules.catalogue import public_entries
from assistax_board.rules.release_pack import add_persons, hidden_partners
from assistax_board.rules.submissions import Admitted
from assistax_board.service import Service
from assistax_board.store.played import (
    describe_partners,
    partners_in_words,
    statement_of,
    warning_of,
)
from assistax_board.submitting import hand_in, limits_for_reader
from assistax_envs.versions import VERSIONS
from population.networks.onnx_export import to_onnx
from tests.board.fakes import TASK, FakeCatalogue, draft, new_submitter
from tests.board.test_season import open_season
from tests.board.test_season_persons import TASK as GENTLE
from tests.board.test_season_persons import season_of
from tests.untrained import ROBOT, params_of, published, teams_of
from zoo.parameters.storage import policy_bytes, write_policy_file
from zoo.registry import load_registry

NOW = VERSIONS[GENTLE]
PERSONS = {
    "env_versions": [NOW],
    "persons": {"muscle": 2, "spring": 3, "stepper": 3},
    "teams": {},
}


def test_a_season_of_persons_says_so_everywhere(service: Service, tmp_path: Path) -> None:
    season_of(service, tmp_path / "private")
    [season] = service.queries.seasons()
    assert season.hidden == PERSONS
    with TestClient(create_app(service)) as http:
        page = http.get("/seasons/spring").text
        token = service.create_token(("submit",), submitter="lab")
        limits = limits_for_reader(Client("http://testserver", token, transport=http).limits())
        assert http.get("/api/seasons/spring").json()["hidden"] == PERSONS
    words = f"8 persons (2 muscle, 3 spring, 3 stepper), environment version {NOW}"
    assert words in page and words in limits["season spring"]
    registry = load_registry()
    public = describe_partners(registry, public_entries(registry, GENTLE))
    assert partners_in_words(public) in page
    assert sum(public["persons"].values()) == 200 and not public["teams"]
    assert "hidden ones are persons made of numbers" in page
    assert "The partners are trained policies" not in page


def test_teams_and_persons_are_counted_apart(tmp_path: Path) -> None:
    published(teams_of(2, task=GENTLE), tmp_path)
    add_persons(tmp_path, GENTLE, 6)
    registry = load_registry(tmp_path / "registry.json")
    told = describe_partners(registry, hidden_partners(registry, GENTLE))
    persons = {"muscle": 1, "spring": 3, "stepper": 2}
    assert told == {"env_versions": [NOW], "persons": persons, "teams": {"ippo": 4}}
    both = "6 persons (1 muscle, 3 spring, 2 stepper) and 4 partners of trained teams (4 ippo)"
    assert both in partners_in_words(told)
    assert "kinds not recorded" in partners_in_words(None)
    assert "not validated models of people" in statement_of(None)
    # The public half of this task is persons: of it nothing is said that is true of teams alone.
    assert "simulated; hidden ones are trained policies and persons made of" in statement_of(told)
    assert "hidden ones are trained policies. They" in statement_of({**told, "persons": {}})


class Row:
    name, hidden = "spring", PERSONS


def test_a_warning_names_each_other_version() -> None:
    assert warning_of(None, 2, Row) is None, "a file that says nothing"
    assert warning_of(NOW, NOW, Row) is None
    halves = "public half in environment version 2", f"season spring in environment version {NOW}"
    for version, expected in ((1, [True, True]), (2, [False, True]), (NOW, [True, False])):
        text = str(warning_of(version, 2, Row))
        assert [half in text for half in halves] == expected


class Catalogue(FakeCatalogue):
    def identity(self, task: str) -> dict[str, Any]:
        return {**super().identity(task), "env_version": 3}


def test_a_robot_of_another_version_is_warned_about(
    service: Service, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    object.__setattr__(service, "catalogue", Catalogue())
    object.__setattr__(service, "admit", lambda data, task: Admitted("fake", 2))
    path = tmp_path / "robot"
    path.with_suffix(".onnx").write_bytes(b"robot 1.0")
    with TestClient(create_app(service)) as http:
        token = service.create_token(("submit",), submitter="lab")
        client = Client("http://testserver", token, transport=http)
        fields = {"task": TASK, "method": "mine"}
        [told] = hand_in(client, [path.with_suffix(".onnx")], fields, None, watch=False)
        warning = "it was trained in environment version 2; it plays the public half in"
        assert warning in told["warning"]
        assert f"robot.onnx: {told['warning']}" in capsys.readouterr().err
        assert warning in http.get(f"/submissions/{told['id']}").text
    object.__setattr__(service, "admit", lambda data, task: Admitted("fake", 3))
    season = open_season(service)
    id = service.submit(new_submitter(service), draft(season=season, request="another"))
    submission = service.queries.submission(id)
    assert submission is not None and submission.warning is None


@pytest.mark.slow
def test_admission_reads_the_version_that_a_file_says(tmp_path: Path) -> None:
    sizes = {TASK: (ROBOT.observation_size, ROBOT.action_size)}
    admission, params = Admission(sizes), params_of(ROBOT, 1)
    for said, version in (({"env_version": 2}, 2), ({}, None), ({"env_version": "x"}, None)):
        file = tmp_path / "robot.safetensors"
        write_policy_file(file, ROBOT, params, said)
        for data in (file.read_bytes(), to_onnx(ROBOT, params, said)):
            assert admission.read(data, TASK).env_version == version
    assert admission(policy_bytes(ROBOT, params, {"env_version": 2}), TASK).env_version == 2
