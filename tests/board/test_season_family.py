"""A season with a family of persons that its organiser brought as an installed package."""

import json
import shutil
import sys
import zipfile
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import sqlalchemy as sa
from starlette.testclient import TestClient

from assistax_base.digest import leaf_sha256, merkle_root
from assistax_base.extensions import FAMILIES as GROUP
from assistax_base.extensions import ExtensionError, files_sha256
from assistax_board.app import create_app
from assistax_board.problems import Problem
from assistax_board.rules import release_pack, seasons
from assistax_board.rules.release_pack import add_persons, hidden_partners, own_families, pack
from assistax_board.service import Service
from assistax_board.store.played import partners_in_words
from assistax_board.store.schema import SEASON
from assistax_envs.persons import player
from assistax_envs.persons.player import PersonPlayer
from assistax_envs.persons.rows import (
    OWN_FAMILY,
    group_of,
    groups_of,
    installed_family,
    marked,
    persons,
)
from assistax_envs.persons.senses import SEAT_SIZES
from assistax_zoo.shell.main import run
from tests.board.test_season_persons import NOBODY, TASK, season_of
from zoo.registry import load_registry

SOURCE = Path(__file__).parents[1] / "outside/src/assistax_outside/family.py"
PACKAGE, FAMILY = "season_family_package", "weary"


@pytest.fixture
def package(tmp_path: Path, install_package: Callable[..., None]) -> Iterator[Path]:
    """Install a package with the family; return its folder."""
    folder = tmp_path / PACKAGE
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    shutil.copy(SOURCE, folder / "family.py")
    install_package(GROUP, FAMILY, f"{PACKAGE}.family:Weary")
    forget()
    yield folder
    forget()


def forget() -> None:
    """Let the package be imported anew."""
    player._load_family.cache_clear()  # a process imports a family once; a test needs it anew
    for name in [name for name in sys.modules if name.partition(".")[0] == PACKAGE]:
        del sys.modules[name]


def opened(service: Service, folder: Path) -> tuple[str, list[dict[str, Any]]]:
    """Open a season of nine persons, three of the family; return its root and leaves."""
    add_persons(folder, TASK, 9, FAMILY)
    service.create_season(seasons.Plan("spring", TASK, small=True), folder, NOBODY)
    root = service.open_season("spring")
    with service.database.read() as connection:
        return root, connection.execute(sa.select(SEASON.secret)).scalar_one()["leaves"]


def test_a_season_commits_to_the_family_and_reveals_it(
    service: Service, tmp_path: Path, package: Path
) -> None:
    root, leaves = opened(service, tmp_path / "private")
    registry = load_registry(tmp_path / "private" / "registry.json")
    people = hidden_partners(registry, TASK)
    assert [entry.algorithm for entry in people].count("own-weary") == 3
    assert len({entry.sha256 for entry in people}) == 9
    season = service.queries.season("spring")
    assert season is not None
    words = partners_in_words(season.hidden)
    assert "3 of a family of the organiser's" in words and "weary" not in words
    program = files_sha256(installed_family(FAMILY).files())
    [own] = [leaf["persons"]["v1"]["own"] for leaf in leaves if "seeds" in leaf]
    assert (own["name"], own["sha256"], own["count"]) == (FAMILY, program, 3)
    assert merkle_root(map(leaf_sha256, leaves)) == root
    service.close_season("spring")
    page = TestClient(create_app(service)).get(f"/seasons/{season.id}").text
    assert "which holds the files of the organiser's family" in page
    statement = seasons.revealed(service.database, "spring")
    packed = seasons.revealed_release(service.database, service.artefacts, "spring")
    with zipfile.ZipFile(BytesIO(packed)) as archive:
        revealed = archive.read(f"families/{FAMILY}/{PACKAGE}/family.py")
    assert revealed == SOURCE.read_bytes()
    shutil.rmtree(package)
    forget()
    assert seasons.verify_season(statement, packed, root, tmp_path / "proof") == 9, (
        "whoever verifies needs no package, and runs none"
    )


