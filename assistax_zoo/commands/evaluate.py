"""M_test of robot policies against the zoo's partners, and the cross-play of a population."""

import contextlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_zoo.console import print_json, progress, stdout_is_data

if TYPE_CHECKING:
    from rich.table import Table

    from evaluation.evaluator import Progress


def evaluate(
    *,
    task: str,
    policy: tuple[str, ...],
    split: str | None = None,
    partners: tuple[str, ...] = (),
    episodes: int = 8,
    seed: int = 0,
    backend: str = "auto",
    stochastic: bool = False,
    max_envs: int | None = None,
    out: Path | None = None,
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """Compute M_test: the return of robot policies with partners of the zoo that they never met.

    Each partner plays under its own disability setting, and all pairs play the same episodes. With --out, every
    episode is kept there as Parquet, and a run that was stopped goes on where it was.

    Args:
        task: Task, such as scratch.
        policy: Robot: zoo:ID, a .safetensors file, or python:package.module:factory; repeat it for more seeds.
        split: Partners: test (default), train or both sides of the default split, or another split's id (ID:both).
        partners: Glob over partners to use only some, such as 'scratch/ippo-d9-*'; repeat it for more.
        episodes: Episodes with each partner.
        seed: Seed of the episodes.
        backend: native, mjx, mjx-warp, or auto for the fastest here.
        stochastic: Draw actions instead of taking each policy's most likely one.
        max_envs: Most simulations at once; lower it if memory runs out.
        out: Folder for the tables.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo evaluate --task scratch --policy zoo:scratch/ippo-d1-s0-v0/robot --episodes 8 --out results
    """
    with stdout_is_data(), contextlib.ExitStack() as stack:
        folder = out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="assistax-zoo-")))
        from evaluation.studies import Settings, evaluate_policies
        from zoo.registry import load_registry

        settings = Settings(task, episodes, seed, backend, stochastic, max_envs)
        summary = evaluate_policies(
            load_registry(registry),
            policy,
            settings,
            folder,
            split=split,
            partners=partners or None,
            on_progress=_shown(stack, f"evaluate {task}"),
        )
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
    episodes: int = 8,
    seed: int = 0,
    backend: str = "auto",
    stochastic: bool = False,
    max_envs: int | None = None,
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """Play every robot of a population with every human, and draw the clustered matrix.

    A robot with the human it was trained with is self-play, the matrix's diagonal. A run that was stopped goes on.

    Args:
        task: Task, such as scratch.
        out: Folder for the tables and the figure.
        egos: Glob over robots, such as 'scratch/ippo-*/robot'; repeat it for more; all if not given.
        partners: Glob over humans; repeat it for more; all if not given.
        episodes: Episodes of each pair.
        seed: Seed of the episodes, the same for every pair.
        backend: native, mjx, mjx-warp, or auto for the fastest here.
        stochastic: Draw actions instead of taking each policy's most likely one.
        max_envs: Most simulations at once; lower it if memory runs out.
        registry: Registry to read instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo crossplay --task scratch --egos 'scratch/ippo-*/robot' --partners 'scratch/ippo-*/human' --out xp
    """
    with stdout_is_data(), contextlib.ExitStack() as stack:
        from evaluation.studies import Settings, cross_play
        from zoo.registry import load_registry

        settings = Settings(task, episodes, seed, backend, stochastic, max_envs)
        summary = cross_play(
            load_registry(registry),
            egos or f"{task}/*",
            partners or f"{task}/*",
            settings,
            out,
            on_progress=_shown(stack, f"crossplay {task}"),
        )
    if json:
        print_json(summary)
        return
    _print_crossplay(summary)
    print(f"tables and crossplay.png in {out}")


def _shown(stack: contextlib.ExitStack, description: str) -> Callable[["Progress"], None]:
    """Return a callback that shows progress from its first call on, while the stack is open."""
    advance: Callable[[int], None] | None = None
    done = 0

    def show(state: "Progress") -> None:
        nonlocal advance, done
        if advance is None:
            advance = stack.enter_context(progress(f"{description}, environment steps", state.total))
        advance(state.done - done)
        done = state.done

    return show


def _print_evaluation(summary: dict[str, Any]) -> None:
    table = _table(f"{summary['task']}, {len(summary['egos'])} robots, split {summary['split']['id']}")
    for name, key in (("M_test", "m_test"), ("M_train", "m_train"), ("M_train - M_test", "gap")):
        _add(table, name, summary[key])
    for key in ("by_algorithm", "by_disability"):
        for name, figure in summary[key].items():
            _add(table, f"  {name}", figure)
    _print(table)
    worst = summary["worst_partner"]
    print(f"worst partner: {worst['partner']}, mean return {worst['mean']:.1f}")
    _print_origin(summary)


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
    print(f"best robot: {summary['best_ego']['ego']}, mean return {summary['best_ego']['mean']:.1f}")
    _print_origin(summary)


def _print_origin(summary: dict[str, Any]) -> None:
    speed = summary["env_steps_per_second"]
    told = f", {speed:,.0f} environment steps/s" if speed else ", found finished"
    print(
        f"{summary['episodes']} episodes on {summary['backend']}{told}; environment version {summary['env_version']}, "
        f"release {summary['release']}; non-finite episodes: {summary['nonfinite']}"
    )
    for note in summary["notes"]:
        print(f"note: {note}")


def _table(title: str) -> "Table":
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    table.add_column("return of an episode", no_wrap=True)
    for name in ("mean", "IQM", "95% interval of the IQM", "pairs"):
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _add(table: "Table", name: str, figure: dict[str, Any] | None) -> None:
    if figure is None:
        return
    interval = "-" if figure["ci"] is None else "{:.1f} to {:.1f}".format(*figure["ci"])
    table.add_row(name, f"{figure['mean']:.1f}", f"{figure['iqm']:.1f}", interval, str(figure["n"]))


def _print(table: "Table") -> None:
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        console = Console(width=120)
    console.print(table)
