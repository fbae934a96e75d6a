"""Messages as msgpack: plain types alone, each with its fields and bounds. Never a pickle."""

from typing import Any

import msgpack
import numpy as np

Step = tuple[str, int]  # a batch and the number of a step in it
MAX_BYTES = 4 * 1024 * 1024
MAX_ROWS = 65_536
# The fields of each message and their types.
TYPES: dict[str, dict[str, type]] = {
    "observe": {"batch": str, "step": int, "rows": int, "numbers": bytes},
    "act": {"batch": str, "step": int, "rows": int, "numbers": bytes},
    "end": {"state": str},
}


def encode(kind: str, **fields: Any) -> bytes:
    """Return the bytes of a message."""
    return msgpack.packb({"type": kind, **fields}, use_bin_type=True)


def decode(data: Any, *kinds: str) -> dict[str, Any]:
    """Return a message of one of these types.

    Raises:
        ValueError: It is not one, or a field is missing, unknown or of another type.
    """
    if not isinstance(data, bytes) or len(data) > MAX_BYTES:
        raise ValueError(f"a message is at most {MAX_BYTES} bytes of msgpack")
    try:
        message = msgpack.unpackb(data, raw=False, strict_map_key=True, ext_hook=_no_extensions)
    except (ValueError, msgpack.UnpackException) as error:
        raise ValueError(f"not a message ({type(error).__name__})") from None
    if not isinstance(message, dict) or message.get("type") not in kinds:
        raise ValueError(f"expected a message of type {' or '.join(kinds)}")
    fields = TYPES[message.pop("type")]
    if message.keys() != fields.keys():
        raise ValueError(f"expected the fields {', '.join(fields)}")
    if wrong := [name for name, kind in fields.items() if type(message[name]) is not kind]:
        raise ValueError(f"field {wrong[0]} has another type")
    return message


def is_newer(step: Step, known: Step | None) -> bool:
    """Return whether a step comes after another: a request that is late must not undo one.

    Batches of one player are RUN.000001, RUN.000002; another player begins anew.
    """
    if known is None or step[0].partition(".")[0] != known[0].partition(".")[0]:
        return True
    return step > known


def pack_rows(rows: np.ndarray) -> dict[str, Any]:
    """Return the fields of an array [N, W]."""
    data = np.ascontiguousarray(rows, "<f4")
    return {"rows": int(data.shape[0]), "numbers": data.tobytes()}


def unpack_rows(message: dict[str, Any]) -> np.ndarray:
    """Return the array [N, W] of a message.

    Raises:
        ValueError: Its size does not fit the number of rows.
    """
    rows, size = message["rows"], len(message["numbers"])
    if not 1 <= rows <= MAX_ROWS or size == 0 or size % (4 * rows):
        raise ValueError(f"{size} bytes are not {rows} rows of numbers")
    return np.frombuffer(message["numbers"], "<f4").reshape(rows, -1).astype(np.float32)


def _no_extensions(code: int, data: bytes) -> None:
    raise ValueError("extension types are not allowed")
