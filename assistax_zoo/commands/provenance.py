"""Whether a finished folder can be believed: its hashes, and a sample of it played again."""

from pathlib import Path

from assistax_zoo.commands.options import Source
from assistax_zoo.console import answer, stdout_is_data
from zoo.errors import printable
from zoo.registry import load_registry


def verify_results(folder: Path, registry: Path | None, json: bool) -> bool:
    """Hold a finished folder and its sources against its manifest; print and return the verdict."""
    from evaluation.provenance import verify_folder
    from evaluation.sources import SourceReport, check_sources

    report = verify_folder(folder)
    sources = check_sources(folder, registry) if report.ok else SourceReport(0, (), ())
    problems = [*report.problems, *sources.problems]
    content = {
        "ok": not problems,
        "folder": str(folder),
        "files": report.files,
        **vars(sources),
        "problems": problems,
    }
    lines = [f"not here, and not checked: {absent}" for absent in sources.absent]
    lines += [f"problem: {problem}" for problem in problems]
    told = f"{len(problems)} problems in" if problems else "verified"
    files = f"{report.files} files of {folder}, and {sources.sources} that they depend on"
    answer(json, content, *map(printable, lines), f"{told} {files}")
    return not problems


def replay(
    folder: Path,
    /,
    *,
    sample: int = 20,
    seed: int = 0,
    run_code: bool = False,
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Play a sample of a finished folder's episodes again; exit code 1 if they are others.

    Where processor, jaxlib and engine are those that made it, every bit must be the same; elsewhere
    the mean return must be, within what rounding makes. It says which.

    Args:
        folder: Folder that `assistax-zoo evaluate --out` or `crossplay --out` filled.
        sample: Episodes; what was simulated together is played together, so there may be more.
        seed: Seed of the choice.
        run_code: Run a robot from Python code that the folder names; read it first.
        source: Where policies come from.
        json: Print JSON.

    Example:
        assistax-zoo replay results --sample 20
    """
    with stdout_is_data():
        from evaluation.replay import replay_folder

        registry = load_registry(source.registry)
        report = replay_folder(folder, registry, sample=sample, seed=seed, run_code=run_code)
    if report.exact:
        how, told = "bit by bit", "the same" if report.ok else f"{report.differing} differ"
    else:
        reach = f"{'within' if report.ok else 'beyond'} {report.tolerance:.1f}"
        how, told = "in the mean", f"{report.difference:+.1f} in the mean return, {reach}"
    again = f"{report.episodes} episodes of {folder} played again: {told}"
    answer(json, vars(report), printable(f"compared {how}: {report.why}"), again)
    if not report.ok:
        raise SystemExit(1)
