"""The server of a rehearsal: a process that is stopped, killed and started again."""

import contextlib
import re
import signal
import subprocess
import sys
import time
from collections.abc import Generator

from assistax_board.client import Client
from assistax_board.rehearsal.stage import LIMIT_SECONDS, Stage


class Server:
    """`assistax-zoo serve` with one worker, at one address however often it starts; its log."""

    def __init__(self, stage: Stage) -> None:
        self._stage, self._log = stage, stage.folder / "server.log"
        self.address = "http://127.0.0.1:0"  # a free port, until it has started once

    def start(self, backend: str) -> None:
        """Start it on an engine, and wait until it answers.

        Raises:
            ValueError: It ended instead, or does not answer for half an hour.
        """
        began = self._log.stat().st_size if self._log.exists() else 0
        port = self.address.rpartition(":")[2]
        words = ["serve", "--data", str(self._stage.data), "--port", port]
        words += ["--backend", backend, "--no-references"]
        words += ["--registry", str(self._stage.public)]
        with self._log.open("a") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "assistax_zoo", *words], stderr=file
            )
        end = time.monotonic() + LIMIT_SECONDS
        while not self._serves(self._log.read_text()[began:]):
            if time.monotonic() > end:
                raise ValueError(f"the server does not start; see {self._log}")
            time.sleep(0.2)
        with contextlib.closing(Client(self.address, patience=LIMIT_SECONDS)) as client:
            client.about()

    def _serves(self, output: str) -> bool:
        if self.process.poll() is not None:
            raise ValueError(f"the server ended: {output[-1000:].strip()}")
        if found := re.search(r"serving (\S+) from ", output):
            self.address = found[1]
        return found is not None

    def stop(self) -> None:
        """Stop it as Ctrl-C does.

        Raises:
            ValueError: It ends with an error.
        """
        self.process.send_signal(signal.SIGTERM)
        if code := self.process.wait(LIMIT_SECONDS):
            raise ValueError(f"the server ended with exit code {code}; see {self._log}")

    def kill(self) -> None:
        """Kill it (SIGKILL); its worker sees that and ends."""
        self.process.kill()
        self.process.wait()


@contextlib.contextmanager
def running_server(stage: Stage) -> Generator[Server]:
    """Run a server of the version before; at the end, stop the server that then runs."""
    server = Server(stage)
    server.start(stage.older)
    try:
        yield server
    except BaseException:
        server.kill()
        raise
    if server.process.poll() is None:
        server.stop()
