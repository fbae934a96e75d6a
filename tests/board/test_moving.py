"""A folder remembers where its board lies, and a board moves whole or not at all."""

import json
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from assistax_board import folder
from assistax_board.checking import check_service
from assistax_board.rules.tokens import authenticate, list_tokens
from assistax_board.serve import only_server, open_service
from assistax_board.store import schema
from assistax_board.store.addresses import ADDRESSES_FILE, addresses_of
from assistax_board.store.backup import back_up
from assistax_board.store.migrations import moving
from assistax_board.store.schema import METADATA
from assistax_zoo.shell.main import run
from tests.board.fakes import close_spring, new_service, new_submitter, scored
from tests.board.test_season import open_season

NOBODY = "postgresql://zoo:secret-word@127.0.0.1:1/board"


def rows_of(service: Any) -> dict[str, list[Any]]:
    """Return all rows of a board, without their order."""
    with service.database.read() as connection:
        return {
            table.name: sorted(map(repr, connection.execute(sa.select(table))))
            for table in METADATA.sorted_tables
        }


def board_of(data: Path) -> Any:
    """Make a board with a closed season in a folder."""
    service = new_service(data)
    season, lab = open_season(service), new_submitter(service)
    service.add_references()
    scored(service, lab, 2.0, "first", season=season)
    close_spring(service)
    service.note("unexpected", "something")
    return service


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Run a command that must end in one line of error, and return that line."""
    assert run(list(words)) == 1
    [line] = capsys.readouterr().err.strip().splitlines()
    assert "secret-word" not in line
    return line


def test_a_folder_keeps_its_board(tmp_path: Path) -> None:
    data = tmp_path / "board"
    folder.about_token(open_service(data), data)
    before = (data / "organiser-token").read_text()
    with pytest.raises(ValueError, match=r"service\.db, not at .*zoo:\*\*\*@127.*service move"):
        open_service(data, database=NOBODY)
    new_service(data).artefacts.put(b"a robot")
    with pytest.raises(ValueError, match="artefacts, not at s3://other/files"):
        open_service(data, artefacts="s3://other/files")
    assert (data / "organiser-token").read_text() == before
    assert not (data / ADDRESSES_FILE).exists()
    same = f"sqlite:///{data / 'service.db'}"
    assert list_tokens(open_service(data, database=same).database)


def test_commands_find_a_board_elsewhere(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    data, elsewhere = tmp_path / "board", tmp_path / "elsewhere.db"
    monkeypatch.chdir(tmp_path)
    open_service(data, database="sqlite:///elsewhere.db", artefacts=str(tmp_path / "files"))
    assert (data / ADDRESSES_FILE).stat().st_mode & 0o777 == 0o600
    monkeypatch.chdir("/")
    assert run(["token", "create", "submit", "--submitter", "lab", "--data", str(data)]) == 0
    token = capsys.readouterr().out.strip()
    service = open_service(data)
    assert service.database.url.database == str(elsewhere)
    assert service.artefacts.address == str(tmp_path / "files")
    assert authenticate(service.database, token).scopes == ("submit",)
    assert run(["service", "check", "--data", str(data)]) == 0
    assert not (data / "service.db").exists()
    with pytest.raises(ValueError, match=r"elsewhere\.db; use that database's own backup"):
        back_up(data, tmp_path / "board.zip")
    (data / ADDRESSES_FILE).unlink()
    assert "has the key of a board" in refused(capsys, "token", "list", "--data", str(data))
    assert not (data / "service.db").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nonsense", "'nonsense' is no database's address; allowed are postgresql://"),
        ("zoo:secret-word@host", "'host' is no database's address"),
        ("mysql://host/name", "mysql://host/name is no place for a board"),
        ("sqlite://", "sqlite:// is no place for a board"),
        ("sqlite:////nowhere/board.db", "no folder /nowhere"),
        (NOBODY, r"127.0.0.1:1/board does not answer"),
    ],
)
def test_a_wrong_address_is_one_clear_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    data = tmp_path / "board"
    open_service(data)
    line = refused(capsys, "service", "move", "--data", str(data), "--to", text)
    assert message in line
    assert addresses_of(data).database.database == str(data / "service.db")


@pytest.mark.parametrize("text", ["{", "[]", '{"database": 7}', '{"databse": "x"}'])
def test_a_damaged_address_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / ADDRESSES_FILE).write_text(text)
    with pytest.raises(ValueError, match=r"addresses\.json is damaged; write"):
        open_service(tmp_path)
    assert not (tmp_path / "service.db").exists()


def test_a_new_password_is_the_same_database(tmp_path: Path) -> None:
    (tmp_path / ADDRESSES_FILE).write_text(json.dumps({"database": NOBODY}))
    renewed = NOBODY.replace("secret-word", "new")
    assert addresses_of(tmp_path, renewed).database.password == "new"
    with pytest.raises(ValueError, match="not at"):
        addresses_of(tmp_path, NOBODY.replace("/board", "/other"))


def test_a_board_moves_whole(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, target = tmp_path / "board", tmp_path / "moved.db"
    before = rows_of(board_of(data))
    assert all(before[name] for name in ("scores", "results", "receipts", "ledger", "notices"))
    assert run(["service", "move", "--data", str(data), "--to", f"sqlite:///{target}"]) == 0
    assert f"{sum(map(len, before.values()))} rows" in capsys.readouterr().out
    moved = open_service(data)
    assert moved.database.url.database == str(target)
    assert target.stat().st_mode & 0o777 == 0o600
    assert rows_of(moved) == before and check_service(moved)["whole"]


def test_a_board_moves_to_postgresql_and_back(tmp_path: Path, postgres_url: str) -> None:
    data, back = tmp_path / "board", tmp_path / "back.db"
    service = board_of(data)
    before = rows_of(service)
    moving.move_board(data, service.database, postgres_url.replace("+psycopg", ""))
    moved = open_service(data)
    assert not moved.database.is_sqlite
    assert rows_of(moved) == before and check_service(moved)["whole"]
    moving.move_board(data, moved.database, f"sqlite:///{back}")
    again = open_service(data)
    assert again.database.url.database == str(back)
    assert rows_of(again) == before and check_service(again)["whole"]
    moved.database.close()


def test_a_failed_move_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data, to = tmp_path / "board", f"sqlite:///{tmp_path / 'moved.db'}"
    service = board_of(data)
    before = rows_of(service)

    def full(*_: Any) -> None:
        raise OSError("no space left")

    for step in ("_batches", "keep_addresses"):
        with monkeypatch.context() as patch:
            patch.setattr(moving, step, full)
            with pytest.raises(OSError, match="no space"):
                moving.move_board(data, service.database, to)
        still = open_service(data)
        assert still.database.url.database == str(data / "service.db")
        assert rows_of(still) == before
    moving.move_board(data, service.database, to)  # the copy that is there is the board's
    assert rows_of(open_service(data)) == before


def test_a_row_that_a_database_cannot_hold_is_named(tmp_path: Path, postgres_url: str) -> None:
    service = new_service(tmp_path / "board")
    with service.database.write() as connection:  # SQLite does not count characters
        row = {"id": "lab", "name": "x" * 81, "created_at": 0.0}
        connection.execute(sa.insert(schema.submitters).values(row))
    with pytest.raises(ValueError, match=r"cannot hold a row of the board \(value too long"):
        moving.move_board(tmp_path / "board", service.database, postgres_url)
    assert addresses_of(tmp_path / "board").database.get_backend_name() == "sqlite"


def test_a_move_changes_no_other_board(tmp_path: Path) -> None:
    mine, other = board_of(tmp_path / "mine"), board_of(tmp_path / "other")
    before = rows_of(other)
    with pytest.raises(ValueError, match="holds other rows than the board; name a new"):
        moving.move_board(tmp_path / "mine", mine.database, str(other.database.url))
    with pytest.raises(ValueError, match="already"):
        moving.move_board(tmp_path / "mine", mine.database, str(mine.database.url))
    assert rows_of(other) == before


def test_no_board_moves_under_a_server(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tmp_path / "board"
    open_service(data)
    with only_server(data):
        line = refused(capsys, "service", "move", "--data", str(data), "--to", "sqlite:////tmp/x")
    assert "another server runs on" in line
