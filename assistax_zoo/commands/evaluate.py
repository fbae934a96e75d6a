"""M_test of robot policies against the zoo's partners, and the cross-play of a population."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_zoo.commands.options import Engine, Playing, Source
from assistax_zoo.console import print_json, stdout_is_data

if TYPE_CHECKING:
    from rich.table import Table


def evaluate(
    *,
    task: str,
    policy: tuple[str, ...],
    split: str | None = None,
    partners: tuple[str, ...] = (),
    playing: Playing = Playing(),
    include_own: bool = False,
    references: bool = True,
    crossplay: Path | None = None,
    fetch: bool = False,
    reuse: bool = False,
    out: Path | None = None,
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Compute M_test: the return of robot policies with partners of the zoo that they never met.

    Each partner plays under its own disability setting, and all pairs play the same episodes. With
    --out, every episode is kept there as Parquet, and a run that was stopped goes on where it was.

    Args:
        task: Task, such as scratch.
        policy: Robot: an id, a .safetensors or .onnx file, python:FILE.py:FACTORY or
            python:package.module:FACTORY; repeat it for more seeds.
        split: Partners: test (default), train or both sides of the default split, or another
            split's id (ID:both).
        partners: Glob over partners, to play only some of those sides, such as 'scratch/ippo-d9-*';
            repeat it for more. Where all that match are of one release, its default split is meant.
        playing: How they play.
        include_own: Count partners that were trained with one of the robots; else they are played
            and kept in the tables, and no figure is about them.
        references: Compare with zero and random actions and with each partner's own robot; kept for
            the next time.
        crossplay: Folder of a finished cross-play, whose best robots may be the partners' best
            responses.
        fetch: Bring partners that are missing here from the remote.
        reuse: Take what --out holds of a robot from Python code though its module does not declare
            what it depends on; else it is played again.
        out: Folder for the tables.
        source: Where policies come from.
        json: Print JSON.

    Example:
        assistax-zoo evaluate --task scratch --policy scratch/ippo-d1-s0-v1/robot --episodes 8
        --out results
    """
    with stdout_is_data():
        from assistax_zoo.studies import evaluate as evaluate_robots

        result = evaluate_robots(
            list(policy),
            task=task,
            split=split,
            partners=partners or None,
            include_own=include_own,
            references=references,
            crossplay=crossplay,
            fetch=fetch,
            reuse=reuse,
            zoo=source.registry,
            lock=source.lock,
            out=out,
            **vars(playing),
        )
        summary = result.to_json()
    if json:
        print_json(summary)
        return
    _print_evaluation(summary)
    if out:
        print(f"tables in {out}: episodes.parquet has every episode")


