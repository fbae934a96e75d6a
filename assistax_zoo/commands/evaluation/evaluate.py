"""M_test of robot policies against the zoo's partners, and the cross-play of a population."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from assistax_base.errors import counted, listing
from assistax_zoo.commands.options import Engine, PartnerChoice, Source
from assistax_zoo.shell.console import answer, new_table, print_json, print_table, stdout_is_data
from evaluation.play.how import PlaySettings
from zoo.partners.person_ids import OWN

Figure = dict[str, Any] | None


@dataclasses.dataclass(frozen=True)
class CrossPlaySettings(PlaySettings):
    """Settings of a cross-play, which has no series."""

    # Its options have the same help.
    __doc__ = PlaySettings.__doc__
    series: Annotated[int, Parameter(parse=False)] = 1


def evaluate(
    *,
    how: Annotated[PlaySettings, Parameter(name="*")],
    policy: tuple[str, ...],
    against: PartnerChoice = PartnerChoice(),
    fetch: bool = False,
    reuse: bool = False,
    replace: bool = False,
    out: Path | None = None,
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Compute M_test: the return of robot policies with partners of the zoo that they never met.

    Each partner plays under its own disability setting, in its own episodes, which are the same for
    every robot. With --out, every episode is kept there as Parquet, and a stopped run continues
    where it was.

    Args:
        how: Settings of the play.
        policy: Robot: an id, a .safetensors or .onnx file, python:FILE.py:FACTORY or
            python:package.module:FACTORY. For more seeds repeat it, or quote a glob of ids or
            .safetensors files.
        against: Choice of partners and references.
        fetch: Fetch partners and robots of the zoo that are missing here from the remote.
        reuse: Take the result in the output folder of a robot from Python code, even if its module
            does not declare its dependencies. Without this the result is refused, since the robot
            may have changed.
        replace: Remove the result in the output folder, of whichever job, and play anew. Without
            this the result of another job is refused.
        out: Folder for the tables.
        source: Source of the policies.
        json: Print JSON.

    Example:
        assistax-zoo evaluate --task scratch --policy scratch/ppo-ego-s0-v1/robot --episodes 8
        --out results
    """
    with stdout_is_data():
        from assistax_zoo.evaluating import evaluate as evaluate_robots

        result = evaluate_robots(
            list(policy),
            fetch=fetch,
            reuse=reuse,
            replace=replace,
            out=out,
            **vars(against),
            **vars(how),
            **source.given(),
        )
        summary = result.to_json()
    if json:
        print_json(summary)
    else:
        _print_evaluation(summary)
        if out:
            print(f"tables in {out}: episodes.parquet has every episode")


def crossplay(
    *,
    how: Annotated[CrossPlaySettings, Parameter(name="*")],
    out: Path,
    egos: tuple[str, ...] = (),
    partners: tuple[str, ...] = (),
    persons: int | None = None,
    release: str | None = None,
    share: str | None = None,
    replace: bool = False,
    engine: Engine = Engine(),
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Play every robot of a population with every human, and draw the clustered matrix.

    A robot with the human it was trained with is self-play, the matrix's diagonal. A stopped run
    continues.

    Args:
        how: Settings of the play.
        out: Folder for the tables and the figure.
        egos: Glob over robots, such as `'scratch/ippo-*/robot'`; repeat it for more; all if not
            given.
        partners: Glob over humans; repeat it for more; persons for persons; all if not given.
        persons: Number of persons to draw. Default 200.
        release: Release of robots and humans, if a glob names none. Default: the newest complete
            release that has the task.
        share: Simulate only a share, such as 2/4; once all parts are there, the command without
            --share merges them.
        replace: Remove the result in the output folder, of whichever job, and play anew. Without
            this the result of another job is refused.
        engine: Engine of the blocks.
        source: Source of the policies.
        json: Print JSON.

    Example:
        assistax-zoo crossplay --task scratch --egos 'scratch/ippo-*/robot' --partners
        'scratch/ippo-*/human' --out xp
    """
    cluster = engine.cluster()
    part = _share(share, replace, spread=cluster is not None)
    with stdout_is_data():
        from assistax_zoo.evaluating import cross_play, play_share

        where: dict[str, Any] = {"release": release, "persons": persons, **source.given()}
        if part:
            done = vars(play_share(part, how, out, egos, partners, **where))
            summary = {**done, "share": share}
        else:
            where |= {name: value for name, value in vars(how).items() if name != "series"}
            where |= {"out": out, "cluster": cluster, "replace": replace}
            summary = cross_play(egos, partners, **where).to_json()
    if share:
        answer(json, summary, *_share_lines(summary, out))
    elif json:
        print_json(summary)
    else:
        _print_crossplay(summary)
        print(f"tables and crossplay.png in {out}")


def _share(text: str | None, replace: bool, spread: bool) -> tuple[int, int] | None:
    """Return the number of a share and the count of shares of i/n; None if `text` is empty."""
    if not text:
        return None
    if spread:
        raise ValueError(
            "--share is one share of a run by hand, --engine ray spreads all of them; leave one out"
        )
    if replace:
        raise ValueError("--replace would remove the parts of the other shares; leave it out")
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise ValueError(f"share is {text!r}; expected i/n with i from 1 to n, such as 2/4")
    return int(number), int(count)


def _share_lines(summary: dict[str, Any], out: Path) -> tuple[str, str]:
    parts = f"{counted(summary['chunks'], 'part')} of {out}/parts"
    next_step = "all parts are here: the same command without --share merges them"
    if missing := summary["missing"]:
        next_step = (
            f"parts not here: {missing} of {summary['all_chunks']}; gather all shares' parts"
        )
    done = f"share {summary['share']}: {counted(summary['episodes'], 'episode')} in {parts}"
    return done, next_step


def _print_evaluation(summary: dict[str, Any]) -> None:
    robots, split = counted(len(summary["egos"]), "robot"), summary["split"]["id"]
    title = f"{summary['task']}, {robots}, split {split}"
    names = (
        *(("M_test", "m_test"), ("M_validation", "m_validation"), ("M_train", "m_train")),
        ("M_train - M_test", "gap"),
    )
    rows = [(name, summary[key]) for name, key in names]
    for key in ("by_algorithm", "by_disability", "by_preference", "by_place"):
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


def _print_crossplay(summary: dict[str, Any]) -> None:
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
            interval = " to ".join(f"{end:.{digits}f}" for end in figure["mean_ci"] or ())
            table.add_row(name, mean, interval or "-", iqm, str(figure["n"]))
    print_table(table)
