"""The page's sections in order, in Markdown."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from assistax_envs.versions import GENTLE_TASKS
from evaluation.figures.bootstrap import Estimate, estimate
from evaluation.figures.metrics import zero_shot
from evaluation.figures.strategies import FEATURES
from tools.paper_page.making import costs, ego_rows, played_rows, team_rows
from tools.paper_page.markdown import MISSING, code, figure, image, spoken, table
from tools.paper_page.sections import MATRIX_HEADINGS, matrix_figures
from tools.results_v2.collect import REFERENCES
from tools.results_v2.data import MIRROR, SERIES, Evaluated, Results, short
from tools.results_v2.measures import Comparison, SplitCost, compare, diversity, split_cost
from zoo.schema import PolicyEntry, Split

ALIKE = 1.05  # steps of training within this ratio count as equal
SIDE = "test"  # of the partners that methods are compared with
ALPHA = 0.05  # below it, a p after Holm's correction counts as a difference
TRAINED_WITH = (f"ppo{MIRROR}", "ppo")  # the test side, and the training side
TOLD = ("ppo", "ppo-told")  # what knowing a partner's preference is worth
RECURRENT = "ppo-gru"
_NOTHING = f"{MISSING.capitalize()}."


def make_page(results: Results, pictures: str, command: str) -> str:
    """Return the page as Markdown.

    Args:
        results: What there is of the release.
        pictures: Folder of the figures, relative to the page.
        command: The command that makes the page, for its last section.
    """
    found = {task: compared(results, task) for task in GENTLE_TASKS}
    split_costs = {
        split.id: cost(results, split) for task in GENTLE_TASKS for split in results.splits[task]
    }
    parts = {
        "In short": in_short(results, found, split_costs),
        "The population": by_task(results, population),
        "Training for equally many steps": by_task(results, equal_steps),
        "Splits, and what they cost": by_task(results, partial(splits, split_costs)),
        "Methods": by_task(results, methods),
        "Differences between methods": by_task(results, partial(differences, found)),
        "Adaptation within a series of episodes": by_task(results, adaptation),
        "Cross-play": cross_play(results, pictures),
        "Diversity": diverse(results),
        "How this was made": made(results, command),
    }
    head = (
        f"# Release {results.release}: people who like different things\n\n"
        "Returns with their 95% bootstrap intervals. This page is made from the registry and "
        "committed tables by the command at its end. A *team* is a robot and a human that learned "
        "together; an *ego* is a robot that learned with the training partners of a split. "
        "Intervals of fewer than 16 seeds or partners are too narrow. In these tables all partners "
        "played the same starts, so no interval here speaks of other starts."
    )
    return "\n\n".join([head, *(f"## {name}\n\n{text}" for name, text in parts.items())]) + "\n"


def picture_names(results: Results) -> list[str]:
    """Return the files of the figures that the data allow to draw."""
    return [f"crossplay_{task}.png" for task in results.crossplay]


def by_task(results: Results, section: Callable[[Results, str], str]) -> str:
    """Return a section's text for every task below its name."""
    texts = ((task, section(results, task)) for task in GENTLE_TASKS)
    return "\n\n".join(f"### {spoken(task).capitalize()}\n\n{text}" for task, text in texts)


def in_short(
    results: Results,
    found: Mapping[str, Comparison],
    split_costs: Mapping[str, SplitCost | None],
) -> str:
    """Return what the default splits cost, and which methods come apart on them."""
    rows: list[list[str]] = []
    for task in GENTLE_TASKS:
        default = [_lost(split_costs[split.id])[-1] for split in results.splits[task][:1]] or [
            MISSING
        ]
        rows.append([spoken(task), *default, *_in_short(results, task, found[task])])
    headings = ["task", "lost", "come apart", "do not", f"`{TOLD[0]}` - `{TOLD[1]}`"]
    headings += [f"`{RECURRENT}`: last - first"]
    return (
        f"{table(headings, rows, (1, 4, 5))}\n\nOn the default splits: the share of M_test that a "
        "robot loses because it trained with the training side; the trained methods that are not "
        f"told what a partner likes, apart where p is below {ALPHA:g} after Holm's correction, the "
        "better one first; what being told is worth, and what a memory gains within a series. The "
        "sections below say how each is measured."
    )


