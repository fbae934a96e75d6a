"""Sections of the page: the release's figures beside the paper's, in Markdown."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from assistax_envs.versions import PAPER_TASKS
from evaluation.figures.bootstrap import estimate
from evaluation.record import tables
from tools.release_page.crossplays import matrix_table
from tools.release_page.data import CrossPlayed
from tools.release_page.markdown import MISSING, Table, figure, image, spoken, table
from tools.release_page.paper.claims import Claim
from tools.release_page.paper.data import METHODS, Results, planned
from tools.release_page.paper.measures import variance_shares
from tools.release_page.paper.population import ALGORITHMS, Picture
from tools.release_page.paper.training import RISING, gained_last, training_curves

CLAIM_WORDS = """A claim *holds* if every criterion is met, and *in part* if its last one is met but another is not. If the last one is not met it
*does not hold*. It is *undecided* if an interval reaches over its threshold.

- *Lose with each other*: mean return of one branch's robots with the other's humans, the better of the two ways,
  against the lesser of the returns within; of all pairs of branches that have 5% of the teams or more. p against the
  same after the robots of each human were permuted, the robots' and the humans' means kept.
- *Incompatible*: the pair's return is below half of the lesser of the two teams' self-play returns, as it is for the
  two strategies of the paper's Figure 5.
- *Variance explained*: two-way analysis of variance of cross-play returns; intervals over teams.
- *P(A > B)*: chance that a seed of A beats a seed of B with the same partner. In self-play seeds are resampled, of egos
  seeds and partners."""  # noqa: E501
_VERDICTS = ("holds", "holds in part", "undecided", "does not hold", MISSING)


def summary(results: Results, claims: Sequence[Claim]) -> str:
    """Return one table that says it all: teams, self-play and claims by task."""
    rows: list[list[object]] = [
        ["Teams (Table 6)", *(_teams(results, task) for task in PAPER_TASKS)]
    ]
    rows += [
        [
            f"{name.upper()} self-play on d1 (Table 2)",
            *(_short_verdict(results, task, name) for task in PAPER_TASKS),
        ]
        for name in ALGORITHMS
    ]
    for title in dict.fromkeys(claim.title for claim in claims):
        headlines = {claim.task: claim.headline for claim in claims if claim.title == title}
        [about] = {claim.figure for claim in claims if claim.title == title}
        rows.append([f"{title}: {about}", *(headlines.get(task, "–") for task in PAPER_TASKS)])
    counts = Counter(claim.verdict for claim in claims)
    counted = ", ".join(
        f"*{verdict}* {counts[verdict]}" for verdict in _VERDICTS if counts[verdict]
    )
    return f"{table(['', *map(spoken, PAPER_TASKS)], rows)}\n\nClaims by task: {counted}."


def self_play_table(results: Results) -> Table:
    """Return Table 2."""
    rows: list[list[object]] = []
    for task in PAPER_TASKS:
        for name in (*ALGORITHMS, "isac"):
            theirs = results.paper["self_play"][task][name]
            ours = _self_play(results, task, name)
            if ours is None and name == "isac":
                rows.append(
                    [spoken(task), "ISAC", "not in the population", "–", figure(theirs), "–", "–"]
                )
                continue
            ratio = f"{ours['iqm'] / theirs['iqm']:.2f}" if ours else "–"
            seeds = ours["n"] if ours else "–"
            rows.append(
                [
                    spoken(task),
                    name.upper(),
                    figure(ours),
                    seeds,
                    figure(theirs),
                    ratio,
                    _agreement(ours, theirs),
                ]
            )
    headings = ["task", "algorithm", "IQM [95%]", "seeds", "paper, 16 seeds", "ratio", "intervals"]
    return headings, rows


def self_play(results: Results) -> str:
    """Return the section about Table 2."""
    bounds = ", ".join(
        f"{spoken(task)} {bound:,}" for task, bound in results.paper["upper_bound"].items()
    )
    orders = "\n".join(f"- {spoken(task)}: {_orders(results, task)}" for task in PAPER_TASKS)
    return (
        f"[self-play.csv]({results.release}/self-play.csv) has all intervals, also of ISAC, which "
        f"is not in the population. *agree*: the two intervals overlap; *above*, *below*: ours "
        f"lies there. Upper bounds of a return: {bounds}.\n\n"
        f"Order of the algorithms:\n\n{orders}"
    )


def curve_table(results: Results) -> Table | None:
    """Return the ends of Figure 3's curves, if there are any."""
    if not results.has_curves:
        return None
    curves = training_curves(results)
    rows: list[list[object]] = []
    for task, algorithm in curves.select("task", "algorithm").unique(maintain_order=True).rows():
        curve = curves.filter(task=task, algorithm=algorithm)
        end = curve.row(-1, named=True)
        last = {
            "iqm": end["iqm"],
            "iqm_ci": None if end["low"] is None else (end["low"], end["high"]),
        }
        gain = gained_last(curve)
        rising = "yes" if gain > RISING else "no"
        rows.append(
            [
                spoken(task),
                algorithm.upper(),
                end["seeds"],
                f"{end['steps'] / 1e6:.1f} M",
                figure(last),
                f"{gain:+.1%}",
                rising,
            ]
        )
    headings = [
        "task",
        "algorithm",
        "seeds",
        "steps",
        "last IQM [95%]",
        "gain of the last fifth",
        "still rising",
    ]
    return headings, rows


