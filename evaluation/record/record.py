"""The record of a run: its episodes as dense arrays, from which figures and tables are made."""

import dataclasses
import functools
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from jaxtyping import Bool, Float, Int, Shaped

from assistax_envs.persons.rows import TEAMS, groups_of
from evaluation.record.columns import (
    EGO_COLUMNS,
    PARTNER_COLUMNS,
    SIDES,
    TOUCH,
    measures_care,
    validate_episodes,
)
from evaluation.record.manifest import read_manifest
from evaluation.record.tables import EPISODES_FILE, read_episodes
from zoo.partners.person_ids import OWN


@dataclasses.dataclass(frozen=True, eq=False)
class Returns:
    """Returns of every ego with every partner for the same episodes, as dense arrays."""

    values: Float[np.ndarray, "E P K"]  # undiscounted returns
    nonfinite: Bool[np.ndarray, "E P K"]  # whether the physics became non-finite
    pair_keys: Int[np.ndarray, "E P K"]  # seeds of the episodes
    egos: pl.DataFrame  # E rows of EGO_COLUMNS, in the order of the first axis
    partners: pl.DataFrame  # P rows of PARTNER_COLUMNS, in the order of the second axis
    episodes: Int[np.ndarray, " K"]  # episode numbers
    table: pl.DataFrame = dataclasses.field(repr=False)  # one row an episode
    rows: Int[np.ndarray, "E P K"]  # row of the table of each episode
    # Only for a gentle task: each episode's preference, and violation; only if the task's version
    # measures care: its caring success.
    preferences: Shaped[np.ndarray, "E P K"] | None = None
    violated: Bool[np.ndarray, "E P K"] | None = None
    caring: Bool[np.ndarray, "E P K"] | None = None
    # Measures of contact with the person, by column of the table; empty if not measured.
    touch: Mapping[str, Float[np.ndarray, "E P K"]] = dataclasses.field(default_factory=dict)

    def column(self, name: str) -> Float[np.ndarray, "E P K"]:
        """Return a column of numbers or flags of the table, laid out like `values`.

        Raises:
            ValueError: The table lacks the column, or it holds text.
        """
        if name not in self.table.columns or not _is_number(self.table.schema[name]):
            known = [name for name, kind in self.table.schema.items() if _is_number(kind)]
            raise ValueError(f"column is {name!r}; columns of numbers are {', '.join(known)}")
        return self.table[name].cast(pl.Float64).to_numpy()[self.rows]

    @functools.cached_property
    def keys(self) -> Int[np.ndarray, "P K"] | None:
        """Seeds of each partner's episodes; None if egos played different seeds."""
        return None if np.ptp(self.pair_keys, axis=0).any() else self.pair_keys[0]

    @functools.cached_property
    def common_starts(self) -> bool:
        """Whether there are several partners and all played the same seeds."""
        return self.keys is not None and len(self.keys) > 1 and not np.ptp(self.keys, axis=0).any()

    @functools.cached_property
    def scores(self) -> Float[np.ndarray, "E P"]:
        """Mean return J of each pair over its episodes."""
        return self.values.mean(axis=2)

    @functools.cached_property
    def evaluated_side(self) -> "Returns":
        """The returns with test partners; without any, with validation, then training partners.

        Raises:
            ValueError: No partner is on a side.
        """
        sides = self.partners["side"]
        side = next((name for name in reversed(SIDES) if name in sides), None)
        if side is None:
            raise ValueError(
                f"no partner is on a side ({', '.join(SIDES)}); evaluate against a split"
            )
        return self.select_partners((sides == side).fill_null(value=False).to_numpy())

    @functools.cached_property
    def groups(self) -> tuple[str, ...] | None:
        """The group of each partner [P] if teams play beside persons: groups then count alike."""
        groups = groups_of(self.partners["partner_algorithm"].to_list()) or ()
        return groups if TEAMS in groups else None

    @property
    def with_own_wishes(self) -> "Returns":
        """The returns with partners that bring their preferences, if such and others played."""
        if self.preferences is None:
            return self
        own = (self.preferences == OWN).all(axis=(0, 2))
        return self.select_partners(own) if own.any() else self

    def select_partners(self, mask: Bool[np.ndarray, " P"]) -> "Returns":
        """Return the returns with the partners whose `mask` is true."""
        arrays = {
            field.name: array[:, mask]
            for field in dataclasses.fields(self)
            if getattr(array := getattr(self, field.name), "ndim", 0) == 3
        }
        touch = {name: values[:, mask] for name, values in self.touch.items()}
        partners = self.partners.filter(pl.Series(mask))
        return dataclasses.replace(self, partners=partners, touch=touch, **arrays)


