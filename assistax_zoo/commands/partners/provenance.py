"""Whether a finished folder can be believed: its hashes, and a sample of it played again."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_base.errors import counted, printable
from assistax_zoo.commands.options import Source
from assistax_zoo.shell.console import answer, first_lines, stdout_is_data
from zoo.registry import load_registry

if TYPE_CHECKING:
    from evaluation.replay.replay import ReplayReport

UNDECIDED = 3  # exit code of `replay`: neither the same nor another


def verify_results(folder: Path, registry: Path | None, json: bool) -> bool:
    """Compare a finished folder and its sources with its manifest; print and return the verdict."""
    from evaluation.record.verification import check_sources, verify_folder

    report = verify_folder(folder)
    if report.ok:
        report = dataclasses.replace(check_sources(folder, registry), files=report.files)
    lines = first_lines("not here, and not checked: ", report.absent, "source")
    lines += first_lines("problem: ", report.problems, "problem")
    verdict = "verified" if report.ok else f"{counted(len(report.problems), 'problem')} in"
    files = f"{counted(report.files, 'file')} of {folder}, and {report.sources} that they depend on"
    content = {"ok": report.ok, **vars(report)}
    answer(json, content, *map(printable, lines), f"{verdict} {files}")
    return report.ok


def replay(
    what: Path,
    /,
    *,
    sample: int = 20,
    seed: int | None = None,
    run_code: bool = False,
    crossplay: Path | None = None,
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Recompute a folder's figures and play a sample again; exit code 0 only if they are confirmed.

    Given a log of the browser page instead, play its actions again from its start. The physics is
    that of the page, the robot's actions are computed again, and the figures are printed. A log
    that does not fit is refused (exit code 1). No log proves that a person played.

    Of a folder the job is made again from the registry. Every table and figure is computed again
    from the episodes. A sample of the episodes is played again, those of the references too. If the
    folder names a machine of this kind, every bit must be the same. If not, each robot, partner and
    pair may differ by as much as was measured between processors. Any folder can name another
    machine. So the answer says which of the two applied, how much of the headline figure could be
    hidden, and what was not checked. Exit code 1: they differ. Exit code 3: more than 5% could be
    hidden behind another processor, and the figure can neither be confirmed nor refuted.

    Args:
        what: Folder that `assistax-zoo evaluate --out` or `crossplay --out` filled, or a log.
        sample: Episodes of a folder; those that were simulated together are played together, so
            there may be more.
        seed: Seed of the choice, to repeat one; if not given, a new one, which is printed.
        run_code: Run a robot from Python code, or read a robot's file outside the folder, that the
            folder names; read it first.
        crossplay: Folder of the cross-play that was given to evaluate; it is checked as well.
        source: Where policies come from.
        json: Print JSON.

    Example:
        assistax-zoo replay results --sample 20
    """
    if what.is_file():
        _replay_log(what, source, json)
        return
    with stdout_is_data():
        from evaluation.replay.replay import replay_folder

        registry = load_registry(source.registry)
        report = replay_folder(
            what,
            registry,
            sample=sample,
            seed=seed,
            run_code=run_code,
            lock=source.lock,
            crossplay=crossplay,
        )
    answer(json, vars(report), *map(printable, _replay_lines(report)))
    if not report.ok:
        raise SystemExit(1)
    if report.verdict == "cannot be told":
        raise SystemExit(UNDECIDED)


def _replay_log(path: Path, source: Source, json: bool) -> None:
    """Play a log of the browser page again, and print its figures."""
    with stdout_is_data():
        from evaluation.people.replaying import replay_log

        played = replay_log(path, load_registry(source.registry))
    log, figures = played.recorded.log, dict(played.figures)
    content: dict[str, Any] = {"log": str(path), "sha256": log.sha256, "ok": True}
    content |= {"task": log.task, "robot": log.robot.name, "off": played.off, "figures": figures}
    answer(
        json,
        content,
        f"{log.steps} steps of {log.task} with {log.robot.name} played again from start "
        f"{log.start}: the robot's actions are within {played.off:.1g} of the recorded ones",
        f"return {figures['return']:.3f}, caring success {'yes' if figures['success'] else 'no'}, "
        f"discomfort in {figures['discomfort_share']:.0%} of felt steps, violation "
        f"{figures['violation']}",
        f"{path} fits its episode, which does not prove that a person played",
    )


def _replay_lines(report: "ReplayReport") -> list[str]:
    """Return the findings, the unchecked parts, and the options that draw the same sample."""
    lines = [f"not checked: {what}" for what in report.unchecked]
    lines += first_lines("problem: ", report.problems, "problem")
    if not report.episodes:
        return [*lines, f"{report.folder}: {report.why}; nothing was played"]
    return [
        *lines,
        f"compared {'bit by bit' if report.exact else 'with measured noise'}: {report.why}",
        f"sample of seed {report.seed}: {report.episodes} of {report.of_episodes} episodes and "
        f"{report.references} of {report.of_references} of the references",
        *_chance(report),
        f"every figure of {report.folder} drawn again, "
        f"{counted(report.episodes, 'episode')} played again: {_verdict(report)}",
    ]


def _chance(report: "ReplayReport") -> list[str]:
    """Say with which chance a change in few tiles was found, where not all were played."""
    if report.tiles == report.of_tiles:
        return []
    return [
        f"{report.tiles} of {report.of_tiles} tiles were played: a change in a single tile is "
        f"found with a chance of {report.found:.0%}"
    ]


def _verdict(report: "ReplayReport") -> str:
    """Return the lines about the headline figure and the part of it that could be hidden."""
    if not report.ok:
        within = "not all within what processors differ by"
        return f"{report.differing} differ" if report.exact else within
    if report.exact:
        rest = "" if report.verdict == "same" else ", and the others were not played"
        return f"the same to the last bit{rest}"
    if report.hidden is None or report.difference is None:
        return f"{report.verdict} from another processor: no episode of {report.figure} was played"
    share = "" if report.hidden_share is None else f", {report.hidden_share:.1%},"
    flags = [f", {name} of {bias:.1%} of episodes" for name, bias in report.hidden_flags.items()]
    told = "within what processors differ by"
    if report.verdict == "cannot be told":
        told = "which cannot be told from another processor"
    return (
        f"{report.figure} is {report.value:.1f} in the folder, {report.difference:+.1f} from it "
        f"here, {told}: up to {report.hidden:.1f} of it{share} could be hidden" + "".join(flags)
    )
