"""Sections of the page in Markdown, and tables beside it: teams, splits, methods, diversity."""

import functools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from assistax_envs.versions import GENTLE_TASKS
from evaluation.figures.bootstrap import Estimate, estimate
from evaluation.figures.metrics import zero_shot
from evaluation.figures.strategies import FEATURES
from tools.release_page.crossplays import matrix_table
from tools.release_page.gentle.data import MIRROR, SERIES, Evaluated, Results, short
from tools.release_page.gentle.measures import (
    Comparison,
    SplitCost,
    compare,
    diversity,
    split_cost,
)
from tools.release_page.markdown import MISSING, Table, figure, image, spoken, table
from zoo.schema import PolicyEntry, Split

ALIKE = 1.05  # steps of training within this ratio count as equal
SIDE = "test"  # of the partners that methods are compared with
TRAINED_WITH = (f"ppo{MIRROR}", "ppo")  # the test side, and the training side
NOTHING = f"{MISSING.capitalize()}."
METHOD = ("method", "seeds", "M_train mean", "M_train IQM", "M_test mean", "M_test IQM")
METHOD += ("gap, mean", "safe success", "violations")


def population(results: Results, task: str) -> Table | None:
    """Return the number of teams and their self-play by setting, algorithm and steps."""
    humans = [human for human in results.humans if human.task == task]
    if not humans:
        return None
    kinds = sorted({_kind(human) for human in humans})
    settings = sorted({human.disability for human in humans}, key=lambda name: (len(name), name))
    rows = [[setting, *(_teams(humans, kind, [setting]) for kind in kinds)] for setting in settings]
    rows.append(["all", *(_teams(humans, kind, settings) for kind in kinds)])
    return ["setting", *(f"{name.upper()}, {steps} steps" for name, steps in kinds)], rows


def equal_steps(results: Results, task: str) -> Table | None:
    """Return self-play of the teams whose steps of training several algorithms share."""
    humans = [human for human in results.humans if human.task == task]
    rows: list[list[object]] = []
    for group in _alike([human for human in humans if human.self_play]):
        names = sorted({human.algorithm for human in group})
        settings_of = {name: {h.disability for h in group if h.algorithm == name} for name in names}
        settings = set.intersection(*settings_of.values())
        if len(names) < 2 or not settings:
            continue
        steps = f"{min(h.training.steps for h in group) / 1e6:.3g} M"
        shared = [human for human in group if human.disability in settings]
        for name in names:
            ours = [human for human in shared if human.algorithm == name]
            self_play = _self_play(ours)
            cells = [figure(self_play), figure(self_play, key="mean")]
            place = ", ".join(sorted(settings, key=lambda setting: (len(setting), setting)))
            rows.append([steps, name.upper(), place, len(ours), *cells])
    headings = ["steps", "algorithm", "settings", "teams", "self-play IQM [95%]", "mean [95%]"]
    return (headings, rows) if rows else None


def splits(results: Results, task: str) -> Table | None:
    """Return the splits with their rules and counts, and the share that unseen partners cost."""
    rows: list[list[object]] = []
    for split in results.splits[task]:
        methods = results.methods(task, split, mirrored=True)
        earned = [
            mean(estimate(methods[name].scores("return", SIDE))) if name in methods else MISSING
            for name in TRAINED_WITH
        ]
        held = ", ".join(split.preferences.get("test", ())) or "–"
        what = f"{split.rule}, {split.held_out}" if split.held_out else split.rule
        name = f"`{short(split)}`" + (" (default)" if split is results.splits[task][0] else "")
        counts = [len(split.train), len(split.test)]
        rows.append([name, what, *counts, held, *earned, *lost(split_costs(results)[split.id])])
    headings = ["split", "rule", "training partners", "test partners", "held-out preferences"]
    headings += [*(f"M_test of {name}" for name in TRAINED_WITH), "lost [95%]", "lost, share"]
    return (headings, rows) if rows else None