def _in_short(results: Results, task: str, found: Comparison) -> list[str]:
    trained = {pair: one for pair, one in found.items() if not {*pair} & {*REFERENCES, TOLD[1]}}
    apart = {
        pair: one
        for pair, one in trained.items()
        if one.adjusted is not None and one.adjusted < ALPHA
    }
    better = [
        " > ".join(f"`{name}`" for name in (pair if one.difference.mean > 0 else pair[::-1]))
        for pair, one in apart.items()
    ]
    alike = [f"`{a}`, `{b}`" for a, b in trained if (a, b) not in apart]
    named = ["; ".join(names) or ("–" if trained else MISSING) for names in (better, alike)]
    told = found.get(TOLD)
    worth = f"{_mean(told.difference)}, p {_p(told.adjusted)}" if told else MISSING
    egos = results.on_default(task, series=True).get(f"{RECURRENT}{SERIES}")
    return [*named, worth, _gain(egos) if egos else MISSING]


def population(results: Results, task: str) -> str:
    """Return the number of teams and their self-play by setting, algorithm and steps."""
    humans = [human for human in results.humans if human.task == task]
    if not humans:
        return _NOTHING
    kinds = sorted({_kind(human) for human in humans})
    settings = sorted({human.disability for human in humans}, key=lambda name: (len(name), name))
    rows = [[setting, *(_teams(humans, kind, [setting]) for kind in kinds)] for setting in settings]
    rows.append(["all", *(_teams(humans, kind, settings) for kind in kinds)])
    headings = ["setting", *(f"{name.upper()}, {steps} steps" for name, steps in kinds)]
    return (
        f"{table(headings, rows, range(1, len(headings)))}\n\nOf {len(humans)} teams: how many, "
        "and the IQM of their returns in self-play. Intervals resample teams."
    )


def equal_steps(results: Results, task: str) -> str:
    """Return self-play of the teams whose steps of training several algorithms share."""
    humans = [human for human in results.humans if human.task == task]
    rows: list[list[object]] = []
    for group in _alike([human for human in humans if human.self_play]):
        names = sorted({human.algorithm for human in group})
        each = {name: {h.disability for h in group if h.algorithm == name} for name in names}
        settings = set.intersection(*each.values())
        if len(names) < 2 or not settings:
            continue
        steps = f"{min(h.training.steps for h in group) / 1e6:.3g} M"
        shared = [human for human in group if human.disability in settings]
        for name in names:
            ours = [human for human in shared if human.algorithm == name]
            found = _self_play(ours)
            cells = [figure(found), figure(found, key="mean")]
            place = ", ".join(sorted(settings, key=lambda one: (len(one), one)))
            rows.append([steps, name.upper(), place, len(ours), *cells])
    if not rows:
        return _NOTHING
    headings = ["steps", "algorithm", "settings", "teams", "self-play IQM [95%]", "mean [95%]"]
    return (
        f"{table(headings, rows, (0, 3, 4, 5))}\n\nTeams of algorithms that trained for equally "
        "many steps, within 5%, in the settings that all of them have. Intervals resample teams."
    )


def splits(split_costs: Mapping[str, SplitCost | None], results: Results, task: str) -> str:
    """Return the splits with their rules and counts, and the share that unseen partners cost."""
    rows: list[list[object]] = []
    for split in results.splits[task]:
        found = results.methods(task, split, mirrored=True)
        earned = [
            _mean(estimate(found[name].scores("return", SIDE))) if name in found else MISSING
            for name in TRAINED_WITH
        ]
        held = ", ".join(split.preferences.get("test", ())) or "–"
        what = f"{split.rule}, {split.held_out}" if split.held_out else split.rule
        name = f"`{short(split)}`" + (" (default)" if split is results.splits[task][0] else "")
        counts = [len(split.train), len(split.test)]
        rows.append([name, what, *counts, held, *earned, *_lost(split_costs[split.id])])
    if not rows:
        return _NOTHING
    headings = ["split", "rule", "training partners", "test partners", "held-out preferences"]
    headings += [*(f"M_test of {name}" for name in TRAINED_WITH), "lost [95%]", "lost, share"]
    return (
        f"{table(headings, rows, (2, 3, 5, 6, 7, 8))}\n\n`ppo{MIRROR}` was trained with the test "
        "side, `ppo` with the training side; both play with the test partners, and what is lost is "
        "the former's return less the latter's, with its share of the former's where that is "
        "surely above zero. The interval resamples the seeds of either apart, and the partners "
        "together. Custom splits are by behaviour: humans fall into two groups by which robots "
        "suit them; the better is held out."
    )


