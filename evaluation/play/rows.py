"""Rows of the episode table for a tile: the planned columns and the measured columns."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
import polars as pl

from assistax_envs.preferences import PREFERRED
from evaluation.cast.egos import Clipping
from evaluation.cast.roster import Roster
from evaluation.play.jobs import Job
from evaluation.play.tiles import StackSlice, Tile
from evaluation.record.columns import COLUMNS, METRIC_PREFIX, SCHEMA, TERM_PREFIX, VIOLATIONS
from population.play.caring import caring_columns
from population.play.tally import Tally


def planned_rows(job: Job, tile: Tile) -> pl.DataFrame:
    """Return the columns of a tile's episodes that are known before they are played.

    These are policies, side, episode, seed and, if used, preference and place in the series. Rows
    are ordered ego by ego, partner by partner, without padding.
    """
    e, p, k = tile.played
    egos = _described("ego", job.egos, _ids(job.egos, tile.egos))
    partners = _described("partner", job.partners, _ids(job.partners, tile.partners))
    sides = [job.sides.get(name) for name in partners["partner"]]
    partners = partners.with_columns(pl.Series("side", sides, pl.String))
    episodes = pl.DataFrame({"episode": list(tile.episodes)})
    keys = np.broadcast_to(job.seeds(partners["partner"].to_list(), tile.episodes), (e, p, k))
    if tile.paired:
        rows = pl.concat([egos, partners], how="horizontal")
    else:
        rows = egos.join(partners, how="cross", maintain_order="left_right")
    rows = rows.join(episodes, how="cross", maintain_order="left_right")
    places, preferences = {}, {}
    if job.series > 1:
        played = tile.episodes.start + job.order(partners["partner"].to_list(), k)
        order = {"episode": played, "place": 1 + np.arange(k) % job.series}
        places = {name: np.broadcast_to(row, (e, p, k)).ravel() for name, row in order.items()}
    if job.preferences:
        names = job.preferences_of(partners["partner"].to_list(), tile.episodes)
        preferences = {"preference": np.broadcast_to(names, (e, p, k)).ravel()}
    return with_columns(rows, {**places, **preferences, "key": keys.ravel()})


def played_rows(job: Job, tile: Tile, tally: Tally, act: Clipping | None) -> pl.DataFrame:
    """Return the rows of a tile's episodes with all measured columns, without padding."""
    e, p, k = tile.played
    clipped = {}
    if act is not None:
        clipped = {"clipped": act.shares(tally.steps.shape)[:e, :p, :k].ravel()}
    elif job.egos.hosts:
        clipped = {"clipped": np.full(e * p * k, None)}
    tally = jax.tree.map(lambda leaf: leaf[:e, :p, :k].reshape(-1), tally)
    added = {
        METRIC_PREFIX + name: column.end(tally.columns[name], tally.steps)
        for name, column in job.columns.items()
    }
    return with_columns(planned_rows(job, tile), measured(job.task, tally) | clipped | added)


def measured(task: str, tally: Tally) -> dict[str, Any]:
    """Return the measured columns of finished episodes by name, from a tally with leaves [N]."""
    touches = {}
    if tally.violated is not None:
        touches = {"contact_peak": tally.contact_peak, "violated": tally.violated}
    if how := dict(tally.touch):
        touches["end_share"] = how.pop("end_steps") / np.maximum(tally.steps, 1)
        touches |= how
    cared = caring_columns(tally.caring, PREFERRED.get(task, ()))
    if "violation" in cared:
        cared["violation"] = np.array(VIOLATIONS)[cared["violation"]]
    return {
        "return": tally.returns,
        "discounted_return": tally.discounted,
        **{TERM_PREFIX + name: value for name, value in tally.terms.items()},
        "success": tally.success,
        "force_mean": tally.force_sum / np.maximum(tally.steps, 1),
        "force_peak": tally.force_peak,
        **touches,
        **cared,
        "first_contact": np.where(tally.first_contact > 0, tally.first_contact, tally.steps),
        "distance_mean": tally.distance_sum / np.maximum(tally.steps, 1),
        **{f"{role}_travel": value for role, value in tally.travel.items()},
        "nonfinite": tally.nonfinite,
        "steps": tally.steps,
    }


def with_columns(rows: pl.DataFrame, columns: Mapping[str, Any]) -> pl.DataFrame:
    """Return rows with columns added, cast to the types of the episode table.

    A NaN of a column that may be empty becomes an empty value.
    """

    def typed(name: str, value: Any) -> pl.Series:
        series = pl.Series(name, value).cast(SCHEMA.get(name, pl.Float32()))
        empty = name in COLUMNS and COLUMNS[name].nullable and series.dtype.is_float()
        return series.fill_nan(None) if empty else series

    return rows.with_columns(typed(name, value) for name, value in columns.items())


def _described(seat: str, roster: Roster, ids: list[str]) -> pl.DataFrame:
    """Return the description of a seat's policies, one row a policy."""
    names = {
        seat: "id",
        **{f"{seat}_{name}": name for name in ("team", "algorithm", "disability", "seed")},
    }
    schema = {column: SCHEMA[column] for column in names}
    return pl.DataFrame(
        [[getattr(m, name) for name in names.values()] for m in roster.describe(ids)],
        schema=schema,
        orient="row",
    )


def _ids(roster: Roster, slices: Sequence[StackSlice]) -> list[str]:
    """Return the ids of a seat's slices, without padding."""
    return [roster.stacks[cut.stack].ids[row] for cut in slices for row in cut.rows]