@functools.cache
def split_costs(results: Results) -> dict[str, SplitCost | None]:
    """Return what unseen partners cost on every split, by its id."""
    splits = (split for task in GENTLE_TASKS for split in results.splits[task])
    return {split.id: _cost(results, split) for split in splits}


def _cost(results: Results, split: Split) -> SplitCost | None:
    """Return what unseen partners cost on a split; None where either robot was not evaluated."""
    methods = results.methods(split.task, split, mirrored=True)
    both = {name: methods[name] for name in TRAINED_WITH if name in methods}
    _check_alike(both, split)
    scores = [egos.scores("return", SIDE) for egos in both.values()]
    return split_cost(*scores) if len(scores) == len(TRAINED_WITH) else None


def method_rows(results: Results, task: str) -> dict[str, list[list[object]]]:
    """Return the rows of `METHOD` by split, for splits where one was evaluated, default first."""
    rows = {
        short(split): [[name, *_figures(e)] for name, e in results.methods(task, split).items()]
        for split in results.splits[task]
    }
    return {split: found for split, found in rows.items() if found}


def differences(results: Results, task: str) -> Table | None:
    """Return all pairwise differences in M_test on the default split, Holm-corrected."""
    comparison = comparisons(results)[task]
    if not comparison:
        return None
    rows = [
        [
            f"`{a}` - `{b}`",
            mean(result.difference),
            f"{result.difference.partners_better:.0%}",
            p_value(result.p),
            p_value(result.adjusted),
        ]
        for (a, b), result in comparison.items()
    ]
    headings = ["difference", "M_test, mean [95%]", "partners better with the former", "p"]
    return [*headings, "p, Holm"], rows


@functools.cache
def comparisons(results: Results) -> dict[str, Comparison]:
    """Return the comparison of methods on every task's default split, by task."""
    return {task: _compared(results, task) for task in GENTLE_TASKS}


def _compared(results: Results, task: str) -> Comparison:
    """Compare every two methods in M_test on a task's default split; empty below two methods."""
    methods = results.on_default(task)
    if len(methods) < 2:
        return {}
    _check_alike(methods, results.splits[task][0])
    return compare({name: egos.scores("return", SIDE) for name, egos in methods.items()})


def adaptation(results: Results, task: str) -> Table | None:
    """Return the return by place in a series, of every method that played one."""
    methods = results.on_default(task, series=True)
    if not methods:
        return None
    places = sorted({place for egos in methods.values() for place in egos.places})
    rows: list[list[object]] = []
    for name, egos in methods.items():
        scores = {place: egos.scores("return", SIDE, place) for place in egos.places}
        cells = [mean(estimate(scores[place])) if place in scores else "–" for place in places]
        rows.append([f"`{name.removesuffix(SERIES)}`", egos.seeds, *cells, gain(egos)])
    headings = ["method", "seeds", *(f"episode {place}" for place in places), "last - first"]
    return headings, rows


def cross_play(results: Results, pictures: str) -> str:
    """Return self-play beside cross-play, and the clustered matrices."""
    drawn = [
        image(f"{pictures}/crossplay_{task}.png", f"Cross-play of {spoken(task)}")
        for task in results.crossplay
    ]
    return "\n\n".join([matrix_table(results.crossplay, GENTLE_TASKS), *drawn])


