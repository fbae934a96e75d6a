"""The gates of a task, from named teams."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cyclopts import Parameter

from assistax_base.errors import counted
from assistax_zoo.shell.console import new_table, print_json, print_table, stdout_is_data


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Others:
    """Further policies, for the gates that the teams alone cannot measure.

    Attributes:
        passive_robot: Robot trained with an idle human: a folder, or any form.
        response: Robot trained with the frozen human of a team; one for each, in order.
        told: Teams whose robot is told the human's preference.
        blind: Teams whose human is not told its own.
        recurrent: Teams whose robot has a memory.
        ego: Robots trained with frozen humans of some teams; they play with the others'.
        ego_told: The same, told the preference.
        ego_recurrent: The same, with a memory.
    """

    passive_robot: tuple[str, ...] = ()
    response: tuple[str, ...] = ()
    told: tuple[str, ...] = ()
    blind: tuple[str, ...] = ()
    recurrent: tuple[str, ...] = ()
    ego: tuple[str, ...] = ()
    ego_told: tuple[str, ...] = ()
    ego_recurrent: tuple[str, ...] = ()


def audit(
    task: str,
    /,
    *,
    team: tuple[str, ...],
    others: Others = Others(),
    episodes: int = 18,
    seed: int = 0,
    backend: str = "auto",
    env_version: int | None = None,
    out: Path | None = None,
    registry: str | None = None,
    json: bool = False,
) -> None:
    """Measure whether a task needs the partner, and whether it is done gently.

    Each gate is a figure of trained teams with its 95% interval and its bar. Gates
    whose option is missing are listed as not measured.

    Args:
        task: Task, such as gentle_scratch.
        team: Teams: a folder that `train` filled, or a glob over the zoo's; repeat it for more.
        others: Further policies, for the other gates.
        episodes: Episodes of each pair; each preference twice if not given.
        seed: Seed of the episodes.
        backend: fused, native, mjx, mjx-warp, or auto for the fastest here.
        env_version: Version of the environment; that of published teams, else the newest, if not
            given.
        out: Folder for the episodes; a stopped audit continues.
        registry: Registry to read instead of the installed one: a file, a folder or an address.
        json: Print JSON.

    Example:
        assistax-zoo audit gentle_lift --team runs/lift --passive-robot runs/lift-passive
    """
    with stdout_is_data():
        from assistax_workshop.auditing import audit as audit_teams
        from evaluation.record.tables import to_json

        result = to_json(
            audit_teams(
                task,
                team,
                **vars(others),
                episodes=episodes,
                seed=seed,
                backend=backend,
                env_version=env_version,
                zoo=registry,
                out=out,
            )
        )
    (print_json if json else _print)(result)


def _print(result: Mapping[str, Any]) -> None:
    """Print an audit's gates as a table, then the figures behind them."""
    title = (
        f"{result['task']}, {counted(len(result['teams']), 'team')}, "
        f"{counted(result['episodes'], 'episode')} a pair"
    )
    print_gates(title, result["gates"])
    for name, figures in result["figures"].items():
        print(f"{name}: {', '.join(f'{what} {value:.3g}' for what, value in figures.items())}")


def print_gates(title: str, gates: Sequence[Mapping[str, Any]], told: bool = False) -> None:
    """Print gates as a table, with a column of details if `told`."""
    table = new_table(title)
    for name in ("gate", "bar", "found", "95%", "holds", *(("what",) if told else ())):
        table.add_column(name, overflow="fold")
    for gate in gates:
        ends = " to ".join(f"{end:.2f}" for end in gate["ci"] or ())
        value = gate["told"] if gate["value"] is None else f"{gate['value']:.3f}"
        held = {True: "yes", False: "NO", None: "-"}[gate["holds"]]
        more = (gate["told"] if gate["value"] is not None else "",) if told else ()
        table.add_row(gate["gate"], gate["bar"], value, ends or "-", held, *more)
    print_table(table)
