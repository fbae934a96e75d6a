"""From an episode table to the figures of a study: typed, and written by `tables.to_json`."""

import dataclasses
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl
from pydantic import TypeAdapter, ValidationError

from assistax_base.validated import first_problem
from evaluation.cast.met_partners import MetSummary
from evaluation.figures.bootstrap import Draws, Estimate, Interval, estimate
from evaluation.figures.metrics import (
    CrossPlay,
    Difference,
    Fairness,
    Stability,
    Traits,
    ZeroShot,
    cross_play,
    cvar_crossfit,
    fairness,
    group_draws,
    paired_difference,
    rank_stability,
    worst_partner,
    zero_shot,
)
from evaluation.figures.normalised import References, Relative
from evaluation.record import tables
from evaluation.record.manifest import check_whole
from evaluation.record.tables import Block, dense_block

# Seeds, partners or teams; with fewer, intervals cover too little (see
# `evaluation.figures.bootstrap.estimate`).
ENOUGH = 16


@dataclasses.dataclass(frozen=True)
class SplitName:
    """Which split the sides of the partners are of."""

    id: str
    sha256: str
    preferences: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)  # by side


@dataclasses.dataclass(frozen=True, kw_only=True)
class Context:
    """What an episode table does not say of its run."""

    task: str
    env_version: int
    backend: str
    engine: dict[str, str] = dataclasses.field(default_factory=dict)  # its name and version
    release: str | None = None  # of the partners
    split: SplitName | None = None
    lock: str | None = None  # sha256 of the lock file that narrowed the registry down
    env_steps_per_second: float | None = None  # None where the table was found finished


@dataclasses.dataclass(frozen=True, kw_only=True)
class Summary(Context):
    """What every study tells."""

    episodes: int
    episodes_per_pair: int
    # Whether all partners played the same starts, as all did before each had starts of its own.
    common_starts: bool = True
    nonfinite: int  # episodes whose physics became non-finite; they count
    notes: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class NamedWorst:
    """The partner with the lowest mean return, see `evaluation.figures.metrics.WorstPartner`."""

    partner: str
    algorithm: str
    disability: str
    mean: float
    crossfit: float | None


@dataclasses.dataclass(frozen=True, kw_only=True)
class EvaluationSummary(Summary, ZeroShot):
    """M_test, M_train, their gap, and figures of the partners of `side`.

    `side` is the test side, or the training side if only that was played.
    """

    side: Literal["train", "test"]
    by_algorithm: dict[str, Estimate]
    by_disability: dict[str, Estimate]
    fairness: Fairness | None  # None with a single disability setting
    # Of the gentle tasks: by what the human likes; goal reached and nobody hurt; a hard contact.
    by_preference: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    preference_fairness: Fairness | None = None  # None with fewer than two preferences
    # Of series of episodes, in which a robot remembers its partner: by place, from "1".
    by_place: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    safe_success: Estimate | None = None  # share of episodes
    violations: Estimate | None = None
    worst_partner: NamedWorst
    cvar_10: Interval | None  # None with one episode a pair
    egos: tuple[str, ...]
    partners: dict[str, int]  # how many are counted, by side
    references: References | None = None  # None where no reference egos were played
    relative: Relative | None = None
    met: MetSummary | None = None  # None of a folder of before it was recorded


@dataclasses.dataclass(frozen=True)
class BestEgo:
    """The robot with the highest mean return over all partners."""

    ego: str
    mean: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class CrossPlaySummary(Summary, CrossPlay):
    """Self-play, cross-play and their gaps, resampling whole teams."""

    best_ego: BestEgo
    rank_stability: Stability | None
    egos: int
    partners: int


@dataclasses.dataclass(frozen=True)
class ComparisonSummary:
    """Method a minus method b with the partners of each side that both met."""

    test: Difference | None
    train: Difference | None
    notes: tuple[str, ...]
    met: MetSummary | None = None  # of both methods: no side counts whom either met


def read_summary(folder: Path) -> EvaluationSummary | CrossPlaySummary:
    """Return the summary of a folder, which somebody else may have written: every field checked.

    Raises:
        FileNotFoundError: There is none, or it is not finished.
        ValueError: A file of the folder is damaged, or it is neither an evaluation's nor a
            cross-play's.
    """
    check_whole(folder)
    content = tables.read_json(folder / tables.SUMMARY_FILE)
    kind = EvaluationSummary if "m_test" in content else CrossPlaySummary
    if kind is CrossPlaySummary and "cross_play" not in content:
        raise ValueError(
            f"{folder} holds neither an evaluation nor a cross-play; see `assistax-zoo evaluate "
            "--help`"
        )
    try:
        return TypeAdapter(kind).validate_python(content)
    except ValidationError as error:
        raise ValueError(
            f"{folder / tables.SUMMARY_FILE} is damaged, or of another version: "
            f"{first_problem(error)}; run again"
        ) from None


