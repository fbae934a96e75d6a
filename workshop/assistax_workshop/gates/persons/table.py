"""Gates of persons: results of the stages against their bars, with 95% intervals."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from assistax_envs.persons import PARAMETERS, persons
from assistax_workshop.gates.audit_gates import Gate, of_means
from assistax_workshop.gates.persons.care import (
    SCRIPT,
    Files,
    gates_of_care,
    missing,
    scores,
    steps_of,
)
from assistax_workshop.gates.persons.play import SINGLE, STRANGERS
from evaluation.figures.bootstrap import RESAMPLES, draw_counts
from evaluation.figures.planning import measure_spread

SIDE = "validation"  # side of the strangers of gates that name no side
TESTED = ("corners", "unseen")  # sides of gates of care
SIGNED = ("gru", "dagger")  # kinds that are not told, and see the signs
CARING, OFTEN = 0.8, 0.9  # caring success with one person, and the share of persons that have it
LESS, MORE, BACK, WHO = 0.2, 0.15, 0.5, 0.2
SEEN_BEFORE = ("dagger", "learned")  # the second kind has met the test side
PLAYED = {"return": "return", "success": "caring success"}  # columns of stages, and words
CONVERGED = 0.5  # share of the best robot's return below which a robot has not learned
TUNED = 0.9
SEARCH, SEARCH_TOLD = "search", "search-told"
RESAMPLED = 200  # bootstrap samples of a share of variance


def read_stages(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the results of a folder's stages, by name."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(folder.glob("*.json"))}


def gates_of_persons(task: str, files: Files) -> list[Gate]:
    """Return every gate of persons, from the results that `run_stages` wrote."""
    return [
        *(_worth(f"told, beside no signs, {side}: more", files, ("masked", "told-gru"), side, MORE)
          for side in TESTED),
        *(_won_back(files, untold, side) for untold in SIGNED for side in TESTED),
        *gates_of_care(task, files),
        *(_worth(f"learned with the test side, {side}: more", files, SEEN_BEFORE, side, MORE)
          for side in TESTED),
        *_with_one(files),
        _as_searched("script", files, SEARCH),
        _as_searched("told script", files, SEARCH_TOLD),
        _lost(files),
        *(_worth(f"with a memory, {side}: more", files, ("ppo", "gru"), side)
          for side in STRANGERS),
        _who_meets_whom(files),
        _in_range(task),
    ]  # fmt: skip


def _with_one(files: Files) -> list[Gate]:
    """Return the gates of best responses to single persons, and of the script with them."""
    name, bar = (
        "best response to one person",
        f"caring success {CARING:.0%} with {OFTEN:.0%} of them",
    )
    beside, half = "script with the same persons", "below half of the best response's"
    if "best" not in files:
        return [missing(name, bar, "best"), missing(beside, half, "best")]
    best = {what: scores(files["best"], SINGLE, what).mean(axis=(0, 2)) for what in PLAYED}
    often = (best["success"] >= CARING).astype(float)
    value, ci = of_means(lambda share: share, often)
    detail = f"{len(often)} persons, caring success {best['success'].mean():.0%}"
    gates = [Gate(name, bar, value, ci, value >= OFTEN, f"{detail}, {steps_of(files['best'])}")]
    if SCRIPT not in files:
        return [*gates, missing(beside, half, SCRIPT)]
    for what, word in PLAYED.items():
        script, theirs = scores(files[SCRIPT], SINGLE, what).mean(axis=(0, 2)), best[what]
        if len(script) != len(theirs):
            raise ValueError(
                f"stage best has {len(theirs)} persons and {SCRIPT} {len(script)}; run both with "
                "the same number"
            )
        row = f"{beside}: {word}"
        detail = f"{script.mean():.3g} of {theirs.mean():.3g}"
        if theirs.mean() <= 0.0:
            gates.append(Gate(row, half, None, None, None, f"{detail}: no share of it"))
            continue
        ratio, ci = of_means(lambda a, b: a / b, script, theirs, paired=True)
        gates.append(Gate(row, half, ratio, ci, ratio < 0.5, detail))
    return gates


def _as_searched(what: str, files: Files, stage: str) -> Gate:
    """Return the gate of a script's return, as a share of the best searched script's."""
    name, bar = f"{what} beside the best of a search", f">= {TUNED:.0%} of its return"
    if stage not in files:
        return missing(name, bar, stage)
    best, own = scores(files[stage], SIDE, "return").mean(axis=2)
    detail = f"return {own.mean():.1f} of {best.mean():.1f}, {files[stage]['about']['tries']} tries"
    if best.mean() <= 0.0:
        return Gate(name, bar, None, None, None, f"{detail}: no share of it")
    value, ci = of_means(lambda a, b: a / b, own, best, paired=True)
    return Gate(name, bar, value, ci, value >= TUNED, detail)


def _lost(files: Files) -> Gate:
    """Return the gate of the loss of robots that were trained with idle persons."""
    name, bar = "robot trained with idle persons", f"loses > {LESS:.0%}, the interval above 0"
    return _compared(
        name,
        bar,
        files,
        ("ppo", "idle"),
        lambda ppo, idle: (ppo - idle) / ppo,
        lambda value, low: value > LESS and low > 0.0,
    )


def _worth(
    name: str, files: Files, kinds: tuple[str, str], side: str, least: float | None = None
) -> Gate:
    """Return the gate of the share that one kind of robot earns more than another."""
    bar = "stated" if least is None else f">= {least:+.0%}, the interval above 0"
    holds = None if least is None else lambda value, low: value >= least and low > 0.0
    return _compared(name, bar, files, kinds, lambda a, b: (b - a) / a, holds, side)


def _won_back(files: Files, untold: str, side: str) -> Gate:
    """Return the gate of the share of telling's worth that signs win back for a kind of robot."""
    name, bar = f"signs win back, of that, {untold}, {side}", f">= {BACK:.0%}"
    kinds = ("masked", "told-gru", untold)
    if absent := [kind for kind in kinds if kind not in files]:
        return missing(name, bar, *absent)
    masked, told, _ = (scores(files[kind], side, "return").mean() for kind in kinds)
    if told <= masked:
        return Gate(name, bar, None, None, None, "telling is worth nothing: none to win back")
    return _compared(
        name,
        bar,
        files,
        kinds,
        lambda a, b, c: (c - a) / np.where(b > a, b - a, np.nan),
        lambda value, low: value >= BACK,
        side,
    )


