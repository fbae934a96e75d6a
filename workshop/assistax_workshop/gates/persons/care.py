"""Gates of care: whether robots adapt, discomfort, failed persons, readers, told scripts, steals.

The best robot is the one of those that are not told which earns most with persons of the validation
side.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from assistax_envs.persons.rows import FAMILIES as ALL
from assistax_envs.persons.rows import ROWS
from assistax_envs.preferences import PREFERRED
from assistax_workshop.gates.audit_gates import Gate, of_means
from assistax_workshop.gates.persons.play import SINGLE, STRANGERS
from assistax_workshop.gates.persons.scripts import CAREFUL, FACTORS
from evaluation.figures.metrics.adaptation import Adaptation, adaptation
from evaluation.figures.metrics.caring import failed

Files = Mapping[str, Mapping[str, Any]]  # results of stages, by name

SCRIPT, READ, SWAPPED, WORDS, STEALS = "script", "read", "swapped", "words", "steals"
UNTOLD = ("gru", "rma", "osi", "dagger", "ppo")  # kinds of which the best is the best robot
PLAIN = "ppo"  # the kind without a memory
BOUNDS = (CAREFUL, "told-gru", "best")  # kinds whose best bounds what a person can be worth
SIDE, TESTED = "validation", ("corners", "unseen")
SLOPE, HALF, FOUND = 0.4, 0.5, 0.6
UNEASY, FAILED = 0.25, 0.2
STOLEN, CARED = 0.25, 0.01  # of the bound, and caring success, below which nothing is stolen


def gates_of_care(task: str, files: Files) -> list[Gate]:
    """Return the gates of care."""
    return [
        *_adapting(task, files),
        *_swapped(files),
        *_answers(files),
        *_reading(files),
        *_falling(files),
        *_uneasy(files),
        *_failing(files),
        *_stealing(files),
        _bounded(files),
    ]


def best_robot(files: Files) -> str | None:
    """Return the kind of the best robot; None if none has played."""
    there = [kind for kind in UNTOLD if kind in files]
    return max(there, key=lambda kind: scores(files[kind], SIDE, "return").mean(), default=None)


def slopes_of(file: Mapping[str, Any], side: str, task: str) -> dict[str, Adaptation]:
    """Return the adaptation of a kind's robots to the persons of a side, by wish."""
    found = {
        wish: adaptation(*(scores(file, side, f"{w}_{wish}") for w in ("liked", "done", "within")))
        for wish in PREFERRED[task]
    }
    return {wish: one for wish, one in found.items() if one is not None}


def bound_of(files: Files) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the bound of each person of the sample [P], and its error; None without any.

    Even episodes say who is best with a person, odd ones what that is worth.
    """
    played = []
    for kind in BOUNDS:
        if kind in files:
            returns = scores(files[kind], SINGLE, "return")
            played += list(returns[:1] if kind == CAREFUL else returns)  # a told script at once
    if not played:
        return None
    returns = np.stack(played)
    chosen = returns[:, :, ::2].mean(axis=2).argmax(axis=0)
    other = returns[chosen, np.arange(returns.shape[1]), 1::2]
    return other.mean(axis=1), other.std(axis=1) / np.sqrt(max(other.shape[1] - 1, 1))


def scores(file: Mapping[str, Any], side: str, what: str) -> np.ndarray:
    """Return a stage's results with a side [robots, persons, episodes]; NaN for what is not."""
    return np.array(file["sides"][side][what], float)


def steps_of(file: Mapping[str, Any]) -> str:
    """Return the steps of a stage's training, as text."""
    return f"{file['about']['steps'] / 1e6:g} M steps"


def missing(name: str, bar: str, *stages: str) -> Gate:
    """Return a gate that was not measured, with the stages that it needs."""
    return Gate(name, bar, None, None, None, f"not measured: needs {', '.join(stages)}")


