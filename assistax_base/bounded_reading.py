"""Reading of foreign text within bounds, and of JSON without traps.

Bounds come before parsing. Keys that stand twice in an object are refused, since parsers differ in
which of them counts.
"""

import collections
import json
from pathlib import Path
from typing import Any, NoReturn

from assistax_base.errors import ZooError, lacks_memory, shorten

MAX_REGISTRY_BYTES = 16 * 1024 * 1024  # of 30 times the paper's teams
MAX_VALUES = 250_000  # commas; the registry of the 434 teams of the paper has a tenth


def read_text(path: Path, limit: int, error: type[ZooError], what: str, remedy: str) -> str:
    """Return a file's text.

    Raises:
        ZooError: Of the kind given: it is missing, no regular file, too large, or not UTF-8.
    """
    try:
        if not path.is_file():
            raise FileNotFoundError
        with path.open("rb") as file:
            data = file.read(limit + 1)
        if len(data) > limit:
            raise ValueError(f"more than {limit} bytes")
        return data.decode("utf-8")
    except FileNotFoundError:
        found = "no such file"
    except (OSError, ValueError) as problem:
        if lacks_memory(problem):
            raise MemoryError(f"{path} was not read, and may be whole") from None
        found = str(problem)
    expected = f"a readable file of at most {limit} bytes"
    raise error(f"{what} {path}", expected, found, remedy, "nothing was loaded")


def parse_json(text: str, most: int = MAX_VALUES) -> Any:
    """Return the value of JSON text of `most` values or fewer.

    Raises:
        ValueError: It is no JSON, has a key twice in one object, a number that is NaN or infinite,
            or too many values.
        RecursionError: It is nested too deeply.
    """
    if text.count(",") > most:
        raise ValueError(f"more than {most} values")
    return json.loads(text, object_pairs_hook=unique, parse_constant=_refuse_constant)


def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the object of these keys and values, each key once."""
    table = dict(pairs)
    if len(table) != len(pairs):
        counts = collections.Counter(name for name, _ in pairs)
        raise ValueError(f"key {shorten(counts.most_common(1)[0][0])} stands twice in one object")
    return table


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name}, which is not a JSON number")
