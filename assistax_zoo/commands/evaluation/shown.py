"""Figures of evaluations and cross-plays, as the commands print them."""

import re
from collections.abc import Iterable
from typing import Any

from assistax_base.errors import counted, listing
from assistax_zoo.shell.console import new_table, print_table
from zoo.partners.person_ids import OWN

Figure = dict[str, Any] | None


def print_headline(summary: dict[str, Any]) -> None:
    """Print the figures that a reader needs first, in five lines at most."""
    from evaluation.cast.met_partners import UNKNOWN

    robots, split = counted(len(summary["egos"]), "robot"), summary["split"]["id"]
    side = summary["side"]
    partners = counted(summary["partners"][side], f"{side} partner")
    print(f"{_main(summary)}: {robots} of {summary['task']}, {partners} of {_plain(split)}")
    if groups := summary["by_group"]:
        worst = min(groups, key=lambda name: groups[name]["mean"])
        parts = (f"{name} {_with_interval(figure)}" for name, figure in groups.items())
        print(f"its groups: {', '.join(parts)}" + f"; {worst} is the worst" * (len(groups) > 1))
    else:
        worst = summary["worst_partner"]
        print(f"worst partner: {worst['partner']}, mean return {worst['mean']:.1f}")
    if caring := summary["caring_success"]:
        slopes = ", ".join(_slope(*wish) for wish in summary["adaptation"].items())
        after = f"; adaptation slope: {slopes}" * bool(slopes)
        print(f"caring success {_with_interval(caring, 2)}{after}")
    if beside := _beside(summary["references"]):
        print(f"beside it: {beside}")
    notes = counted(len(summary["notes"]), "note")
    # Figures may then count partners that the robot met.
    unknown = "" if summary["met"]["known"] else f"; {UNKNOWN} (--trained-with)"
    print(f"--all prints every figure, and {notes}{unknown}")


def _main(summary: dict[str, Any]) -> str:
    """Return M_test, or the mean of the side that played, with its name and interval."""
    name = {"test": "M_test", "validation": "M_validation", "train": "M_train"}[summary["side"]]
    if figure := summary[name.lower()]:
        return f"{name} {_with_interval(figure)}"
    missing = [
        name for name in summary["split"].get("groups", ()) if name not in summary["by_group"]
    ]
    return f"no M_test, since {' and '.join(missing) or 'a group'} did not play"


def _with_interval(figure: dict[str, Any], digits: int = 1) -> str:
    interval = _interval(figure, digits)
    return f"{figure['mean']:.{digits}f}" + f" [{interval}]" * bool(interval)


def _interval(figure: dict[str, Any], digits: int) -> str:
    """Return the interval of a mean; empty if there is none."""
    return " to ".join(f"{end:.{digits}f}" for end in figure["mean_ci"] or ())


def _slope(wish: str, found: dict[str, Any]) -> str:
    slope, ends = found["slope"]["value"], found["slope"]["value_ci"]
    return f"{wish} {slope:.2f}" + (f" [{ends[0]:.2f} to {ends[1]:.2f}]" if ends else "")


def _beside(references: dict[str, Figure] | None) -> str:
    """Return the script's mean, or random actions' without one, and the best response known."""
    names = {
        "script": "the script",
        "uniform_random": "random actions",
        "best_response": "the bound",
    }
    known = {name: figure for name in names if (figure := (references or {}).get(name))}
    if "script" in known:
        known.pop("uniform_random", None)
    return ", ".join(f"{names[name]} {_with_interval(found)}" for name, found in known.items())


def _plain(split: str) -> str:
    """Return a split's id without its seed, release and digest."""
    return re.sub(r"-s[0-9]+-v[0-9]+-[0-9a-f]{8}$", "", split)


def print_evaluation(summary: dict[str, Any]) -> None:
    """Print all figures of an evaluation."""
    robots, split = counted(len(summary["egos"]), "robot"), summary["split"]["id"]
    title = f"{summary['task']}, {robots}, split {split}"
    names = (
        *(("M_test", "m_test"), ("M_validation", "m_validation"), ("M_train", "m_train")),
        ("M_train - M_test", "gap"),
    )
    rows = [(name, summary[key]) for name, key in names]
    for key in ("by_group", "by_algorithm", "by_disability", "by_preference", "by_place"):
        word = "episode " * (key == "by_place")
        rows += [(f"  {word}{name}", fig) for name, fig in summary[key].items() if name != OWN]
    _print_figures(title, rows)
    _print_care(summary)
    if touch := summary["touch"]:
        from evaluation.record.columns import TOUCHES

        rows = [(TOUCHES[name], figure) for name, figure in touch.items()]
        _print_figures("how people were touched", rows, "mean over episodes", digits=3)
    _print_more(summary)
    if summary["references"]:
        _print_references(summary["references"], summary["relative"])
    _print_variance(summary["variance"])
    worst = summary["worst_partner"]
    print(f"worst partner: {worst['partner']}, mean return {worst['mean']:.1f}")
    _print_origin(summary)