def _who_meets_whom(files: Files) -> Gate:
    """Return the gate of the share of variance that belongs to pairs of robot and person."""
    name, bar = "who meets whom, share of variance", f">= {WHO:.0%}"
    if "ppo" not in files:
        return missing(name, bar, "ppo")
    returns = scores(files["ppo"], SIDE, "return")
    means = returns.mean(axis=(1, 2))
    returns = returns[means >= CONVERGED * means.max()]
    if len(returns) < 2:
        return Gate(name, bar, None, None, None, "fewer than two robots have learned")
    value, rng = _share_of_pairs(returns), np.random.default_rng(0)
    people = returns.shape[1]
    drawn = rng.integers(people, size=(RESAMPLED, people))
    draws = [_share_of_pairs(returns[:, who]) for who in drawn]
    low, high = np.quantile(draws, (0.025, 0.975))
    detail = f"{len(returns)} of {len(means)} robots, {people} persons"
    return Gate(name, bar, value, (float(low), float(high)), value >= WHO, detail)


def _share_of_pairs(returns: np.ndarray) -> float:
    """Return the share of pairs in the variance of returns [robots, persons, episodes]."""
    axes = np.meshgrid(*(np.arange(n) for n in returns.shape), indexing="ij")
    columns = dict(zip(("ego", "partner", "episode"), (axis.ravel() for axis in axes), strict=True))
    spread = measure_spread(pl.DataFrame({**columns, "return": returns.ravel()}))
    seeds, partners, pairs = spread.seeds**2, spread.partners**2, spread.pairs**2
    return pairs / (seeds + partners + pairs) if pairs else 0.0


def _in_range(task: str) -> Gate:
    """Return the gate of the share of persons' numbers inside their cited ranges."""
    rows, ranges = persons(task), PARAMETERS[task]
    inside = [
        ((row >= np.float32(number.low)) & (row <= np.float32(number.high)))
        | ((row == 0) & bool(number.none))
        for row, number in zip(rows.T, ranges, strict=True)
    ]
    value, sources = float(np.mean(inside)), sum(bool(number.source) for number in ranges)
    detail = f"{len(rows)} persons; {sources} of {len(ranges)} numbers name a source"
    holds = value == 1.0 and sources == len(ranges)
    return Gate(
        "numbers inside their ranges", "all, each with a source", value, None, holds, detail
    )


def _compared(
    name: str,
    bar: str,
    files: Files,
    kinds: tuple[str, ...],
    figure: Callable[..., Any],
    holds: Callable[[float, float], bool] | None,
    side: str = SIDE,
) -> Gate:
    """Return the gate of a figure of returns with strangers; seeds and persons are resampled."""
    if absent := [kind for kind in kinds if kind not in files]:
        return missing(name, bar, *absent)
    earned = [scores(files[kind], side, "return").mean(axis=2) for kind in kinds]
    detail = ", ".join(
        f"{kind} {s.mean():.1f} ({len(s)} seeds, {steps_of(files[kind])})"
        for kind, s in zip(kinds, earned, strict=True)
    )
    if earned[0].mean() <= 0.0:
        return Gate(name, bar, None, None, None, f"{detail}: no share of it")
    rng = np.random.default_rng(0)
    people = draw_counts(earned[0].shape[1], RESAMPLES, rng)
    means = [
        np.einsum("bs,sp,bp->b", draw_counts(len(s), RESAMPLES, rng), s, people) / s.size
        for s in earned
    ]
    low, high = map(float, np.nanquantile(figure(*means), (0.025, 0.975)))
    value = float(figure(*(s.mean() for s in earned)))
    met = None if holds is None else holds(value, low)
    return Gate(name, bar, value, (low, high), met, detail)
