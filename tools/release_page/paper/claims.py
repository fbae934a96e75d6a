"""The paper's claims, each checked by criteria that are computed, with their thresholds stated."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Literal

from assistax_envs.versions import PAPER_TASKS
from evaluation.figures.bootstrap import Interval
from tools.release_page import markdown
from tools.release_page.data import CrossPlayed
from tools.release_page.paper.data import METHODS, Egos, Results
from tools.release_page.paper.measures import (
    improvement,
    incompatible_share,
    largest_exchange_loss,
    relative_gap,
    variance_shares,
)

Outcome = Literal["met", "not met", "undecided"]

CLUSTERED = (
    "scratch",
    "bed_bath",
)  # tasks in which the paper sees groups that do not fit each other
LEVEL = 0.05  # of the permutation test
EXCHANGE_LOSS = (
    0.25  # of the return; two groups that lose this with each other follow different strategies
)
INCOMPATIBLE = 0.05  # of the pairs of a robot and another team's human
# Of the lesser self-play return; below it a pair is incompatible, as in the paper's Figure 5.
FRACTION = 0.5
HUMAN_SHARE, ROBOT_SHARE = 0.1, 0.5  # of the variance of returns over pairs
SMALL_GAP = 0.1  # of M_train, or of self-play
EVEN = 0.5  # chance that one method's seed beats the other's


@dataclasses.dataclass(frozen=True)
class Criterion:
    """One figure against its threshold."""

    what: str
    value: str
    threshold: str
    outcome: Outcome


@dataclasses.dataclass(frozen=True)
class Claim:
    """One claim of the paper on one task."""

    title: str
    task: str
    figure: str  # name of the last criterion's figure, in few words
    criteria: Sequence[Criterion]  # empty if nothing was measured

    @property
    def headline(self) -> str:
        """The verdict with the last criterion's figure."""
        return f"**{self.verdict}**, {self.criteria[-1].value}" if self.criteria else self.verdict

    @property
    def verdict(self) -> str:
        """Verdict: whether every criterion is met; a claim does not hold if the last is not met."""
        if not self.criteria:
            return "not measured yet"
        outcomes = {criterion.outcome for criterion in self.criteria}
        last = self.criteria[-1].outcome
        if last == "not met":
            return "does not hold"
        if last == "undecided" or outcomes == {"met", "undecided"}:
            return "undecided"
        return "holds" if outcomes == {"met"} else "holds in part"


@functools.cache
def check_claims(results: Results) -> list[Claim]:
    """Check every claim on every task that it is about, in the paper's order."""
    played, algorithms = results.crossplay, ("ippo", "mappo")
    title, figure = "Groups of incompatible strategies", "return two groups lose with each other"
    claims = [Claim(title, task, figure, _clusters(played.get(task))) for task in CLUSTERED]
    title, figure = "The human contributes little", "variance due to the robot"
    claims += [Claim(title, "arm_assist", figure, _human(played.get("arm_assist")))]
    for name in algorithms:
        title, figure = f"{name.upper()} above MASAC in self-play", f"P({name.upper()} > MASAC)"
        claims += [
            Claim(title, task, figure, _self_play(results, task, name)) for task in PAPER_TASKS
        ]
    for method in METHODS:
        title, figure = f"Small train-test gap, {method.upper()} egos", "gap / M_train"
        claims += [
            Claim(title, task, figure, _gap(results.egos.get((task, method))))
            for task in PAPER_TASKS
        ]
    title, figure = "PPO egos above SAC egos", "P(PPO > SAC)"
    pairs = {task: [results.egos.get((task, method)) for method in METHODS] for task in PAPER_TASKS}
    return claims + [Claim(title, task, figure, _egos(*pair)) for task, pair in pairs.items()]


