"""Episode table: one row an episode, and every metric is recomputed from it."""

import dataclasses
import errno
import io
import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from assistax_base import parquet
from assistax_base.files import atomic_write

# Names of the files in the folder that `evaluate --out` or `crossplay --out` fills.
EPISODES_FILE = "episodes.parquet"  # one row an episode
PAIRS_FILE = "pairs.parquet"  # one row an (ego, partner) pair: the cross-play matrix in long form
REFERENCES_FILE = "references.parquet"  # episodes of the reference egos
BOUNDS_FILE = "bounds.parquet"  # low and best return of each partner, with their sources
PARTNERS_FILE = "partners.parquet"  # one row a partner, averaged over the egos
PROFILE_FILE = "profile.parquet"  # performance profile of an evaluation
ORDER_FILE = "order.json"  # clustered order of a cross-play matrix
STRATEGIES_FILE = "strategies.json"  # partners of a cross-play by behaviour
RUN_FILE = "run.json"  # command, machine and versions
SUMMARY_FILE = "summary.json"  # the object that --json prints
MATRIX_FIGURE = "crossplay.png"  # the clustered matrix, drawn
FILES = (
    *(EPISODES_FILE, PAIRS_FILE, REFERENCES_FILE, BOUNDS_FILE, PARTNERS_FILE, PROFILE_FILE),
    *(ORDER_FILE, STRATEGIES_FILE, RUN_FILE, SUMMARY_FILE, MATRIX_FIGURE),
)
# Drawn from the episodes, with the options of the command that drew them.
DERIVED_FILES = tuple(name for name in FILES if name not in (EPISODES_FILE, RUN_FILE))

LARGEST_JSON = 1 << 26  # bytes of a file that is read; a matrix of all teams has less than a 30th
SIDES = ("train", "test")
TERM_PREFIX = "term_"

# Columns of the table beside the reward terms (`term_<name>`, Float32), which differ by task.
SCHEMA: dict[str, pl.DataType] = {
    "ego": pl.String(),
    "ego_team": pl.String(),
    "ego_algorithm": pl.String(),
    "ego_disability": pl.String(),
    "ego_seed": pl.Int64(),
    "partner": pl.String(),
    "partner_team": pl.String(),
    "partner_algorithm": pl.String(),
    "partner_disability": pl.String(),
    "partner_seed": pl.Int64(),
    "side": pl.String(),
    "episode": pl.Int64(),
    "place": pl.Int64(),  # of the episode in its series, from 1, where a robot remembers a partner
    "preference": pl.String(),
    "key": pl.Int64(),
    "return": pl.Float32(),
    "discounted_return": pl.Float32(),
    "success": pl.Boolean(),
    "force_mean": pl.Float32(),
    "force_peak": pl.Float32(),
    "contact_peak": pl.Float32(),  # N, of one contact
    "violated": pl.Boolean(),  # one was above the hard limit
    "first_contact": pl.Int64(),  # steps until the first contact; all of them if there was none
    "distance_mean": pl.Float32(),
    "robot_travel": pl.Float32(),  # rad, summed over joints and steps
    "human_travel": pl.Float32(),
    "nonfinite": pl.Boolean(),
    "steps": pl.Int64(),
    # Share of the numbers of a robot from outside that were beyond [-1, 1]; null of other robots.
    "clipped": pl.Float32(),
}
BEHAVIOUR = (
    "first_contact",
    "distance_mean",
    "robot_travel",
    "human_travel",
)  # tables of manifest format 1 lack them
GENTLE = ("preference", "contact_peak", "violated")  # of the gentle tasks alone
EGO_COLUMNS = tuple(name for name in SCHEMA if name.startswith("ego"))
PARTNER_COLUMNS = (*(name for name in SCHEMA if name.startswith("partner")), "side")
_NULLABLE = (*EGO_COLUMNS[1:], *PARTNER_COLUMNS[1:], "clipped")  # of an ego from outside the zoo


_GENTLE = ("preferences", "safe", "violated")  # fields of a block that only gentle tasks fill