def diverse(results: Results) -> str:
    """Return how many directions behaviour and cross-play have, beside those of release v1."""
    releases = {results.release: results.crossplay, "v1": results.paper}
    crossplays = [
        (release, *item)
        for release, played_tasks in releases.items()
        for item in played_tasks.items()
    ]
    if not crossplays:
        return NOTHING
    size = max(1, min(len(played.teams) for _, _, played in crossplays) // 2)
    rows: list[list[object]] = []
    for release, task, played in crossplays:
        spread = diversity(played, size)
        chosen = [
            figure(vars(value), 2, "value")
            for value in (spread.chosen_behaviour, spread.chosen_returns)
        ]
        whole = [f"{value:.2f}" for value in (spread.behaviour, spread.returns)]
        cells = [whole[0], chosen[0], whole[1], chosen[1]]
        rows.append([release, spoken(task), len(played.teams), *cells])
    of = f"of {size} teams [95%]"
    headings = ["release", "task", "teams", "behaviour", of, "effective rank", of]
    return (
        f"{table(headings, rows, range(2, 7))}\n\n*Behaviour*: participation ratio of the "
        f"{len(FEATURES)} features of best responses (BR-Div, arXiv 2310.05208). *Effective rank*: "
        "of the doubly centred cross-play matrix, the exponential of the entropy of its singular "
        "values (Roy & Vetterli, *The effective rank: a measure of effective dimensionality*, "
        "EUSIPCO 2007); noise of episodes adds to it, as more teams do. So tasks are compared by "
        f"the mean over random choices of {size} teams, half of the smallest cross-play, with the "
        "range of 95% of the choices."
    )


def _kind(human: PolicyEntry) -> tuple[str, str]:
    return human.algorithm, f"{human.training.steps / 1e6:.3g} M"


def _teams(humans: Iterable[PolicyEntry], kind: tuple[str, str], settings: list[str]) -> str:
    chosen = [human for human in humans if _kind(human) == kind and human.disability in settings]
    return f"{len(chosen)}: {figure(_self_play(chosen))}" if chosen else "–"


def _self_play(humans: Iterable[PolicyEntry]) -> dict[str, Any] | None:
    means = [human.self_play.mean for human in humans if human.self_play]
    return vars(estimate(np.array(means))) if means else None


def _alike(humans: Iterable[PolicyEntry]) -> list[list[PolicyEntry]]:
    """Group teams by their steps: the most of a group are at most ALIKE times the fewest."""
    groups: list[list[PolicyEntry]] = []
    for human in sorted(humans, key=lambda human: human.training.steps):
        fewest = groups[-1][0].training.steps if groups else None
        if fewest is None or human.training.steps > ALIKE * fewest:
            groups.append([])
        groups[-1].append(human)
    return groups


def lost(cost: SplitCost | None) -> list[str]:
    """Return what a split costs, and which share that is."""
    if cost is None:
        return [MISSING, MISSING]
    share = "–" if cost.share is None else figure(vars(cost.share), key="value", percent=True)
    return [figure(vars(cost.lost), key="value"), share]


def _check_alike(methods: Mapping[str, Evaluated], split: Split) -> None:
    """Refuse methods that played other partners, preferences or numbers of episodes."""
    first = next(iter(methods), "")
    for name, egos in methods.items():
        if not egos.played(SIDE).equals(methods[first].played(SIDE)):
            raise ValueError(
                f"{first} and {name} on {split.id} played other preferences or numbers of "
                "episodes with the test partners; evaluate both with the same --episodes"
            )


def _figures(egos: Evaluated) -> list[object]:
    sides = {side: egos.scores("return", side) for side in ("train", "test")}
    names = [side for side, scores in sides.items() for _ in range(scores.shape[1])]
    figures = zero_shot(np.concatenate(list(sides.values()), axis=1), names)
    assert figures.m_train and figures.m_test and figures.gap
    returns = [
        cell for side in (figures.m_train, figures.m_test) for cell in (mean(side), _iqm(side))
    ]
    shares = [estimate(egos.scores(name, SIDE)) for name in ("safe_success", "violated")]
    return [egos.seeds, *returns, mean(figures.gap), *(_share(share) for share in shares)]


def gain(egos: Evaluated) -> str:
    """Return what the last episode of a series earns beyond the first."""
    first, last = (egos.scores("return", SIDE, end(egos.places)) for end in (min, max))
    return mean(estimate(last - first))


def mean(estimated: Estimate) -> str:
    """Return a mean with its interval."""
    return figure(vars(estimated), key="mean")


def _iqm(estimated: Estimate) -> str:
    return figure(vars(estimated))


def _share(estimated: Estimate) -> str:
    return figure(vars(estimated), key="mean", percent=True)


def p_value(value: float | None) -> str:
    """Return a p-value; a dash where nothing was resampled."""
    return "–" if value is None else f"{value:.3f}"
