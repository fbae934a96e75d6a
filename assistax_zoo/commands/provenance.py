"""Whether a finished folder can be believed: its hashes, and a sample of it played again."""

from pathlib import Path

from assistax_zoo.commands.options import Source
from assistax_zoo.console import print_json, stdout_is_data


def verify_results(folder: Path, json: bool) -> bool:
    """Hold a finished folder against its manifest, print what was found; return if it is whole."""
    from evaluation import tables
    from evaluation.provenance import verify_folder

    report = verify_folder(folder)
    if json:
        print_json({"ok": report.ok, **tables.to_json(report)})
        return report.ok
    for problem in report.problems:
        print(f"problem: {problem}")
    told = "verified" if report.ok else f"{len(report.problems)} problems in"
    print(f"{told} {report.files} files of {folder}")
    return report.ok


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
        from evaluation import tables
        from evaluation.replay import replay_folder
        from zoo.registry import load_registry

        registry = load_registry(source.registry)
        report = replay_folder(folder, registry, sample=sample, seed=seed, run_code=run_code)
    if json:
        print_json(tables.to_json(report))
    elif report.exact:
        print(f"compared bit by bit: {report.why}")
        told = "the same" if report.ok else f"{report.differing} differ"
        print(f"{report.episodes} episodes of {folder} played again: {told}")
    else:
        print(f"compared in the mean: {report.why}")
        print(
            f"{report.episodes} episodes of {folder} played again: {report.difference:+.1f} in "
            f"the mean return, {'within' if report.ok else 'beyond'} {report.tolerance:.1f}"
        )
    if not report.ok:
        raise SystemExit(1)