def cost(results: Results, split: Split) -> SplitCost | None:
    """Return what unseen partners cost on a split; None where either robot was not evaluated."""
    found = results.methods(split.task, split, mirrored=True)
    both = {name: found[name] for name in TRAINED_WITH if name in found}
    _check_alike(both, split)
    scores = [egos.scores("return", SIDE) for egos in both.values()]
    return split_cost(*scores) if len(scores) == len(TRAINED_WITH) else None


def methods(results: Results, task: str) -> str:
    """Return what every method earned on every split where one was evaluated."""
    headings = ["method", "seeds", "M_train mean", "M_train IQM", "M_test mean", "M_test IQM"]
    headings += ["gap, mean", "safe success", "violations"]
    texts = []
    for split in results.splits[task]:
        found = results.methods(task, split)
        rows = [[f"`{name}`", *_figures(egos)] for name, egos in found.items()]
        texts += [f"`{short(split)}`:\n\n{table(headings, rows, range(1, 9))}"] if rows else []
    if not texts:
        return _NOTHING
    about = (
        "M is the mean return over partners; the gap is M_train - M_test. Safe success, the goal "
        "reached and nobody hurt, and violations, a contact above the hard limit, are shares of "
        "episodes with test partners. Intervals resample seeds and partners. What was trained with "
        "the test side is no method, and stands above alone."
    )
    return "\n\n".join([*texts, about])


def differences(comparisons: Mapping[str, Comparison], results: Results, task: str) -> str:
    """Return all pairwise differences in M_test on the default split, Holm-corrected."""
    found = comparisons[task]
    if not found:
        return _NOTHING
    rows = [
        [
            f"`{a}` - `{b}`",
            _mean(one.difference),
            f"{one.difference.partners_better:.0%}",
            _p(one.p),
            _p(one.adjusted),
        ]
        for (a, b), one in found.items()
    ]
    headings = ["difference", "M_test, mean [95%]", "partners better with the former", "p"]
    count = sum(one.p is not None for one in found.values())
    return (
        f"{table([*headings, 'p, Holm'], rows, range(1, 5))}\n\nOn "
        f"`{short(results.splits[task][0])}`. p is two-sided, by the bootstrap of seeds and "
        "partners; the least is 0.001. Holm's correction is for the "
        f"{count} differences of this table."
    )


def compared(results: Results, task: str) -> Comparison:
    """Compare every two methods in M_test on a task's default split; empty below two methods."""
    found = results.on_default(task)
    if len(found) < 2:
        return {}
    _check_alike(found, results.splits[task][0])
    return compare({name: egos.scores("return", SIDE) for name, egos in found.items()})


def adaptation(results: Results, task: str) -> str:
    """Return the return by place in a series, of every method that played one."""
    found = results.on_default(task, series=True)
    if not found:
        return _NOTHING
    places = sorted({place for egos in found.values() for place in egos.places})
    rows: list[list[object]] = []
    for name, egos in found.items():
        scores = {place: egos.scores("return", SIDE, place) for place in egos.places}
        cells = [_mean(estimate(scores[one])) if one in scores else "–" for one in places]
        rows.append([f"`{name.removesuffix(SERIES)}`", egos.seeds, *cells, _gain(egos)])
    headings = ["method", "seeds", *(f"episode {place}" for place in places), "last - first"]
    return (
        f"{table(headings, rows, range(1, len(headings)))}\n\nMean return with test partners by "
        f"place in a series, on `{short(results.splits[task][0])}`. A recurrent robot remembers "
        "its partner within the series; a feed-forward one does not. Intervals resample seeds and "
        "partners."
    )


def cross_play(results: Results, pictures: str) -> str:
    """Return self-play beside cross-play, and the clustered matrices."""
    rows = [
        [spoken(task), *(matrix_figures(played) if played else [MISSING, *["–"] * 5])]
        for task in GENTLE_TASKS
        for played in [results.crossplay.get(task)]
    ]
    drawn = [
        image(f"{pictures}/crossplay_{task}.png", f"Cross-play of {spoken(task)}")
        for task in results.crossplay
    ]
    return "\n\n".join([table(["task", *MATRIX_HEADINGS], rows, range(1, 7)), *drawn])