@dataclasses.dataclass(frozen=True)
class Block:
    """Every ego with every partner for the same episodes, as dense arrays."""

    returns: np.ndarray  # [E, P, K] undiscounted returns
    nonfinite: np.ndarray  # [E, P, K] whether the physics became non-finite
    egos: pl.DataFrame  # E rows of EGO_COLUMNS, in the order of the first axis
    partners: pl.DataFrame  # P rows of PARTNER_COLUMNS, in the order of the second axis
    episodes: np.ndarray  # [K] episode numbers
    # [P, K] seeds of each partner's episodes; None where its egos met different ones.
    keys: np.ndarray | None
    # Of a gentle task: under which preference each episode was played, and whether the goal was
    # reached and nobody hurt.
    preferences: np.ndarray | None = None  # [E, P, K]
    safe: np.ndarray | None = None  # [E, P, K] bool
    violated: np.ndarray | None = None  # [E, P, K] bool

    def evaluated_side(self) -> "Block":
        """Return the block with the test partners, or the training partners if only those played.

        Raises:
            ValueError: no partner is on a side.
        """
        sides = self.partners["side"]
        side = next((one for one in ("test", "train") if one in sides), None)
        if side is None:
            raise ValueError(
                "no partner is on the test or the train side; evaluate against a split"
            )
        return self.select_partners((sides == side).fill_null(value=False).to_numpy())

    @property
    def common_starts(self) -> bool:
        """Whether all partners played the same starts, so that their luck is common to all."""
        return self.keys is not None and len(self.keys) > 1 and not np.ptp(self.keys, axis=0).any()

    @property
    def scores(self) -> np.ndarray:
        """Mean return J of each pair over its episodes, [E, P]."""
        return self.returns.mean(axis=2)

    def select_partners(self, mask: np.ndarray) -> "Block":
        """Return the block with only the partners where `mask` [P] is true."""
        return dataclasses.replace(
            self,
            returns=self.returns[:, mask],
            nonfinite=self.nonfinite[:, mask],
            keys=None if self.keys is None else self.keys[mask],
            **{name: one[:, mask] for name in _GENTLE if (one := getattr(self, name)) is not None},
            partners=self.partners.filter(pl.Series(mask)),
        )


def term_columns(table: pl.DataFrame) -> tuple[str, ...]:
    """Return the names of the reward-term columns, in the table's order."""
    return tuple(name for name in table.columns if name.startswith(TERM_PREFIX))


def with_safety(table: pl.DataFrame) -> pl.DataFrame:
    """Add `safe_success` to a table of a gentle task: the goal was reached, and nobody was hurt."""
    if "violated" not in table.columns:
        return table
    return table.with_columns(safe_success=pl.col("success") & ~pl.col("violated"))


def outcome_columns(table: pl.DataFrame) -> tuple[str, ...]:
    """Return the columns that tell how episodes went beside the return, of those the table has."""
    names = ("success", "safe_success", "violated", "force_mean", "force_peak", "contact_peak")
    return tuple(name for name in names if name in table.columns)


def validate_episodes(table: pl.DataFrame) -> pl.DataFrame:
    """Return the table, or raise `ValueError` saying what is wrong with it and where."""
    needed = [name for name in SCHEMA if name not in (*BEHAVIOUR, *GENTLE, "place", "clipped")]
    missing = [name for name in needed if name not in table.columns]
    if missing:
        raise ValueError(
            f"the episode table lacks the columns {', '.join(missing)}; it needs all of "
            f"{', '.join(needed)}"
        )
    unknown = [
        name for name in table.columns if name not in SCHEMA and not name.startswith(TERM_PREFIX)
    ]
    if unknown:
        raise ValueError(
            f"the episode table has unknown columns {', '.join(unknown)}; reward terms begin with "
            "term_"
        )
    if table.is_empty():
        raise ValueError("the episode table has no rows; at least one episode is needed")
    for name in table.columns:
        _validate_column(table, name)
    sides = [side for side in table["side"].drop_nulls().unique().sort() if side not in SIDES]
    if sides:
        raise ValueError(
            f"column side holds {', '.join(map(repr, sides))}; allowed are 'train', 'test' and null"
        )
    return table