def crossplay(
    *,
    task: str,
    out: Path,
    egos: tuple[str, ...] = (),
    partners: tuple[str, ...] = (),
    release: str | None = None,
    playing: Playing = Playing(),
    block: str | None = None,
    engine: Engine = Engine(),
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Play every robot of a population with every human, and draw the clustered matrix.

    A robot with the human it was trained with is self-play, the matrix's diagonal. A run that was
    stopped goes on.

    Args:
        task: Task, such as scratch.
        out: Folder for the tables and the figure.
        egos: Glob over robots, such as 'scratch/ippo-*/robot'; repeat it for more; all if not
            given.
        partners: Glob over humans; repeat it for more; all if not given.
        release: Release of both, where a glob names none; default the newest whole one.
        playing: How they play.
        block: Simulate only a share, such as 2/4; with the parts of all, the command without
            --block merges them.
        engine: What runs the blocks.
        source: Where policies come from.
        json: Print JSON.

    Example:
        assistax-zoo crossplay --task scratch --egos 'scratch/ippo-*/robot' --partners
        'scratch/ippo-*/human' --out xp
    """
    cluster = engine.cluster()
    if block and cluster:
        raise ValueError(
            "--block is one share of a run by hand, --engine ray spreads all of them; leave one out"
        )
    with stdout_is_data():
        from assistax_zoo.studies import cross_play, play_block
        from evaluation.tables import to_json

        given: dict[str, Any] = {
            "task": task,
            "release": release,
            "zoo": source.registry,
            "lock": source.lock,
            **vars(playing),
        }
        if block:
            share = _block(block)
            done = play_block(share, out, egos or None, partners or None, **given)
            summary = {"block": block, **to_json(done)}
        else:
            result = cross_play(egos or None, partners or None, out=out, cluster=cluster, **given)
            summary = result.to_json()
    if json:
        print_json(summary)
    elif block:
        _print_block(summary, out)
    else:
        _print_crossplay(summary)
        print(f"tables and crossplay.png in {out}")


def _block(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise ValueError(f"block is {text!r}; expected i/n with i from 1 to n, such as 2/4")
    return int(number), int(count)


def _print_block(summary: dict[str, Any], out: Path) -> None:
    print(
        f"block {summary['block']}: {summary['episodes']} episodes in {summary['chunks']} parts of "
        f"{out}/parts"
    )
    if summary["missing"]:
        print(
            f"{summary['missing']} of {summary['all_chunks']} parts are not here; gather those of "
            "all blocks"
        )
    else:
        print("all parts are here: the same command without --block merges them")


def _print_evaluation(summary: dict[str, Any]) -> None:
    table = _table(
        f"{summary['task']}, {len(summary['egos'])} robots, split {summary['split']['id']}"
    )
    for name, key in (("M_test", "m_test"), ("M_train", "m_train"), ("M_train - M_test", "gap")):
        _add(table, name, summary[key])
    for key in ("by_algorithm", "by_disability"):
        for name, figure in summary[key].items():
            _add(table, f"  {name}", figure)
    _print(table)
    _print_references(summary)
    worst = summary["worst_partner"]
    print(f"worst partner: {worst['partner']}, mean return {worst['mean']:.1f}")
    _print_origin(summary)


def _print_references(summary: dict[str, Any]) -> None:
    if summary["references"] is None:
        return
    table = _table("to compare with: the same partners and episodes")
    for name, figure in summary["references"].items():
        _add(table, name.replace("_", " "), figure)
    _print(table)
    relative = summary["relative"]
    table = _table(
        "relative to zero action (0) and the best response known (1)", "share of that range"
    )
    for name in ("normalised_return", "br_prox"):
        _add(
            table,
            {"br_prox": "BR-Prox"}.get(name, name.replace("_", " ")),
            relative[name],
            digits=2,
        )
    _print(table)
    if relative["coverage"]:
        share, regret = relative["coverage"]["value"], relative["regret"]["mean"]
        print(
            f"regret {regret:.1f}; within {relative['coverage']['epsilon']:.0%} of the best "
            f"response: {share:.0%}"
        )
    if relative["unscorable"]:
        print(
            "without a scale, best response at or below zero action: "
            f"{', '.join(relative['unscorable'])}"
        )


def _print_crossplay(summary: dict[str, Any]) -> None:
    table = _table(f"{summary['task']}, {summary['egos']} robots x {summary['partners']} humans")
    for name, key in (
        ("self-play", "self_play"),
        ("cross-play", "cross_play"),
        ("self-play - cross-play", "gap"),
        ("  within one algorithm", "within_algorithm"),
        ("  across algorithms", "across_algorithms"),
        ("  within one disability setting", "within_disability"),
        ("  across disability settings", "across_disabilities"),
    ):
        _add(table, name, summary[key])
    _print(table)
    print(
        f"best robot: {summary['best_ego']['ego']}, mean return {summary['best_ego']['mean']:.1f}"
    )
    _print_origin(summary)


def _print_origin(summary: dict[str, Any]) -> None:
    speed = summary["env_steps_per_second"]
    told = f", {speed:,.0f} environment steps/s" if speed else ", found finished"
    print(
        f"{summary['episodes']} episodes on {summary['backend']}{told}; environment version "
        f"{summary['env_version']}, release {summary['release']}; non-finite episodes: "
        f"{summary['nonfinite']}"
    )
    for note in summary["notes"]:
        print(f"note: {note}")


def _table(title: str, what: str = "return of an episode") -> "Table":
    """Return an empty table of figures that fits 80 columns."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column(what, overflow="fold")
    for name in ("mean", "IQM", "its 95% interval", "pairs"):
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _add(table: "Table", name: str, figure: dict[str, Any] | None, digits: int = 1) -> None:
    if figure is None:
        return
    mean, iqm = (f"{figure[key]:.{digits}f}" for key in ("mean", "iqm"))
    ends = figure["iqm_ci"]
    interval = "-" if ends is None else " to ".join(f"{end:.{digits}f}" for end in ends)
    table.add_row(name, mean, iqm, interval, str(figure["n"]))


def _print(table: "Table") -> None:
    from rich.console import Console

    console = Console()
    (console if console.is_terminal else Console(width=80)).print(table)
