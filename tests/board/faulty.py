"""A server or a worker without JAX, as a process to be killed.

python -m tests.board.faulty serve FOLDER DATABASE PORT [VERSION]
python -m tests.board.faulty work ADDRESS TOKEN [VERSION]
"""

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

from sqlalchemy import event

from assistax_board.client import Client
from assistax_board.rules import jobs
from assistax_board.rules.scoring import Work
from assistax_board.service import Service
from assistax_board.store import artefacts
from assistax_board.work.worker import Worker
from tests.board.fakes import FakeScorer, new_service

LEASE_SECONDS = 10.0  # shorter than in earnest: who waits for a killed worker waits for this
PATIENCE = 300.0


class SlowScorer(FakeScorer):
    """Takes a moment, so that a kill may strike within a job."""

    def play(self, work: Work, robot: Any, release: bytes | None) -> Any:
        time.sleep(0.2)
        return super().play(work, robot, release)


def real_service(folder: Path, url: str, version: int = 1) -> Service:
    """Return the service of the fakes by the machine's own clock."""
    jobs.LEASE_SECONDS = LEASE_SECONDS
    return dataclasses.replace(new_service(folder, url, version=version), clock=time.time)


def disk_that_fills(service: Service, folder: Path) -> None:
    """Let nothing more be written while there is a file FOLDER/full."""
    full, write = folder / "full", artefacts.atomic_write

    def bounded(path: Path, data: bytes) -> None:
        if full.exists():
            raise OSError(28, "No space left on device")
        write(path, data)

    @event.listens_for(service.database.engine, "checkout")
    def bound(connection: Any, *_: Any) -> None:
        pages = connection.execute("PRAGMA page_count").fetchone()[0]
        connection.execute(f"PRAGMA max_page_count={pages if full.exists() else 1_000_000}")

    artefacts.atomic_write = bounded  # ty: ignore[invalid-assignment]


def main(how: str, *words: str) -> None:
    if how == "work":
        address, token, version = (*words, "1")[:3]
        client = Client(address, token, patience=PATIENCE)
        Worker(client, SlowScorer(int(version)), idle=0.1, beat=LEASE_SECONDS / 4).run()
        return
    import uvicorn

    from assistax_board.app import create_app
    from assistax_board.serve import config_of, listen

    folder, url, port, version = (*words, "1")[:4]
    service = real_service(Path(folder), url, int(version))
    service.adopt_version()  # as `serve` does
    if service.database.is_sqlite:
        disk_that_fills(service, Path(folder))
    app = create_app(service)
    with listen("127.0.0.1", int(port)) as (_, listeners):
        uvicorn.Server(config_of(app)).run(listeners)


if __name__ == "__main__":
    main(*sys.argv[1:])
