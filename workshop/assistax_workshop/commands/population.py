"""Command that trains and publishes the teams of a plan."""

import contextlib
import json as jsonlib
from collections.abc import Callable, Generator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from assistax_workshop.plans.plan import PlannedRun, read_plan
from assistax_workshop.plans.status import Status
from assistax_workshop.plans.training import PlanTraining
from assistax_zoo.commands.partners.listing import table_lines
from assistax_zoo.commands.training.train import shown_training
from assistax_zoo.shell.console import answer
from zoo.locations import own_registry
from zoo.saving import writable_registry


def population(
    *,
    plan: Path,
    out: Path,
    registry: Path | None = None,
    groups: str = "*",
    backend: str = "auto",
    dry_run: bool = False,
    train: bool = True,
    publish: bool = True,
    curves: Path | None = None,
    json: bool = False,
    json_lines: bool = False,
) -> None:
    """Train and publish the missing teams of a plan, such as the population of a release.

    The same command continues after an interruption, and does nothing once all teams are published.
    Several processes may work on one plan at once, each on its own device: the first that takes a
    run trains it. A run that fails does not stop the others. PLAN.progress.json has the progress of
    the plan and its cost.

    Args:
        plan: JSON file of the plan, such as zoo/plans/paper.json; docs/population.md describes it.
        out: Folder of the runs, one folder for each.
        registry: Registry to publish to; default your own zoo, as for `publish`.
        groups: Only these groups: comma-separated globs over their names, such as `'scratch-*'`.
        backend: Physics: fused, native, mjx, mjx-warp, or auto for the fastest one.
        dry_run: Print what is there, what is missing and what it will cost, and do nothing.
        train: Train; --no-train adopts and publishes only, with finished runs that need no
            checkpoints any more.
        publish: Publish; --no-publish trains only, and leaves out what the registry has.
        curves: Write the finished runs' learning curves to this folder, a small Parquet file for
            each group.
        json: Print the groups as JSON at the end.
        json_lines: Print a JSON object for each report of a training on standard output.

    Example:
        assistax-zoo train population --plan zoo/plans/paper.json --out runs/v1 --dry-run
    """
    content = read_plan(plan)
    work = PlanTraining(
        plan=content,
        groups=content.select(groups),
        path=plan,
        out=out,
        registry=registry or writable_registry() or own_registry(),
        backend=backend,
        shown=partial(_shown, json_lines),
    )
    if not dry_run:
        work.do(train=train, publish=publish, curves=curves)
    _report(work.survey(), json, json_lines)
    if work.errors:
        failed = "; ".join(f"{name}: {message}" for name, message in work.errors.items())
        raise ValueError(f"{len(work.errors)} failed, and the same command tries again: {failed}")


@contextlib.contextmanager
def _shown(json_lines: bool, planned: PlannedRun) -> Generator[Callable[[Any], None]]:
    """Yield a function that shows a run's training; JSON lines begin with the run's name."""
    if json_lines:
        start = {"run": planned.name, "group": planned.group.name, "teams": len(planned.members)}
        print(jsonlib.dumps(start), flush=True)
    with shown_training(f"{planned.group.task} {planned.group.algorithm}", json_lines) as progress:
        yield progress


def _report(statuses: Sequence[Status], json: bool, json_lines: bool) -> None:
    """Print the groups' statuses: a table, JSON, or a JSON line."""
    rows = [status.to_json() for status in statuses]
    names = ("group", "teams", "published", "adoptable", "trained", "missing", "steps_to_train")
    columns = (*(name.replace("_", " ") for name in names), "device minutes")
    lines = [(*(str(row[name]) for name in names), _minutes(row)) for row in rows]
    done, teams = sum(row["published"] for row in rows), sum(row["teams"] for row in rows)
    table = table_lines(columns, lines, f"published: {done} of {teams}")
    line = [jsonlib.dumps({"groups": rows})]
    answer(json and not json_lines, {"groups": rows}, *(line if json_lines else table))


def _minutes(row: dict[str, Any]) -> str:
    """Return a group's cost so far, the cost to come, and the origin of the estimate."""
    if not row["steps_to_train"]:
        return f"{row['device_minutes']}"
    to_go = "unknown: nothing like it was measured"
    if row["device_minutes_to_go"] is not None:
        to_go = f"about {row['device_minutes_to_go']}, at the speed of {row['estimated_from']}"
    return f"{row['device_minutes']} + {to_go}"
