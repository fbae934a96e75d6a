"""The worker's end: a callable that looks like any robot, and asks the live client."""

from typing import Any

import numpy as np

from assistax_board.client import Client
from assistax_board.ids import new_id
from assistax_board.live.messages import decode, encode, pack_rows, unpack_rows
from assistax_board.rules.scoring import Work


class LiveRobot:
    """Asks for actions [N, A] of observations [N, O], batch by batch."""

    def __init__(self, client: Client, work: Work) -> None:
        self._client, self._work = client, work
        self._run, self._batches = new_id(), 0
        self._step = 0

    def reset(self, rows: int) -> None:
        """Begin a batch of episodes."""
        self._batches += 1
        self._step = 0

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return the client's actions; wait for as long as the server allows it."""
        batch = f"{self._run}.{self._batches:06d}"
        message = encode("observe", batch=batch, step=self._step, **pack_rows(obs))
        self._step += 1
        headers: dict[str, Any] = {"X-Lease": self._work.lease}
        while True:
            path = f"/api/work/{self._work.job}/ask"
            response = self._client.call("POST", path, headers=headers, content=message)
            if response.status_code != 202:
                return unpack_rows(decode(response.content, "act"))
