"""A worker as a process: its signals, its log, its scorer."""

import functools
import os
import signal
import threading
import time
from pathlib import Path

from assistax_zoo.service.api.operations import log_to_stderr
from assistax_zoo.service.catalogue import ZooCatalogue
from assistax_zoo.service.client import Client
from assistax_zoo.service.live.robot import LiveRobot
from assistax_zoo.service.serve import PARENT_VARIABLE
from assistax_zoo.service.worker import Worker
from assistax_zoo.service.zoo_scorer import ZooScorer


def run_worker(
    client: Client, registry: Path | None, backend: str, *, until_empty: bool = False
) -> None:
    """Work until SIGINT or SIGTERM; a job under way is given back."""
    from zoo.registry import load_registry

    log_to_stderr()
    loaded = load_registry(registry)
    scorer = ZooScorer(loaded, ZooCatalogue(loaded, backend), backend)
    worker = Worker(client, scorer, live=functools.partial(LiveRobot, client))
    # XLA may compile for long before the main thread hears of anything.
    leaving = threading.Thread(target=_leave, args=(worker,), daemon=True)
    signal.signal(signal.SIGTERM, lambda *_: leaving.is_alive() or leaving.start())
    if parent := os.environ.get(PARENT_VARIABLE):
        threading.Thread(target=_outlive_not, args=(int(parent),), daemon=True).start()
    worker.run(until_empty=until_empty)


def _leave(worker: Worker) -> None:
    worker.leave()
    os._exit(0)


def _outlive_not(parent: int) -> None:
    """End when the server that started this worker is gone, however it went."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(0)