def _adapting(task: str, files: Files) -> Iterator[Gate]:
    """Yield the gates of the best robot's slopes: of the best wish, and beside PPO's."""
    best, bar = best_robot(files), f">= {SLOPE:g} for a wish"
    beside = f"its slope without a memory ({PLAIN})"
    for side in TESTED:
        name = f"adaptation slope, {side}"
        found = slopes_of(files[best], side, task) if best else {}
        if not found:
            yield missing(name, bar, *UNTOLD[:1])
            continue
        wish = max(found, key=lambda one: found[one].slope.value)
        value = found[wish].slope
        detail = f"{best}: " + ", ".join(
            f"{one} {a.slope.value:.2f} ({a.within:.0%} within, done / liked {a.done_to_liked:.2f})"
            for one, a in found.items()
        )
        yield Gate(name, bar, value.value, value.value_ci, value.value >= SLOPE, detail)
        if PLAIN in files and best != PLAIN:
            plain = slopes_of(files[PLAIN], side, task).get(wish)
            slope = plain.slope.value if plain else 0.0
            holds = slope < HALF * value.value
            ci = plain.slope.value_ci if plain else None
            yield Gate(f"{beside}, {side}", f"< {HALF:.0%} of it", slope, ci, holds, wish)


def _swapped(files: Files) -> Iterator[Gate]:
    """Yield the slopes of each robot when one wish alone is swapped."""
    if SWAPPED not in files:
        yield missing("slope with a wish swapped", "stated", SWAPPED)
        return
    for kind, wishes in files[SWAPPED]["slopes"].items():
        for wish, slopes in wishes.items():
            value, ci = of_means(lambda mean: mean, np.array(slopes))
            yield Gate(
                f"{wish} swapped, {kind}", "stated", value, ci, None, f"{len(slopes)} robots"
            )


def _answers(files: Files) -> Iterator[Gate]:
    """Yield the share of what is too much, or too little, that is gone 2 s after a word."""
    bar = "above that of masked persons"
    if WORDS not in files:
        yield missing("gone 2 s after a word", bar, WORDS)
        return
    place = list(files[WORDS]["about"]["after"]).index(2.0)
    for kind, found in files[WORDS]["robots"].items():
        for name, answer in found["words"].items():
            both = [(a, b) for a, b in zip(answer["asked"], answer["unasked"], strict=True) if a]
            heard = [(a, b) for a, b in both if a[place] is not None and b[place] is not None]
            if not heard:
                continue
            gone = np.array([[1.0 - seen[place] / seen[0] for seen in pair] for pair in heard])
            asked, unasked = gone.T
            value, ci = of_means(lambda mean: mean, asked)
            detail = f"masked {unasked.mean():.2f}; {sum(answer['words'])} words, {kind}"
            yield Gate(f"gone 2 s after {name}", bar, value, ci, value > unasked.mean(), detail)


def _reading(files: Files) -> Iterator[Gate]:
    """Yield the gates of readers: by the robot with which most is found, of each wish."""
    bar = f">= {FOUND:.0%} for a wish"
    read = files[READ]["read"] if READ in files else {}
    wishes = [*dict.fromkeys(wish for found in read.values() for wish in found)]
    if not wishes:
        yield missing("a third of a wish is found after 5 s", bar, READ)
    for wish in wishes:
        by = {robot: found[wish] for robot, found in read.items() if wish in found}
        robot = max(by, key=lambda one: by[one]["both"])
        found = by[robot]
        share, half = found["both"], 1.96 * np.sqrt(0.25 / max(found["of"], 1))
        detail = f"by {robot}, {found['of']} who show or speak; " + ", ".join(
            f"{seen} {found[seen]:.0%}" for seen in ("body", "words", "shuffled")
        )
        detail += "; by speaking: " + ", ".join(f"{g} {s:.0%}" for g, s in found["talking"].items())
        ends = float(share - half), float(share + half)
        yield Gate(f"third of {wish} found", bar, share, ends, share >= FOUND, detail)


