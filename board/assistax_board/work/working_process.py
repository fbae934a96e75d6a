"""A worker as a process, with its signals and its log; or as many as a Ray cluster has room for."""

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from assistax_base.cluster import RayCluster, run_blocks
from assistax_board.api.operations import log_to_stderr
from assistax_board.client import Client
from assistax_board.rules.catalogue import ZooCatalogue
from assistax_board.rules.scoring import Scorer
from assistax_board.serve import PARENT_VARIABLE
from assistax_board.work.worker import Worker
from assistax_board.work.zoo_scorer import ZooScorer


def run_worker(
    client: Client, registry: Path | None, backend: str, *, until_empty: bool = False
) -> None:
    """Work until SIGINT or SIGTERM; a job under way is given back."""
    log_to_stderr()
    worker = _worker(client, make_scorer(registry, backend), _start_anew)
    # XLA may compile for long before the main thread hears of anything.
    leaving = threading.Thread(target=_leave, args=(worker,), daemon=True)
    signal.signal(signal.SIGTERM, lambda *_: leaving.is_alive() or leaving.start())
    if parent := os.environ.get(PARENT_VARIABLE):
        threading.Thread(target=_outlive_not, args=(int(parent),), daemon=True).start()
    worker.run(until_empty=until_empty)


def run_workers_on_ray(
    cluster: RayCluster, client: Client, make: Callable[[], Scorer], *, until_empty: bool = False
) -> None:
    """Keep a cluster full of workers, each of which takes jobs of its own.

    What they do when this process ends is given to others as soon as its leases run out.
    """
    signal.signal(signal.SIGTERM, _exit)
    shared = client.address, client.token, make, until_empty
    with contextlib.suppress(SystemExit):
        run_blocks(cluster, _names, _work_elsewhere, shared)


def make_scorer(registry: Path | None, backend: str) -> Scorer:
    """Return a scorer with the partners of a registry; the default is the installed one."""
    from zoo.registry import load_registry

    loaded = load_registry(registry)
    return ZooScorer(loaded, ZooCatalogue(loaded, backend), backend)


def _worker(client: Client, scorer: Scorer, restart: Callable[[], Any] | None = None) -> Worker:
    options: dict[str, Any] = {} if restart is None else {"restart": restart}
    return Worker(client, scorer, **options)


def _start_anew() -> None:
    """Give this process, with its id, to a new start of the same command."""
    os.execv(sys.executable, [sys.executable, "-m", "assistax_zoo", *sys.argv[1:]])


def _names(slots: int) -> list[str]:
    return [f"worker {number + 1}" for number in range(slots)]


def _work_elsewhere(
    number: int,
    count: int,
    address: str,
    token: str | None,
    make: Callable[[], Scorer],
    until_empty: bool,
) -> None:
    log_to_stderr()
    _worker(Client(address, token), make()).run(until_empty=until_empty)


def _exit(*_: Any) -> None:
    raise SystemExit(0)


def _leave(worker: Worker) -> None:
    worker.leave()
    os._exit(0)


def _outlive_not(parent: int) -> None:
    """End when the server that started this worker is gone, however it went."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(0)
