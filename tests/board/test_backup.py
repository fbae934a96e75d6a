"""A backup is whole although the server goes on, and what it holds goes on where it is restored."""

import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from assistax_board.checking import check_service
from assistax_board.store.backup import back_up, restore
from tests.board.fakes import advance, draft, new_service, new_submitter, scored, shown, work_off
from tests.board.test_season import open_season


def test_backup_of_running_server_restores_and_continues(tmp_path: Path) -> None:
    service = new_service(tmp_path / "board")
    season, lab = open_season(service, budget=100), new_submitter(service)
    id = scored(service, lab, 2.0, "first", season=season)
    over, count = threading.Event(), [0]

    def go_on() -> None:
        while not over.is_set():
            count[0] += 1
            service.submit(lab, draft(float(count[0]), f"r{count[0]}", season=season))
            work_off(service, most=3)

    thread = threading.Thread(target=go_on)
    thread.start()
    try:
        for number in range(3):
            seen = count[0]
            while count[0] == seen:
                time.sleep(0.001)
            back_up(tmp_path / "board", tmp_path / f"{number}.zip")
    finally:
        over.set()
        thread.join()
    for number in range(3):
        restore(tmp_path / f"{number}.zip", tmp_path / str(number))
        again = new_service(tmp_path / str(number))
        assert check_service(again)["whole"]
        advance(again, 3600.0)  # leases of the workers that it had then are over
        work_off(again)
        assert {row.state for row in again.queries.submissions(limit=1000)} == {"scored"}
        assert again.queries.receipt(id) == service.queries.receipt(id)
        assert shown(again, id).attempt == "spent"
        assert again.queries.season(season) == service.queries.season(season)


def test_restore_finds_a_file_the_backup_lacks(tmp_path: Path) -> None:
    service = new_service(tmp_path / "board")
    id = scored(service, new_submitter(service))
    back_up(tmp_path / "board", tmp_path / "whole.zip")
    name = str(shown(service, id).artefact)
    with (
        zipfile.ZipFile(tmp_path / "whole.zip") as source,
        zipfile.ZipFile(tmp_path / "less.zip", "w") as target,
    ):
        for row in source.namelist():
            if name not in row:
                target.writestr(row, source.read(row))
    restore(tmp_path / "less.zip", tmp_path / "again")
    with pytest.raises(ValueError, match=name):
        check_service(new_service(tmp_path / "again"))


def test_a_backup_replaces_nothing(tmp_path: Path) -> None:
    new_service(tmp_path / "board")
    back_up(tmp_path / "board", tmp_path / "board.zip")
    with pytest.raises(ValueError, match="exists"):
        back_up(tmp_path / "board", tmp_path / "board.zip")
    with pytest.raises(ValueError, match="not empty"):
        restore(tmp_path / "board.zip", tmp_path / "board")
    (tmp_path / "no.zip").write_bytes(b"PK\x05\x06" + bytes(18))
    with pytest.raises(ValueError, match="not a service's backup"):
        restore(tmp_path / "no.zip", tmp_path / "new")


def test_backup_lacking_named_files_is_refused(tmp_path: Path) -> None:
    """As where artefacts are in an object store, and the folder holds none."""
    service = new_service(tmp_path / "board")
    service.submit(new_submitter(service), draft())
    (tmp_path / "board" / "artefacts").rename(tmp_path / "elsewhere")
    with pytest.raises(ValueError, match=r"1 of 1 artefacts are not in .*store's own backup"):
        back_up(tmp_path / "board", tmp_path / "board.zip")
    assert not (tmp_path / "board.zip").exists()


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_database_is_not_backed_up(tmp_path: Path, seed: int) -> None:
    service = new_service(tmp_path / "board")
    scored(service, new_submitter(service))
    service.database.close()
    path = tmp_path / "board" / "service.db"
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(seed)
    for page in rng.choice(len(data) // 4096 - 1, 6, replace=False) + 1:
        data[page * 4096 : page * 4096 + 512] = rng.bytes(512)
    path.write_bytes(bytes(data))
    with pytest.raises(ValueError, match=r"service.db is damaged .*restore the newest backup"):
        back_up(tmp_path / "board", tmp_path / "board.zip")
    assert not (tmp_path / "board.zip").exists()