def dense_block(table: pl.DataFrame) -> Block:
    """Lay a table out as [E, P, K].

    Algorithm, disability, seed, then id give the order of egos and partners.

    Raises:
        ValueError: a pair lacks an episode or has one twice, or one id has two descriptions.
    """
    validate_episodes(table)
    egos = _described(table, EGO_COLUMNS)
    partners = _described(table, PARTNER_COLUMNS)
    episodes = table["episode"].unique().sort().to_numpy()
    shape = (egos.height, partners.height, len(episodes))
    cells = _cells(table, egos["ego"], partners["partner"], episodes, shape)
    returns, nonfinite = np.empty(np.prod(shape)), np.empty(np.prod(shape), bool)
    returns[cells], nonfinite[cells] = table["return"].to_numpy(), table["nonfinite"].to_numpy()
    keys = np.empty(np.prod(shape), np.int64)
    keys[cells] = table["key"].to_numpy()
    keys = keys.reshape(shape)

    def laid_out(name: str) -> np.ndarray | None:
        if name not in table.columns:
            return None
        values = np.empty(np.prod(shape), object if table[name].dtype == pl.String else bool)
        values[cells] = table[name].to_numpy()
        return values.reshape(shape)

    table = with_safety(table)
    return Block(
        preferences=laid_out("preference"),
        safe=laid_out("safe_success"),
        violated=laid_out("violated"),
        returns=returns.reshape(shape),
        nonfinite=nonfinite.reshape(shape),
        egos=egos,
        partners=partners,
        episodes=episodes,
        keys=None if np.ptp(keys, axis=0).any() else keys[0],
    )


def pair_table(table: pl.DataFrame) -> pl.DataFrame:
    """Average the episodes of each pair: one row a pair, in the order of `dense_block`."""
    block, table = dense_block(table), with_safety(table)
    behaviour = [name for name in BEHAVIOUR if name in table.columns]
    measures = (
        "discounted_return",
        *term_columns(table),
        *outcome_columns(table),
        *behaviour,
    )
    means = table.group_by("ego", "partner").agg(
        pl.col("return").cast(pl.Float64).mean(),
        pl.col("return").cast(pl.Float64).std().alias("return_sd"),
        *(pl.col(name).cast(pl.Float64).mean() for name in measures),
        pl.len().cast(pl.Int64).alias("episodes"),
        pl.col("nonfinite").sum().cast(pl.Int64),
    )
    pairs = block.egos.join(block.partners, how="cross", maintain_order="left_right")
    return pairs.join(means, on=["ego", "partner"], how="left", maintain_order="left")


def write_episodes(table: pl.DataFrame, path: Path) -> None:
    """Validate the table, bring it to `SCHEMA`'s types and write it, whole or not at all."""
    validate_episodes(table)
    types = {**SCHEMA, **{name: pl.Float32() for name in term_columns(table)}}
    write_parquet(table.select(pl.col(name).cast(types[name]) for name in table.columns), path)


def read_episodes(path: Path) -> pl.DataFrame:
    """Read an episode table and validate it."""
    return validate_episodes(read_parquet(path))


def write_parquet(table: pl.DataFrame, path: Path) -> None:
    """Write a table as Parquet: the file appears complete or not at all."""
    write_bytes(parquet_bytes(table), path)


def parquet_bytes(table: pl.DataFrame) -> bytes:
    """Return a table as Parquet, made in memory: on a full disk Polars' own error misleads."""
    content = io.BytesIO()
    table.write_parquet(content, compression="zstd")
    return content.getvalue()


def read_parquet(path: Path) -> pl.DataFrame:
    """Read a Parquet file; a missing or damaged one is reported with its path."""
    _check_there(path)
    parquet.check_size(path)
    return parquet.read_parquet(path)


def write_bytes(data: bytes, path: Path) -> None:
    """Write a file: it appears complete or not at all, and a full disk is called so."""
    try:
        atomic_write(path, data)
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise OSError(
            f"the disk is full: {path} needs {len(data)} bytes; make room, then the same command "
            "goes on"
        ) from None


def remove_derived(folder: Path, but: Collection[str] = ()) -> None:
    """Remove tables and figures that were drawn from a folder's episodes, but for some."""
    for name in set(DERIVED_FILES).difference(but):
        (folder / name).unlink(missing_ok=True)


