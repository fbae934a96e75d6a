"""What a worker is asked to play, and who plays it: one interface, so that tests inject one."""

import dataclasses
import io
from typing import Any, Protocol

import polars as pl

from assistax_zoo.service.catalogue import Partner
from assistax_zoo.service.problems import Problem

# Columns of a result, in this order: nothing else leaves a worker.
COLUMNS = {
    "partner": pl.String(),
    "algorithm": pl.String(),
    "disability": pl.String(),
    "episode": pl.Int32(),
    "return": pl.Float32(),
    "success": pl.Boolean(),
    "nonfinite": pl.Boolean(),
}
MAX_TABLE_BYTES = 4 * 1024 * 1024


@dataclasses.dataclass(frozen=True)
class Work:
    """One job with all that a worker needs to play it; JSON-ready."""

    job: str
    lease: str  # the lease's secret
    submission: str
    task: str
    kind: str  # "file" or "live"
    format: str | None
    artefact: str | None  # sha256 of the robot
    release: str | None  # sha256 of the private release; None for the public panel
    version: str
    panel: str
    chunk: int
    partners: tuple[str, ...]  # ids; of a private release ordinals, such as "hidden-0007"
    episodes: int
    seed: str  # hexadecimal, up to 128 bits: JSON readers elsewhere would round it


class Scorer(Protocol):
    """Plays the partners of a piece of work with a robot."""

    def versions(self) -> tuple[str, ...]:
        """Return the ids of the versions that this installation scores."""
        ...

    def play(self, work: Work, robot: Any, release: bytes | None) -> pl.DataFrame:
        """Return one row an episode, with the columns of `COLUMNS`.

        Args:
            work: What is played.
            robot: The file's bytes, or a callable [N, O] -> [N, A] for a live robot.
            release: The packed private release, of a hidden panel.

        Raises:
            Refusal: The robot cannot be played.
        """
        ...


def encode_table(table: pl.DataFrame) -> bytes:
    """Return a result's bytes, in one order: who played it does not show."""
    typed = table.select(pl.col(name).cast(kind) for name, kind in COLUMNS.items())
    buffer = io.BytesIO()
    typed.sort("partner", "episode").write_parquet(buffer, compression="zstd")
    return buffer.getvalue()


def decode_table(data: bytes, partners: tuple[str, ...], episodes: int) -> pl.DataFrame:
    """Return a result that has every episode of these partners once, and nothing else.

    Raises:
        Problem: It has not.
    """
    if len(data) > MAX_TABLE_BYTES:
        raise Problem("too_large", f"a result has at most {MAX_TABLE_BYTES} bytes")
    try:
        table = pl.read_parquet(io.BytesIO(data))
    except Exception as error:  # whatever the reader makes of foreign bytes
        raise Problem("invalid", f"the result is no table ({type(error).__name__})") from None
    if dict(table.schema) != COLUMNS:
        raise Problem("invalid", f"a result has the columns {', '.join(COLUMNS)}, in these types")
    expected = {(name, episode) for name in partners for episode in range(episodes)}
    found = table.select("partner", "episode").rows()
    if len(found) != len(expected) or set(found) != expected:
        raise Problem("invalid", "the result lacks episodes of this job, or has others")
    if table.null_count().sum_horizontal().item() or not table["return"].is_finite().all():
        raise Problem("invalid", "the result has values that are missing or not finite")
    return table


def cut(panel: tuple[Partner, ...], size: int) -> list[tuple[Partner, ...]]:
    """Cut a panel into chunks; who plays them, and how many at once, changes nothing."""
    return [panel[start : start + size] for start in range(0, len(panel), size)]
