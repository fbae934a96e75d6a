"""The submitter's end: dials out, answers observations, and comes back after a lost connection."""

import time
from typing import Any

from assistax_board.client import Client
from assistax_board.live.messages import MAX_BYTES, decode, encode, pack_rows, unpack_rows

PAUSE_SECONDS = 1.0  # between two attempts to connect
TRIES = 60  # in a row without a single message


def play_live(client: Client, submission: str, robot: Any, *, connect: Any = None) -> str:
    """Answer for a robot until its submission ends; return the state it ended in.

    Args:
        client: Of the server.
        submission: Id of the live submission.
        robot: A callable [N, O] -> [N, A] with `reset(N)`.
        connect: Opens a connection with `send` and `recv`; WebSocket if not given.

    Raises:
        OSError: The server could not be reached for about a minute.
    """
    answering, tries = _Answering(robot), 0
    while tries < TRIES:
        try:
            with (connect or _connect)(client, submission) as socket:
                while True:
                    data = socket.recv()
                    tries = 0
                    message = answering.answer(data)
                    if isinstance(message, str):
                        return message
                    socket.send(message)
        except (OSError, EOFError, _closed()) as error:
            tries += not _is_full(error)
            time.sleep(PAUSE_SECONDS)
    raise OSError("the server cannot be reached; the submission continues if you come back in time")


class _Answering:
    """Answers each step once: a robot with memory must not see one twice."""

    def __init__(self, robot: Any) -> None:
        self._robot = robot
        self._last: tuple[tuple[str, int] | None, bytes] = None, b""

    def answer(self, data: Any) -> bytes | str:
        """Return the answer to a message, or the state in which the submission ended."""
        if _is_end(data):
            return decode(data, "end")["state"]
        message = decode(data, "observe")
        step = message["batch"], message["step"]
        if step != self._last[0]:
            obs = unpack_rows(message)
            if message["step"] == 0 and callable(reset := getattr(self._robot, "reset", None)):
                reset(len(obs))
            fields = {"batch": step[0], "step": step[1], **pack_rows(self._robot(obs))}
            self._last = step, encode("act", **fields)
        return self._last[1]


def _is_end(data: Any) -> bool:
    try:
        decode(data, "end")
    except ValueError:
        return False
    return True


def _connect(client: Client, submission: str) -> Any:
    from websockets.sync.client import connect

    address = client.address.replace("http", "ws", 1) + f"/api/live/{submission}"
    return connect(address, additional_headers=client.headers, max_size=MAX_BYTES)


def _closed() -> type[Exception]:
    from websockets.exceptions import WebSocketException

    return WebSocketException


def _is_full(error: Exception) -> bool:
    """Return whether the server has too many robots of ours now; give up where it says no."""
    from websockets.exceptions import InvalidStatus

    status = error.response.status_code if isinstance(error, InvalidStatus) else None
    if status in (401, 403, 404):
        raise ValueError("the server has no live submission of this id for this token") from None
    return status == 429