def _print_care(summary: dict[str, Any]) -> None:
    """Print how people fared in a gentle task."""
    if not summary["violations"]:
        return
    rows = [
        ("caring success", summary["caring_success"]),
        ("persons that were failed", summary["failed_persons"]),
        ("discomfort, of felt steps", summary["discomfort"]),
        ("violations", summary["violations"]),
        *((f"  {kind}", figure) for kind, figure in summary["violations_by_kind"].items()),
    ]
    _print_figures("how people fared", rows, "share", digits=3)
    for wish, found in summary["adaptation"].items():
        slope, ends = found["slope"], found["slope"]["value_ci"]
        interval = " [{:.2f}, {:.2f}]".format(*ends) if ends else ""
        print(
            f"adaptation slope, {wish}: {slope['value']:.2f}{interval}; done / liked "
            f"{found['done_to_liked']:.2f}, within 1.5 of it {found['within']:.0%} of touch"
        )


def _print_references(references: dict[str, Figure], relative: dict[str, Any]) -> None:
    from evaluation.figures.normalised import REFERENCE_ORDER

    own = references.get("self_play")  # is the best response where no cross-play was given
    rows = [
        (name.replace("_", " "), references[name])
        for name in REFERENCE_ORDER
        if name in references and (name != "best_response" or references[name] != own)
    ]
    _print_figures("to compare with: the same partners and episodes", rows)
    if relative["normalised_return"] is None:
        print("nobody's best response is known, so that nothing is relative to one")
        return
    rows = [("normalised return", relative["normalised_return"]), ("BR-Prox", relative["br_prox"])]
    title = "relative to zero action (0) and the best response known (1)"
    _print_figures(title, rows, "share of that range", digits=2)
    if coverage := relative["coverage"]:
        print(
            f"regret {relative['regret']['mean']:.1f}; within {coverage['epsilon']:.0%} of the "
            f"best response: {coverage['value']:.0%}"
        )
    if unscorable := relative["unscorable"]:
        names = listing(unscorable, 5)
        print(f"without a scale, best response at or below zero action: {names}")


def print_crossplay(summary: dict[str, Any]) -> None:
    """Print all figures of a cross-play."""
    names = (
        ("self-play", "self_play"),
        ("cross-play", "cross_play"),
        ("self-play - cross-play", "gap"),
        ("  within one algorithm", "within_algorithm"),
        ("  across algorithms", "across_algorithms"),
        ("  within one disability setting", "within_disability"),
        ("  across disability settings", "across_disabilities"),
    )
    shape = f"{counted(summary['egos'], 'robot')} x {counted(summary['partners'], 'human')}"
    _print_figures(f"{summary['task']}, {shape}", [(name, summary[key]) for name, key in names])
    _print_more(summary)
    _print_variance(summary["variance"])
    best = summary["best_ego"]
    print(f"best robot: {best['ego']}, mean return {best['mean']:.1f}")
    _print_origin(summary)


def _print_more(summary: dict[str, Any]) -> None:
    """Print the metrics of installed packages that were asked for."""
    if more := summary.get("more"):
        rows = [(figure["title"], figure) for figure in more.values()]
        packages = ", ".join(dict.fromkeys(f["package"] for f in more.values()))
        _print_figures(f"more, by {packages}", rows, "mean over episodes", digits=3)


def _print_variance(variance: dict[str, Any] | None) -> None:
    if variance is None or variance["interaction_index"] is None:
        return
    names = {"seeds": "robots", "partners": "partners", "pairs": "pairs"}
    parts = ", ".join(f"{word} {variance['spread'][name]:.1f}" for name, word in names.items())
    chance = variance["interaction_p"]
    beyond = (
        "" if chance is None else f" (p {chance:.2g} that pairs differ by their episodes alone)"
    )
    print(f"SD of {parts}; interaction index {variance['interaction_index']:.2f}{beyond}")


def _print_origin(summary: dict[str, Any]) -> None:
    speed = summary["env_steps_per_second"]
    pace = f", {speed:,.0f} environment steps/s" if speed else ", found finished"
    print(
        f"{counted(summary['episodes'], 'episode')} on {summary['backend']}{pace}; environment "
        f"version {summary['env_version']}, release {summary['release']}; non-finite episodes: "
        f"{summary['nonfinite']}"
    )
    for note in summary["notes"]:
        print(f"note: {note}")


def _print_figures(
    title: str,
    rows: Iterable[tuple[str, Figure]],
    what: str = "return of an episode",
    digits: int = 1,
) -> None:
    """Print a table of the figures that are not None."""
    table = new_table(title)
    table.add_column(what, overflow="fold")
    for name in ("mean", "95% interval", "IQM", "pairs"):
        table.add_column(name, justify="right", no_wrap=True)
    for name, figure in rows:
        if figure is not None:
            mean, iqm = (f"{figure[key]:.{digits}f}" for key in ("mean", "iqm"))
            table.add_row(name, mean, _interval(figure, digits) or "-", iqm, str(figure["n"]))
    print_table(table)