def _falling(files: Files) -> Iterator[Gate]:
    """Yield the gates of told scripts: what is lost with each larger multiple of the wishes."""
    if CAREFUL not in files:
        yield missing("told script at more than is liked", "less at each step", CAREFUL)
        return
    for family, returns in _by_family(files[CAREFUL], "return").items():
        means = returns.mean(axis=(1, 2))
        steps = -np.diff(means)
        least = int(steps.argmin())
        # The same persons and starts: their differences alone are uncertain.
        lost = (returns[least] - returns[least + 1]).mean(axis=1)
        value, ci = of_means(lambda mean: mean, lost)
        detail = ", ".join(f"{m:.1f} at {f:g}" for m, f in zip(means, FACTORS, strict=True))
        holds = bool((steps > 0.0).all())
        yield Gate(f"told script at more, {family}", "less at each step", value, ci, holds, detail)


def _uneasy(files: Files) -> Iterator[Gate]:
    """Yield the gates of the best robot's discomfort, by family."""
    best = best_robot(files)
    if best is None:
        yield missing("discomfort of the best robot", f"< {UNEASY:.0%} of touched steps", "gru")
        return
    for family, shares in _by_family(files[best], "discomfort_share").items():
        value, ci = of_means(lambda mean: mean, shares.mean(axis=(0, 2)))
        bar = f"< {UNEASY:.0%} of touched steps"
        yield Gate(f"discomfort, {family}", bar, value, ci, value < UNEASY, best)


def _failing(files: Files) -> Iterator[Gate]:
    """Yield the shares of pairs in which the best robot failed its person, by side."""
    best = best_robot(files)
    for side in TESTED:
        bar = f"< {FAILED:.0%}" if side == TESTED[-1] else "stated"
        if best is None:
            yield missing(f"persons that failed, {side}", bar, "gru")
            continue
        success = scores(files[best], side, "success")
        value, ci = of_means(lambda mean: mean, failed(success).mean(axis=0))
        holds = value < FAILED if side == TESTED[-1] else None
        detail = f"{best}, caring success {success.mean():.0%}"
        yield Gate(f"persons that failed, {side}", bar, value, ci, holds, detail)


def _stealing(files: Files) -> Iterator[Gate]:
    """Yield the gates of what is earned without care."""
    bound, bar = bound_of(files), f"< {STOLEN:.0%} of the bound, no caring success"
    if STEALS not in files or bound is None:
        yield missing("earned without care", bar, STEALS, *BOUNDS[:1])
        return
    worth = float(bound[0].mean())
    for name, earned in files[STEALS]["earned"].items():
        most, cared = max(earned["return"]), max(earned["success"])
        value = most / worth
        detail = f"return {most:.1f} of {worth:.1f}, caring success {cared:.1%}"
        holds = worth > 0.0 and value < STOLEN and cared < CARED
        yield Gate(f"steals: {name}", bar, value, None, holds, detail)


def _bounded(files: Files) -> Gate:
    """Return the gate of the best robot's distance from the bound of the same persons."""
    name, bar = "best robot beside the bound", "no more than noise above 1"
    bound, best = bound_of(files), best_robot(files)
    if bound is None or best is None or SINGLE not in files[best]["sides"]:
        return missing(name, bar, *BOUNDS, "gru")
    returns = scores(files[best], SINGLE, "return")[:, :, 1::2].mean(axis=(0, 2))
    if bound[0].mean() <= 0.0:
        return Gate(name, bar, None, None, None, "no bound above 0")
    value, ci = of_means(lambda a, b: a / b, returns, bound[0], paired=True)
    detail = f"{best}, {returns.mean():.1f} of {bound[0].mean():.1f}, {len(returns)} persons"
    return Gate(name, bar, value, ci, value <= 1.0 or (ci is not None and ci[0] <= 1.0), detail)


def _by_family(file: Mapping[str, Any], what: str) -> dict[str, np.ndarray]:
    """Return results [robots, persons, episodes] with strangers, by the persons' family."""
    sides = [side for side in STRANGERS if side in file["sides"]]
    met = np.concatenate([file["sides"][side]["persons"] for side in sides]) // ROWS
    values = np.concatenate([scores(file, side, what) for side in sides], axis=1)
    return {
        family: values[:, met == place] for place, family in enumerate(ALL) if (met == place).any()
    }