def curves(results: Results, picture: Picture) -> str:
    """Return Figure 3."""
    found = curve_table(results)
    if found is None:
        return f"Figure 3: {MISSING}."
    drawn = image(picture("curves.png"), "Learning curves")
    rising = [f"{row[0]} {row[1]} ({row[-2]})" for row in found[1] if row[-1] == "yes"]
    return (
        f"{drawn}\n\n[curves.csv]({results.release}/curves.csv) has where each curve ends. Still "
        f"rising, by more than {RISING:.0%} in the last fifth: {', '.join(rising) or 'none'}."
    )


def cross_play(results: Results, picture: Picture) -> str:
    """Return Figure 4 with its figures, and Figure 5's two incompatible strategies."""
    shares, pairs = [], []
    for task, played in results.crossplay.items():
        shares.append([spoken(task), *_shares(played)])
        pairs.append(_exchange(task, played, results.paper["incompatible"]))
    text = matrix_table(results.crossplay, PAPER_TASKS)
    if not shares:
        return text
    split = table(["task", "robot", "human", "who fits whom, and noise"], shares, (1, 2, 3))
    exchanged = table(
        [
            "task",
            "two partners",
            "return, each with its best robot",
            "robots exchanged",
            "paper (Figure 5)",
        ],
        pairs,
        (2, 3),
    )
    drawn = [
        f"**{spoken(task).capitalize()}**\n\n"
        + image(picture(f"crossplay_{task}.png"), f"Cross-play of {spoken(task)}")
        for task in PAPER_TASKS
        if task in results.crossplay
    ]
    return "\n\n".join(
        [
            text,
            "Variance of cross-play returns over pairs, by whom it depends on:",
            split,
            "The two partners whose best robots lose the most when they are exchanged:",
            exchanged,
            *drawn,
        ]
    )


def zero_shot_table(results: Results) -> Table:
    """Return the figures of Figures 6 and 14."""
    rows: list[list[object]] = []
    for task in PAPER_TASKS:
        for method in METHODS:
            egos = results.egos.get((task, method))
            if egos is None:
                rows.append([spoken(task), method.upper(), "–", MISSING, "–", "–", "–"])
                continue
            summary = egos.summary
            worst = summary["worst_partner"]
            figures = [
                figure(summary["m_train"]),
                figure(summary["m_test"]),
                figure(summary["gap"], key="mean"),
            ]
            rows.append(
                [
                    spoken(task),
                    method.upper(),
                    len(summary["egos"]),
                    *figures,
                    f"{worst['mean']:,.1f} ({worst['partner'].split('/')[1]})",
                ]
            )
    headings = [
        "task",
        "egos",
        "seeds",
        "M_train IQM [95%]",
        "M_test IQM [95%]",
        "mean gap [95%]",
        "worst test partner",
    ]
    return headings, rows