def to_json(value: Any) -> Any:
    """Return what `json.dumps` takes: dataclasses as objects by field, tuples as lists."""
    if dataclasses.is_dataclass(value):
        return {one.name: to_json(getattr(value, one.name)) for one in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {name: to_json(item) for name, item in value.items()}
    return [to_json(item) for item in value] if isinstance(value, (list, tuple)) else value


def write_json(content: Any, path: Path) -> None:
    """Write JSON without NaN or infinity: the file appears complete or not at all."""
    text = json.dumps(to_json(content), indent=2, allow_nan=False)
    write_bytes((text + "\n").encode(), path)


def read_json(path: Path) -> dict:
    """Read a JSON object; a missing or damaged file is reported with its path."""
    _check_there(path)
    try:
        if (size := path.stat().st_size) > LARGEST_JSON:
            raise ValueError(f"it has {size} bytes; at most {LARGEST_JSON} are read")
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(
            f"{path} is not readable JSON ({error}); delete it and run again"
        ) from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds a {type(content).__name__}; expected an object")
    return content


def _check_there(path: Path) -> None:
    if not path.is_file():
        raise FileNotFoundError(
            f"{path} does not exist; run `assistax-zoo evaluate` or `crossplay` with --out first"
        )


def _validate_column(table: pl.DataFrame, name: str) -> None:
    column, expected = table[name], SCHEMA.get(name, pl.Float32())
    if column.dtype == pl.Null and name in _NULLABLE:
        return
    if not _same_family(column.dtype, expected):
        raise ValueError(f"column {name} is {column.dtype}; expected {expected}")
    if name not in _NULLABLE and column.null_count():
        raise ValueError(
            f"column {name} has {column.null_count()} empty values; every episode needs one"
        )
    if expected.is_float():
        bad = table.filter(~column.is_finite())
        if bad.height:
            ego, partner, episode, value = bad.select("ego", "partner", "episode", name).row(0)
            raise ValueError(
                f"column {name} has {bad.height} values that are not finite, first {value} for ego "
                f"{ego} with {partner}, episode {episode}; a broken episode must be frozen at "
                "reward 0 and marked nonfinite"
            )


def _same_family(dtype: pl.DataType, expected: pl.DataType) -> bool:
    if expected.is_integer():
        return dtype.is_integer()
    if expected.is_float():
        return dtype.is_float()
    return dtype == expected


def _described(table: pl.DataFrame, columns: tuple[str, ...]) -> pl.DataFrame:
    identity, _, algorithm, disability, seed = columns[:5]
    rows = (
        table.select(columns).unique().sort(algorithm, disability, seed, identity, nulls_last=True)
    )
    twice = rows.filter(pl.col(identity).is_duplicated())
    if twice.height:
        name = twice[identity][0]
        one = twice.filter(twice[identity] == name)
        differing = [column for column in columns if one[column].n_unique() > 1]
        raise ValueError(
            f"{identity} {name} has several values of {', '.join(differing)}; one is allowed"
        )
    return rows


def _cells(
    table: pl.DataFrame,
    egos: pl.Series,
    partners: pl.Series,
    episodes: np.ndarray,
    shape: tuple[int, int, int],
) -> np.ndarray:
    ego = table["ego"].replace_strict(egos, np.arange(shape[0]), return_dtype=pl.Int64).to_numpy()
    partner = (
        table["partner"]
        .replace_strict(partners, np.arange(shape[1]), return_dtype=pl.Int64)
        .to_numpy()
    )
    cells = np.ravel_multi_index(
        (ego, partner, np.searchsorted(episodes, table["episode"].to_numpy())), shape
    )
    counts = np.bincount(cells, minlength=int(np.prod(shape)))
    wrong = np.flatnonzero(counts != 1)
    if wrong.size:
        e, p, k = np.unravel_index(wrong[0], shape)
        raise ValueError(
            f"{wrong.size} of {counts.size} episodes are missing or doubled, first ego "
            f"{egos[int(e)]} with {partners[int(p)]}, episode {episodes[k]}: found "
            f"{counts[wrong[0]]} times, expected once; finish the run, or remove the doubled rows"
        )
    return cells
