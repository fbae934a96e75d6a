"""The gates of a task, from named teams."""

from pathlib import Path

from assistax_zoo.console import new_table, print_json, print_table, stdout_is_data


def audit(
    task: str,
    /,
    *,
    team: tuple[str, ...],
    passive_robot: tuple[str, ...] = (),
    response: tuple[str, ...] = (),
    told: tuple[str, ...] = (),
    blind: tuple[str, ...] = (),
    recurrent: tuple[str, ...] = (),
    episodes: int = 18,
    seed: int = 0,
    backend: str = "auto",
    out: Path | None = None,
    registry: str | None = None,
    json: bool = False,
) -> None:
    """Ask whether a task can be done without the partner, and whether it is done gently.

    Each gate is a figure of trained teams with its 95% interval and its bar. Those for which nobody
    was named are listed as not measured.

    Args:
        task: Task, such as gentle_scratch.
        team: Teams: a folder that `train` filled, or a glob over the zoo's; repeat it for more.
        passive_robot: Robot that was trained with a human that does nothing: a folder of `train`,
            or any form of a robot.
        response: Robot that was trained with the frozen human of a team; one for each, in order.
        told: Teams whose robot is told the human's preference.
        blind: Teams whose human is not told its own.
        recurrent: Teams whose robot remembers.
        episodes: Episodes of each pair; each preference twice if not given.
        seed: Seed of the episodes.
        backend: fused, native, mjx, mjx-warp, or auto for the fastest here.
        out: Folder for the episodes; an audit that was stopped goes on.
        registry: Registry to read instead of the installed one: a file, a folder or an address.
        json: Print JSON.

    Example:
        assistax-zoo audit gentle_lift --team runs/lift --passive-robot runs/lift-passive
    """
    with stdout_is_data():
        from assistax_zoo.auditing import audit as audit_teams
        from evaluation.tables import to_json

        found = to_json(
            audit_teams(
                task,
                team,
                passive_robot=passive_robot,
                response=response,
                told=told,
                blind=blind,
                recurrent=recurrent,
                episodes=episodes,
                seed=seed,
                backend=backend,
                zoo=registry,
                out=out,
            )
        )
    if json:
        print_json(found)
        return
    table = new_table(f"{task}, {len(found['teams'])} teams, {found['episodes']} episodes a pair")
    for name in ("gate", "bar", "found", "95%", "holds"):
        table.add_column(name, overflow="fold")
    for gate in found["gates"]:
        ends = " to ".join(f"{end:.2f}" for end in gate["ci"] or ())
        value = gate["told"] if gate["value"] is None else f"{gate['value']:.3f}"
        held = {True: "yes", False: "NO", None: "-"}[gate["holds"]]
        table.add_row(gate["gate"], gate["bar"], value, ends or "-", held)
    print_table(table)
    for name, figures in found["figures"].items():
        print(f"{name}: {', '.join(f'{what} {value:.3g}' for what, value in figures.items())}")