def _clusters(played: CrossPlayed | None) -> list[Criterion]:
    if played is None:
        return []
    exchange = largest_exchange_loss(played.matrix)
    share = incompatible_share(played.matrix, FRACTION)
    sizes = " and ".join(str(len(group)) for group in exchange.groups)
    return [
        Criterion(
            "incompatible pairs of a robot and another team's human",
            f"{share:.1%}",
            f">= {INCOMPATIBLE:.0%}",
            _met(share >= INCOMPATIBLE),
        ),
        Criterion(
            "most that two branches of Figure 4's tree lose with each other, against chance",
            f"{exchange.loss:.0%}, permuted {exchange.null:.0%}, p = {exchange.p:.2f}",
            f"p <= {LEVEL}",
            _met(exchange.p <= LEVEL),
        ),
        Criterion(
            "the same against what counts as another strategy",
            f"{exchange.loss:.0%}" + (f", {sizes} teams" if sizes else ""),
            f">= {EXCHANGE_LOSS:.0%}",
            _met(exchange.loss >= EXCHANGE_LOSS),
        ),
    ]


def _human(played: CrossPlayed | None) -> list[Criterion]:
    if played is None:
        return []
    shares = variance_shares(played.matrix)
    gap = played.summary["relative_gap"]
    lost = (
        Interval(
            gap["value"], tuple(gap["value_ci"]) if gap["value_ci"] else None, gap["n"], "teams"
        )
        if gap
        else None
    )
    criteria = (
        [_against("return lost with another's human", lost, SMALL_GAP, above=False)] if lost else []
    )
    return [
        *criteria,
        _against("variance explained by the human", shares.human, HUMAN_SHARE, above=False),
        _against("variance explained by the robot", shares.robot, ROBOT_SHARE, above=True),
    ]


def _self_play(results: Results, task: str, algorithm: str) -> list[Criterion]:
    ours, masac = results.self_play(task, algorithm), results.self_play(task, "masac")
    if min(len(ours), len(masac)) < 2:
        return []
    chance = improvement(ours, masac, stratified=True)
    return [_against(f"P({algorithm.upper()} > MASAC) over seeds, d1", chance, EVEN, above=True)]


def _gap(egos: Egos | None) -> list[Criterion]:
    if egos is None:
        return []
    gap = relative_gap(egos.scores, egos.partners["side"].to_list())
    wide, words = SMALL_GAP, _told(gap)
    if gap.value_ci is None:
        outcome: Outcome = "undecided"
    elif max(map(abs, gap.value_ci)) <= wide:
        outcome = "met"
    else:
        outcome = (
            "not met" if min(gap.value_ci) > wide or max(gap.value_ci) < -wide else "undecided"
        )
    what = "(M_train - M_test) / M_train, interval over seeds"
    return [Criterion(what, words, f"interval within ±{wide:.0%}", outcome)]


def _egos(ppo: Egos | None, sac: Egos | None) -> list[Criterion]:
    if ppo is None or sac is None:
        return []
    if not ppo.partners.equals(sac.partners):
        raise ValueError(
            f"PPO and SAC egos on {ppo.summary['task']} met different partners; evaluate both with "
            "one split"
        )
    test = (ppo.partners["side"] == "test").to_numpy()
    chance = improvement(ppo.scores[:, test], sac.scores[:, test])
    return [_against("P(PPO > SAC) over seeds, with test partners", chance, EVEN, above=True)]


def _against(what: str, figure: Interval, threshold: float, *, above: bool) -> Criterion:
    """Compare a share with a threshold; decided if the whole interval is on one side."""
    sign = 1 if above else -1
    if figure.value_ci is None:
        outcome: Outcome = "undecided"
    else:
        ends = [sign * (end - threshold) for end in figure.value_ci]
        outcome = "met" if min(ends) > 0 else "not met" if max(ends) < 0 else "undecided"
    limit = f"interval {'above' if above else 'below'} {threshold:.0%}"
    return Criterion(what, _told(figure), limit, outcome)


def _told(figure: Interval) -> str:
    words = markdown.figure(vars(figure), key="value", percent=True)
    return words if figure.value_ci else f"{words}, no interval"


def _met(true: bool) -> Outcome:
    return "met" if true else "not met"