@dataclasses.dataclass(frozen=True, eq=False)
class Record:
    """Episodes and their folder. The arrays are made at first use and kept."""

    table: pl.DataFrame  # one row an episode
    folder: Path

    @classmethod
    def read(cls, folder: Path) -> "Record":
        """Return the record of a finished folder.

        Raises:
            FileNotFoundError: The folder has no table of episodes.
            ValueError: The table is damaged.
        """
        return cls(read_episodes(folder / EPISODES_FILE), folder)

    @functools.cached_property
    def returns(self) -> Returns:
        """The episodes as dense arrays.

        Raises:
            ValueError: A pair lacks an episode or has one twice.
        """
        return lay_out(self.table)

    @functools.cached_property
    def manifest(self) -> dict[str, Any]:
        """The folder's manifest, read at first use; empty if there is none.

        Raises:
            ValueError: The manifest was changed after it was written.
        """
        return read_manifest(self.folder) or {}

    def without(self, partners: Collection[str]) -> "Record":
        """Return the record without the episodes of these partners, with arrays already made."""
        if not partners:
            return self
        left_out = pl.col("partner").is_in(list(partners))
        rest = Record(self.table.filter(~left_out), self.folder)
        new = self.returns.partners.select(~left_out).to_series().to_numpy()
        rest.__dict__["returns"] = self.returns.select_partners(new)
        return rest


def lay_out(table: pl.DataFrame) -> Returns:
    """Return a table of episodes as dense arrays [E, P, K].

    Egos and partners are sorted by algorithm, disability, seed, then id.

    Raises:
        ValueError: A pair lacks an episode or has one twice, or one id has two descriptions.
    """
    table = validate_episodes(table)
    egos = _described(table, EGO_COLUMNS)
    partners = _described(table, PARTNER_COLUMNS)
    episodes = table["episode"].unique().sort().to_numpy()
    shape = (egos.height, partners.height, len(episodes))
    cells = _cells(table, egos["ego"], partners["partner"], episodes, shape)

    def dense(name: str, dtype: type) -> np.ndarray:
        values = np.empty(np.prod(shape), dtype)
        values[cells] = table[name].to_numpy()
        return values.reshape(shape)

    rows = np.empty(np.prod(shape), np.int64)
    rows[cells] = np.arange(table.height)
    gentle = {"preferences": "preference", "violated": "violated"}
    if measures_care(table):
        gentle["caring"] = "success"
    return Returns(
        values=dense("return", float),
        nonfinite=dense("nonfinite", bool),
        pair_keys=dense("key", np.int64),
        egos=egos,
        partners=partners,
        episodes=episodes,
        table=table,
        rows=rows.reshape(shape),
        touch={name: dense(name, float) for name in TOUCH if name in table.columns},
        **{
            field: dense(name, object if table[name].dtype == pl.String else bool)
            for field, name in gentle.items()
            if name in table.columns
        },
    )


def _is_number(kind: pl.DataType) -> bool:
    return kind.is_numeric() or kind == pl.Boolean


def _described(table: pl.DataFrame, columns: tuple[str, ...]) -> pl.DataFrame:
    identity, _, algorithm, disability, seed = columns[:5]
    rows = (
        table.select(columns).unique().sort(algorithm, disability, seed, identity, nulls_last=True)
    )
    twice = rows.filter(pl.col(identity).is_duplicated())
    if twice.height:
        name = twice[identity][0]
        descriptions = twice.filter(twice[identity] == name)
        differing = [column for column in columns if descriptions[column].n_unique() > 1]
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
    """Return each row's index in the flat [E * P * K]; raise if a cell has not exactly one row."""

    def places(seat: str, names: pl.Series) -> np.ndarray:
        order = np.arange(names.len())
        return table[seat].replace_strict(names, order, return_dtype=pl.Int64).to_numpy()

    numbers = np.searchsorted(episodes, table["episode"].to_numpy())
    cells = np.ravel_multi_index((places("ego", egos), places("partner", partners), numbers), shape)
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