def diverse(results: Results) -> str:
    """Return how many directions behaviour and cross-play have, beside those of release v1."""
    releases = {results.release: results.crossplay, "v1": results.paper}
    found = [(release, *item) for release, one in releases.items() for item in one.items()]
    if not found:
        return _NOTHING
    size = max(1, min(len(played.teams) for _, _, played in found) // 2)
    rows: list[list[object]] = []
    for release, task, played in found:
        one = diversity(played, size)
        chosen = [
            figure(vars(value), 2, "value") for value in (one.chosen_behaviour, one.chosen_returns)
        ]
        whole = [f"{value:.2f}" for value in (one.behaviour, one.returns)]
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


def made(results: Results, command: str) -> str:
    """Return device minutes and commands of every table; `command` makes the page."""
    note = (
        "Minutes are a process's own; up to twelve shared a GPU. What trained `ppo-mirror` is the "
        "split with its sides exchanged, which is no split of the release."
    )
    return f"{note}\n\n{by_task(results, _made)}\n\nThis page:\n\n{code(command)}"


def _made(results: Results, task: str) -> str:
    humans = [human for human in results.humans if human.task == task]
    trained = {
        f"training {method} egos, {split}": told
        for (of, split, method), told in results.trained.items()
        if of == task
    }
    crossed = {
        f"cross-play of {spoken(of)}": x for of, x in results.crossplay.items() if of == task
    }
    egos = {
        f"evaluation of {method} egos, {split}": one
        for (of, split, method), one in results.egos.items()
        if of == task
    }
    rows = [
        *team_rows(humans, GENTLE_TASKS),
        *ego_rows(trained),
        *played_rows(crossed),
        *played_rows(egos),
    ]
    runs = [*trained.values(), *(one.run for one in (*crossed.values(), *egos.values()))]
    text = costs(rows, [run.get("command", "") for run in runs])
    return f"<details markdown>\n<summary>Minutes and commands</summary>\n\n{text}\n\n</details>"


def _kind(human: PolicyEntry) -> tuple[str, str]:
    return human.algorithm, f"{human.training.steps / 1e6:.3g} M"


def _teams(humans: Iterable[PolicyEntry], kind: tuple[str, str], settings: list[str]) -> str:
    chosen = [one for one in humans if _kind(one) == kind and one.disability in settings]
    return f"{len(chosen)}: {figure(_self_play(chosen))}" if chosen else "–"


def _self_play(humans: Iterable[PolicyEntry]) -> dict[str, Any] | None:
    means = [human.self_play.mean for human in humans if human.self_play]
    return vars(estimate(np.array(means))) if means else None


def _alike(humans: Iterable[PolicyEntry]) -> list[list[PolicyEntry]]:
    """Group teams by their steps: the most of a group are at most ALIKE times the fewest."""
    groups: list[list[PolicyEntry]] = []
    for human in sorted(humans, key=lambda one: one.training.steps):
        fewest = groups[-1][0].training.steps if groups else None
        if fewest is None or human.training.steps > ALIKE * fewest:
            groups.append([])
        groups[-1].append(human)
    return groups


def _lost(found: SplitCost | None) -> list[str]:
    """Return what a split costs, and which share that is."""
    if found is None:
        return [MISSING, MISSING]
    share = "–" if found.share is None else figure(vars(found.share), key="value", percent=True)
    return [figure(vars(found.lost), key="value"), share]


def _check_alike(found: Mapping[str, Evaluated], split: Split) -> None:
    """Refuse methods that played other partners, preferences or numbers of episodes."""
    first = next(iter(found), "")
    for name, egos in found.items():
        if not egos.played(SIDE).equals(found[first].played(SIDE)):
            raise ValueError(
                f"{first} and {name} on {split.id} played other preferences or numbers of "
                "episodes with the test partners; evaluate both with the same --episodes"
            )


def _figures(egos: Evaluated) -> list[object]:
    sides = {side: egos.scores("return", side) for side in ("train", "test")}
    names = [side for side, scores in sides.items() for _ in range(scores.shape[1])]
    told = zero_shot(np.concatenate(list(sides.values()), axis=1), names)
    assert told.m_train and told.m_test and told.gap
    returns = [cell for one in (told.m_train, told.m_test) for cell in (_mean(one), _iqm(one))]
    shares = [estimate(egos.scores(name, SIDE)) for name in ("safe_success", "violated")]
    return [egos.seeds, *returns, _mean(told.gap), *(_share(one) for one in shares)]


def _gain(egos: Evaluated) -> str:
    """Return what the last episode of a series earns beyond the first."""
    first, last = (egos.scores("return", SIDE, end(egos.places)) for end in (min, max))
    return _mean(estimate(last - first))


def _mean(found: Estimate) -> str:
    return figure(vars(found), key="mean")


def _iqm(found: Estimate) -> str:
    return figure(vars(found))


def _share(found: Estimate) -> str:
    return figure(vars(found), key="mean", percent=True)


def _p(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"