def summarise_evaluation(table: pl.DataFrame, context: Context) -> EvaluationSummary:
    """Summarise an evaluation; all egos of the table are seeds of one method.

    Raises:
        ValueError: the table is malformed or incomplete, or none of its partners is on a side of
            the split.
    """
    block = dense_block(table)
    sides = block.partners["side"].to_list()
    focus = block.evaluated_side()
    starts = {"common_starts": block.common_starts}
    by_algorithm, by_disability = (
        group_draws(focus.returns, focus.partners[f"partner_{trait}"].to_list(), **starts)
        for trait in ("algorithm", "disability")
    )
    by_preference = _preference_draws(focus)
    several = focus.returns.shape[2] > 1
    return EvaluationSummary(
        **vars(zero_shot(block.returns, sides, **starts)),
        **_common(block, context),
        side=focus.partners["side"][0],
        by_algorithm=_estimates(by_algorithm),
        by_disability=_estimates(by_disability),
        fairness=fairness(by_disability) if len(by_disability) > 1 else None,
        by_preference=_estimates(by_preference),
        preference_fairness=fairness(by_preference) if len(by_preference) > 1 else None,
        by_place=_by_place(table, focus),
        safe_success=_share(focus.safe, **starts),
        violations=_share(focus.violated, **starts),
        worst_partner=_worst_partner(focus),
        cvar_10=cvar_crossfit(focus.returns, 0.1, **starts) if several else None,
        egos=tuple(block.egos["ego"]),
        partners={name: sides.count(name) for name in tables.SIDES},
        notes=(
            *_seed_notes(block.egos.height),
            *_group_notes(focus),
            *_preference_notes(block, context.split),
            *_start_notes(block),
            *_episode_notes(block),
            *_clipping_notes(table),
        ),
    )


def summarise_crossplay(table: pl.DataFrame, context: Context) -> CrossPlaySummary:
    """Summarise a matrix of egos by partners."""
    block = dense_block(table)
    rows, columns = _traits(block.egos, "ego"), _traits(block.partners, "partner")
    means = block.scores.mean(axis=1)
    return CrossPlaySummary(
        **vars(cross_play(block.returns, rows, columns, common_starts=block.common_starts)),
        **_common(block, context),
        best_ego=BestEgo(block.egos["ego"][int(means.argmax())], float(means.max())),
        rank_stability=_rank_stability(block.scores),
        egos=block.egos.height,
        partners=block.partners.height,
        notes=(*_team_notes(block), *_episode_notes(block)),
    )


def summarise_comparison(a: pl.DataFrame, b: pl.DataFrame, *, seed: int = 0) -> ComparisonSummary:
    """Summarise method a minus method b, two tables of the same partners and episode keys."""
    first, second = dense_block(a), dense_block(b)
    if not first.partners.equals(second.partners):
        raise ValueError(
            "the two tables have different partners; evaluate both methods against the same split"
        )
    if first.keys is None or second.keys is None or not np.array_equal(first.keys, second.keys):
        raise ValueError(
            "the two tables have different episode keys; evaluate both with the same seed and "
            "episodes"
        )
    likes = [one.preferences[0] for one in (first, second) if one.preferences is not None]
    if len(likes) == 2 and not np.array_equal(likes[0], likes[1]):
        raise ValueError(
            "the partners of the two tables liked different things; evaluate both methods with the "
            "same split and --preferences"
        )

    def difference(side: str) -> Difference | None:
        mask = (first.partners["side"] == side).fill_null(value=False).to_numpy()
        if not mask.any():
            return None
        returns = first.returns[:, mask], second.returns[:, mask]
        return paired_difference(*returns, common_starts=first.common_starts, seed=seed)

    test, train = difference("test"), difference("train")
    if test is None and train is None:
        raise ValueError(
            "no partner is on the test or the train side; evaluate both methods against a split"
        )
    egos = min(first.egos.height, second.egos.height)
    notes = (*_seed_notes(egos), *_episode_notes(first), *_episode_notes(second))
    return ComparisonSummary(test, train, notes)


def _common(block: Block, context: Context) -> dict:
    return {
        **vars(context),
        "episodes": block.returns.size,
        "episodes_per_pair": block.returns.shape[2],
        "common_starts": block.common_starts,
        "nonfinite": int(block.nonfinite.sum()),
    }


