"""Whether a finished folder can be believed: its hashes, and a sample of it played again."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from assistax_base.errors import counted, printable
from assistax_zoo.commands.options import Source
from assistax_zoo.shell.console import answer, stdout_is_data
from zoo.registry import load_registry

if TYPE_CHECKING:
    from evaluation.replay.replay import ReplayReport

SHOWN = 8  # problems; --json has all


def verify_results(folder: Path, registry: Path | None, json: bool) -> bool:
    """Compare a finished folder and its sources with its manifest; print and return the verdict."""
    from evaluation.record.verification import check_sources, verify_folder

    report = verify_folder(folder)
    if report.ok:
        report = dataclasses.replace(check_sources(folder, registry), files=report.files)
    lines = [f"not here, and not checked: {absent}" for absent in report.absent]
    lines += [f"problem: {problem}" for problem in report.problems]
    verdict = "verified" if report.ok else f"{counted(len(report.problems), 'problem')} in"
    files = f"{counted(report.files, 'file')} of {folder}, and {report.sources} that they depend on"
    content = {"ok": report.ok, **vars(report)}
    answer(json, content, *map(printable, lines), f"{verdict} {files}")
    return report.ok


def replay(
    folder: Path,
    /,
    *,
    sample: int = 20,
    seed: int | None = None,
    run_code: bool = False,
    crossplay: Path | None = None,
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Recompute a folder's figures and play a sample again; exit code 1 if they differ.

    The job is made again from the registry. Every table and figure is computed again from the
    episodes. A sample of the episodes is played again, those of the references too. If the folder
    names a machine of this kind, every bit must be the same. If not, each robot, partner and pair
    may differ by as much as was measured between processors. The answer says which of the two
    applied, and what was not checked.

    Args:
        folder: Folder that `assistax-zoo evaluate --out` or `crossplay --out` filled.
        sample: Episodes; those that were simulated together are played together, so there may be
            more.
        seed: Seed of the choice, to repeat one; if not given, a new one, which is printed.
        run_code: Run a robot from Python code that the folder names; read it first.
        crossplay: Folder of the cross-play that was given to evaluate; it is checked as well.
        source: Where policies come from.
        json: Print JSON.

    Example:
        assistax-zoo replay results --sample 20
    """
    with stdout_is_data():
        from evaluation.replay.replay import replay_folder

        registry = load_registry(source.registry)
        report = replay_folder(
            folder,
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


def _replay_lines(report: "ReplayReport") -> list[str]:
    """Return what was found, what was not checked, and how to choose the same sample again."""
    lines = [f"not checked: {what}" for what in report.unchecked]
    lines += [f"problem: {problem}" for problem in report.problems[:SHOWN]]
    if len(report.problems) > SHOWN:
        lines.append(f"and {counted(len(report.problems) - SHOWN, 'more problem')}")
    if not report.episodes:
        return [*lines, f"{report.folder}: {report.why}; nothing was played"]
    if report.exact:
        verdict = "the same to the last bit" if report.ok else f"{report.differing} differ"
    else:
        reach = "within" if report.ok else "not all within"
        verdict = f"{report.difference:+.1f} in the mean return, {reach} what processors differ by"
    return [
        *lines,
        f"compared {'bit by bit' if report.exact else 'with measured noise'}: {report.why}",
        f"sample of seed {report.seed}: {report.episodes} of {report.of_episodes} episodes and "
        f"{report.references} of {report.of_references} of the references",
        f"every figure of {report.folder} drawn again, "
        f"{counted(report.episodes, 'episode')} played again: {verdict}",
    ]