def zero_shot(results: Results, picture: Picture) -> str:
    """Return the section about Figures 6 and 14, with mean returns."""
    headings, rows = zero_shot_table(results)
    shown = table([*headings[:2], *headings[4:6]], [[*row[:2], *row[4:6]] for row in rows], (2, 3))
    tasks = [
        task for task in PAPER_TASKS if any((task, method) in results.egos for method in METHODS)
    ]
    drawn = [
        image(picture(f"zsc_{task}.png"), f"Returns of egos on {spoken(task)}") for task in tasks
    ]
    about = (
        f"[egos.csv]({results.release}/egos.csv) has M_train and the worst partner as well. "
        "Intervals here resample seeds and partners, so they speak about new ones of both; the gap "
        "is M_train - M_test. The paper shows these returns as bars without figures."
    )
    return "\n\n".join([shown, about, *drawn])


def claim_table(claims: Sequence[Claim]) -> Table:
    """Return every criterion of every claim with its threshold."""
    rows: list[list[object]] = []
    for claim in claims:
        name = [claim.title, spoken(claim.task)]
        if not claim.criteria:
            rows.append([*name, "–", "–", "–", MISSING])
        rows += [[*name, c.what, c.value, c.threshold, _bold(c.outcome)] for c in claim.criteria]
    headings = ["claim", "task", "criterion", "found", "threshold", "outcome"]
    return headings, rows


def _teams(results: Results, task: str) -> str:
    count = sum(human.task == task for human in results.humans)
    return f"{count} of {planned(results.paper['population'][task])}"


def _short_verdict(results: Results, task: str, algorithm: str) -> str:
    ours, theirs = _self_play(results, task, algorithm), results.paper["self_play"][task][algorithm]
    if ours is None:
        return MISSING
    agreement = {"agree": "agrees"}.get(_agreement(ours, theirs), _agreement(ours, theirs))
    return f"**{agreement}**, {ours['iqm']:,.0f}; paper {theirs['iqm']:,.0f}"


def _self_play(results: Results, task: str, algorithm: str) -> dict[str, Any] | None:
    scores = results.self_play(task, algorithm)
    return tables.to_json(estimate(scores)) if len(scores) else None


def _agreement(ours: Mapping[str, Any] | None, theirs: Mapping[str, Any]) -> str:
    if ours is None:
        return MISSING
    low, high = ours["iqm_ci"] or (ours["iqm"], ours["iqm"])
    if low > theirs["iqm_ci"][1]:
        return "above"
    return "below" if high < theirs["iqm_ci"][0] else "agree"


def _orders(results: Results, task: str) -> str:
    theirs = {name: results.paper["self_play"][task][name]["iqm"] for name in ALGORITHMS}
    ours = {
        name: figures["iqm"] for name in ALGORITHMS if (figures := _self_play(results, task, name))
    }
    if len(ours) < len(ALGORITHMS):
        return MISSING
    first, second = (
        " > ".join(name.upper() for name in sorted(returns, key=returns.__getitem__, reverse=True))
        for returns in (ours, theirs)
    )
    return f"{first}, as in the paper" if first == second else f"{first}; in the paper {second}"


def _shares(played: CrossPlayed) -> list[str]:
    shares = variance_shares(played.matrix)
    return [
        f"{part.value:.0%}" + (" [{:.0%}, {:.0%}]".format(*part.value_ci) if part.value_ci else "")
        for part in (shares.robot, shares.human, shares.rest)
    ]


def _exchange(task: str, played: CrossPlayed, paper: Mapping[str, Any]) -> list[object]:
    pair = played.strategies["incompatible"]
    theirs = "–"
    if exchange := paper.get(task):
        returns = " and ".join(f"{value:.1f}" for value in exchange["returns"])
        theirs = f"{returns}, exchanged below {exchange['exchanged_below']}"
    if pair is None:
        return [spoken(task), "none loses both ways", "–", "–", theirs]
    names = ", ".join(name.split("/")[1] for name in pair["partners"])
    own, exchanged = (
        " and ".join(f"{value:,.1f}" for value in pair[key])
        for key in ("returns", "returns_exchanged")
    )
    return [spoken(task), names, own, exchanged, theirs]


def _bold(verdict: str) -> str:
    return verdict if verdict == MISSING else f"**{verdict}**"