def _preference_draws(block: Block) -> dict[str, Draws]:
    """Replicate the return under each preference: over the partners that played under it."""
    if block.preferences is None:
        return {}
    scores, names = [], []
    for partner in range(block.partners.height):
        wished, returns = block.preferences[0, partner], block.returns[:, partner]
        for name in sorted(set(wished)):
            scores.append(returns[:, wished == name].mean(axis=1))
            names.append(name)
    return group_draws(np.stack(scores, axis=1), names)


def _by_place(table: pl.DataFrame, block: Block) -> dict[str, Estimate]:
    """Estimate the return in each place of a series, over the pairs of a block."""
    if "place" not in table.columns:
        return {}
    pairs = ["place", "ego", "partner"]
    played = table.filter(pl.col("partner").is_in(block.partners["partner"].to_list()))
    means = played.group_by(pairs).agg(pl.col("return").cast(pl.Float64).mean()).sort(pairs)
    scores = means["return"].to_numpy().reshape(-1, *block.scores.shape)
    return {str(place): estimate(score) for place, score in enumerate(scores, 1)}


def _share(happened: np.ndarray | None, *, common_starts: bool) -> Estimate | None:
    """Return in which share of episodes [E, P, K] it happened."""
    return None if happened is None else estimate(happened, common_starts=common_starts)


def _estimates(draws: dict[str, Draws]) -> dict[str, Estimate]:
    return {name: draw.estimate() for name, draw in draws.items()}


def _traits(policies: pl.DataFrame, seat: str) -> Traits:
    return Traits(
        *(policies[f"{seat}_{name}"].to_list() for name in ("team", "algorithm", "disability"))
    )


def _worst_partner(block: Block) -> NamedWorst:
    worst = worst_partner(block.returns)
    named = block.partners.row(worst.index, named=True)
    traits = (named[name] for name in ("partner", "partner_algorithm", "partner_disability"))
    return NamedWorst(*traits, worst.mean, worst.crossfit)


def _rank_stability(scores: np.ndarray) -> Stability | None:
    if min(scores.shape) < 2 or not np.ptp(scores.mean(axis=1)):
        return None
    return rank_stability(scores)


def _seed_notes(egos: int) -> list[str]:
    if egos == 1:
        return ["one ego: intervals speak about new partners, not about new training seeds"]
    return _few(egos, f"{egos} seeds", " seeds")


def _group_notes(block: Block) -> list[str]:
    counts = [Counter(block.partners[f"partner_{trait}"]) for trait in ("algorithm", "disability")]
    smallest = min(count for groups in counts for count in groups.values())
    return _few(smallest, f"groups of partners have as few as {smallest}", " partners")


def _preference_notes(block: Block, split: SplitName | None) -> list[str]:
    """Say which partners played under preferences that are not their side's."""
    if split is None or block.preferences is None:
        return []
    notes = []
    for side, names in split.preferences.items():
        mask = (block.partners["side"] == side).fill_null(value=False).to_numpy()
        if others := sorted(set(block.preferences[:, mask].ravel()) - set(names)):
            notes.append(
                f"{side} partners played under {', '.join(others)}; the split's {side} preferences "
                f"are {', '.join(names)}"
            )
    return notes


def _team_notes(block: Block) -> list[str]:
    units = min(block.egos.height, block.partners.height)
    return _few(units, f"{units} teams")


def _few(count: int, what: str, of: str = "") -> list[str]:
    return [f"{what}: intervals over fewer than {ENOUGH}{of} are too narrow"] * (count < ENOUGH)


def _start_notes(block: Block) -> list[str]:
    """Say which intervals leave out the luck of starts that all partners have in common."""
    if not block.common_starts:
        return []
    return [
        f"all partners played the same {block.returns.shape[2]} starts: intervals by preference, "
        "by place, of relative figures and of the profile leave their luck out"
    ]


def _clipping_notes(table: pl.DataFrame) -> list[str]:
    """Say how much of what robots from outside did was beyond what there is."""
    if "clipped" not in table.columns or not (shares := table["clipped"].drop_nulls()).sum():
        return []
    return [
        f"actions went beyond [-1, 1] and were clipped in {(shares > 0).sum()} of {len(shares)} "
        f"episodes: {shares.to_numpy().mean():.1%} of their numbers"
    ]


def _episode_notes(block: Block) -> Sequence[str]:
    broken = int(block.nonfinite.sum())
    notes = []
    if broken:
        notes.append(
            f"{broken} of {block.returns.size} episodes became non-finite and earn 0 from then on; "
            "they count"
        )
    if block.keys is None:
        notes.append("egos played different episodes: their differences are not paired")
    return notes
