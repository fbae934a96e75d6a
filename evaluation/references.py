"""What a return means: egos to compare with, bounds for each partner, and the figures relative to them.

With the partners of an evaluation play the zero action (L, the low bound), uniformly random
actions, and each partner's own co-trained robot (B, an estimated best response); a cross-play table
may hold a better robot for B. None of it depends on the policy under evaluation, so the episodes
are kept by the hash of their job and played once.
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from evaluation import tables
from evaluation.bootstrap import estimate
from evaluation.evaluator import Progress, run_job
from evaluation.jobs import Group, Job
from evaluation.metrics import Bounds, br_prox, coverage, normalised_return, regret
from evaluation.reference_egos import RANDOM, ZERO, reference_group

COLUMN = "reference"  # what an episode of the table of references is: ZERO, RANDOM or SELF_PLAY
SELF_PLAY, CROSS_PLAY, NONE = "self-play", "cross-play", "none"  # sources of a best response
EPSILON = 0.1  # of coverage


def play_references(
    env: Any,
    job: Job,
    own: Sequence[tuple[Group, Group]],
    folder: Path,
    *,
    max_envs: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> pl.DataFrame:
    """Return the episodes of the reference egos with the partners of a job, with a column `reference`.

    Args:
        env: The environment.
        job: The evaluation: its partners, episodes and seed are taken.
        own: Groups of robots beside groups of their own humans, row by row.
        folder: Keeps a folder for each job, named by its hash; what is there is not played again.
        max_envs: Most simulations at once.
        on_progress: Told how far a run is.
    """

    def told(state: Progress) -> None:
        if on_progress is not None:
            on_progress(dataclasses.replace(state, what="reference egos"))

    group = reference_group(env.observation_size["robot"], env.action_size["robot"])
    jobs = [dataclasses.replace(job, egos=(group,), stochastic=False)]
    if own:
        robots, humans = (tuple(groups) for groups in zip(*own, strict=True))
        jobs.append(dataclasses.replace(job, egos=robots, partners=humans, paired=True))
    played = [
        run_job(
            env, one, folder / one.digest()[:20], max_envs=max_envs, wait=True, on_progress=told
        ).table
        for one in jobs
    ]
    names = pl.when(pl.col("ego").is_in([ZERO, RANDOM])).then("ego").otherwise(pl.lit(SELF_PLAY))
    return pl.concat(played).with_columns(names.alias(COLUMN))


def bounds_table(references: pl.DataFrame, crossplay: pl.DataFrame | None = None) -> pl.DataFrame:
    """Return low and best return of each partner with their sources and budgets, one row a partner.

    `best` is the higher of self-play and, where the table of pairs `crossplay` is given, its best
    robot: a lower bound of the true best response, though the maximum of noisy means is optimistic.
        Without either it is
    null.
    """
    means = references.group_by("partner", COLUMN, maintain_order=True).agg(
        pl.col("return").cast(pl.Float64).mean(),
        pl.col("ego").first(),
        pl.len().cast(pl.Int64).alias("episodes"),
    )
    low = means.filter(pl.col(COLUMN) == ZERO).select(
        "partner", low="return", low_episodes="episodes"
    )
    candidates = [
        means.filter(pl.col(COLUMN) == SELF_PLAY).select(
            "partner", "return", "ego", "episodes", source=COLUMN
        )
    ]
    if crossplay is not None:
        source = (
            pl.when(pl.col("ego_team") == pl.col("partner_team"))
            .then(pl.lit(SELF_PLAY))
            .otherwise(pl.lit(CROSS_PLAY))
        )
        candidates.append(
            crossplay.select(
                "partner", "return", "ego", "episodes", source=source.fill_null(CROSS_PLAY)
            )
        )
    best = (
        pl.concat(candidates)
        .sort("return", descending=True, maintain_order=True)
        .unique("partner", keep="first", maintain_order=True)
        .select("partner", "source", best="return", best_ego="ego", best_episodes="episodes")
    )
    table = low.join(best, on="partner", how="left", maintain_order="left")
    return table.with_columns(pl.col("source").fill_null(NONE), pl.lit(ZERO).alias("low_source"))


def summarise_references(
    table: pl.DataFrame, references: pl.DataFrame, bounds: pl.DataFrame, *, seed: int = 0
) -> dict[str, Any]:
    """Return the summary's `references` and `relative`, both about the partners of the evaluated side.

    Args:
        table: Episodes of the policies.
        references: What `play_references` returned.
        bounds: What `bounds_table` returned.
        seed: Seed of the bootstrap.
    """
    block = tables.dense_block(table)
    side = "test" if "test" in block.partners["side"] else "train"
    block = block.select_partners((block.partners["side"] == side).fill_null(False).to_numpy())
    partners = block.partners["partner"]
    bounds = pl.DataFrame({"partner": partners}).join(
        bounds, on="partner", how="left", maintain_order="left"
    )
    on_side = references.filter(pl.col("partner").is_in(partners.to_list()))
    egos = {}
    for name in (ZERO, RANDOM, SELF_PLAY):
        means = (
            on_side.filter(pl.col(COLUMN) == name)
            .group_by("partner", maintain_order=True)
            .agg(pl.col("return").cast(pl.Float64).mean())
        )
        figure = (
            estimate(means["return"].to_numpy()[None], seed=seed).to_json()
            if means.height
            else None
        )
        egos[name.replace("-", "_")] = figure
    best = bounds["best"].drop_nulls().to_numpy()
    egos["best_response"] = estimate(best[None], seed=seed).to_json() if best.size else None
    return {"references": egos, "relative": _relative(block.scores, bounds, seed)}


def _relative(scores: np.ndarray, table: pl.DataFrame, seed: int) -> dict[str, Any]:
    """Return normalised return, BR-Prox, regret and coverage of scores [S, P], and which partners they leave out."""
    low = table["low"].to_numpy()
    known = table["best"].is_not_null().to_numpy()
    best = np.where(
        known, table["best"].fill_null(0.0).to_numpy(), low
    )  # without a best response: B = L, unscorable
    bounds = Bounds(best, low, tuple(table["source"]))
    scorable = bounds.scorable
    normalised = normalised_return(scores, bounds)[:, scorable]
    regrets = regret(scores, bounds)[scorable]
    partners = table["partner"].to_list()
    scored = [name for name, one in zip(partners, scorable, strict=True) if one]
    covered = coverage(scores, bounds, EPSILON, seed=seed).share
    proximity = br_prox(scores, bounds, seed=seed).estimate
    return {
        "normalised_return": estimate(normalised, seed=seed).to_json() if normalised.size else None,
        "br_prox": proximity.to_json() if proximity else None,
        "regret": estimate(regrets[None], seed=seed).to_json() if regrets.size else None,
        "worst_regret": _worst(scored, regrets),
        "coverage": {"epsilon": EPSILON, **covered.to_json()} if covered else None,
        "unscorable": [name for name, one in zip(partners, scorable, strict=True) if not one],
        "bounds": {
            "low": ZERO,
            "best": {
                str(name): int(count)
                for name, count in sorted(table["source"].value_counts().iter_rows())
            },
            "episodes": int(table["low_episodes"][0]),
        },
    }


def _worst(partners: Sequence[str], regrets: np.ndarray) -> dict[str, Any] | None:
    if not regrets.size:
        return None
    return {"partner": partners[int(regrets.argmax())], "regret": float(regrets.max())}