def test_other_files_than_were_committed_to_are_found(
    service: Service, tmp_path: Path, package: Path
) -> None:
    root, _ = opened(service, tmp_path / "private")
    service.close_season("spring")
    statement = seasons.revealed(service.database, "spring")
    packed = seasons.revealed_release(service.database, service.artefacts, "spring")
    forged = BytesIO()
    with zipfile.ZipFile(BytesIO(packed)) as old, zipfile.ZipFile(forged, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            new.writestr(name, data + b"\n" if name.endswith("family.py") else data)
    with pytest.raises(ValueError, match="the files of the family 'weary' are not those"):
        seasons.verify_season(statement, forged.getvalue(), root, tmp_path / "forged")


def test_a_changed_package_is_never_imported(
    service: Service, tmp_path: Path, package: Path
) -> None:
    """Its files change while the season is open: the server does not start, a worker does not play.

    Nor does it run what a received release holds.
    """
    opened(service, tmp_path / "private")
    registry = load_registry(tmp_path / "private" / "registry.json")
    [spec] = {e.spec for e in hidden_partners(registry, TASK) if e.algorithm == "own-weary"}
    marker = tmp_path / "ran"
    (package / "family.py").write_text(f"open({str(marker)!r}, 'w').close()\n")
    forget()
    with pytest.raises(Problem, match="season spring: the family 'weary' has files of sha256"):
        service.adopt_version()
    with pytest.raises(ValueError, match="install the package with these very files"):
        spec.player()
    with pytest.raises(Problem, match="install the package with these very files"):
        pack(tmp_path / "private")
    assert not marker.exists()


def test_a_received_release_names_a_family_and_brings_none(
    tmp_path: Path, package: Path, service: Service
) -> None:
    opened(service, tmp_path / "private")
    packed = pack(tmp_path / "private")
    shutil.rmtree(package)
    forget()
    registry = release_pack.unpack(packed, tmp_path / "received")
    [own] = own_families(registry)
    assert release_pack.revealed_program(own, tmp_path / "received") == own.sha256
    [spec] = {e.spec for e in hidden_partners(registry, TASK) if e.algorithm == "own-weary"}
    with pytest.raises((ValueError, ExtensionError), match="weary"):
        spec.player()
    assert PACKAGE not in sys.modules


def test_a_family_acts_otherwise_and_is_a_group_of_its_own(package: Path) -> None:
    program = files_sha256(installed_family(FAMILY).files())
    rows, obs = jnp.asarray(marked(persons(TASK)[:3])), jnp.full((3, SEAT_SIZES[TASK][0]), 0.1)
    actions = []
    for playing in (PersonPlayer(TASK), PersonPlayer(TASK, "weary", program)):
        carry = playing.initial_carry((3,))
        for first in (True, False, False):
            carry, action = playing.act({"row": rows}, carry, obs, jnp.full(3, first))
        actions.append(np.asarray(action))
        assert np.asarray(playing.word(carry)).shape == (3,)
    assert np.isfinite(actions).all() and not np.array_equal(*actions)
    assert group_of("own-weary") == OWN_FAMILY
    assert groups_of(["spring", "stepper", "own-weary", "ippo"]) == (
        *("known families", "unseen family", OWN_FAMILY, "teams"),
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Weary = 3\n", "a callable that takes a task and its model"),
        ("raise RuntimeError('not today')\n", "RuntimeError: not today"),
        ("def Weary(task, model):\n    return object()\n", "AttributeError"),
    ],
)
def test_a_family_that_cannot_act_is_no_season(
    tmp_path: Path, package: Path, text: str, message: str
) -> None:
    (package / "family.py").write_text(text)
    with pytest.raises(ExtensionError, match=message):
        add_persons(tmp_path / "private", TASK, 9, FAMILY)
    assert not (tmp_path / "private" / "registry.json").exists()


def test_the_command_names_what_is_installed(
    tmp_path: Path, package: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["season", "persons", str(tmp_path / "private"), "--task", TASK, "--count", "9"]
    assert run([*words, "--family", "gone"]) == 1
    assert "installed are weary" in capsys.readouterr().err
    assert run([*words[:-1], "2", "--family", FAMILY]) == 1
    assert "allowed are 3 to 1000" in capsys.readouterr().err
    assert run([*words, "--family", FAMILY]) == 0
    assert "a third of them of the family weary" in capsys.readouterr().out
    content = json.loads((tmp_path / "private" / "registry.json").read_text())
    assert content["releases"]["v1"]["persons"][TASK]["own"]["package"] == "outside"


def test_leaves_of_seasons_without_a_family_stay(service: Service, tmp_path: Path) -> None:
    [leaf] = [leaf for leaf in season_of(service, tmp_path)["secret"]["leaves"] if "seeds" in leaf]
    assert set(leaf["persons"]["v1"]) == {"program", "count", "sha256", "secret"}
