"""The command that trains and publishes the teams of a plan."""

import contextlib
import dataclasses
import json as jsonlib
import sys
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_zoo.commands.train import shown_training
from assistax_zoo.commands.zoo import print_table
from assistax_zoo.console import print_json
from assistax_zoo.plan_status import Status, survey, team_id, write_progress

if TYPE_CHECKING:
    from population.plan import Block, Group, Plan
    from zoo.registry import Registry
    from zoo.runs import TrainedTeam


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
    """Train and publish what is missing of a plan, such as the population of a release.

    The same command goes on wherever it was interrupted, and does nothing once all teams are
    published. Several may work on one plan at once, each on a device of its own: a run is trained
    by the first that takes it. A run that fails does not stop the others. How far the plan is, and
    its cost, stand in PLAN.progress.json.

    Args:
        plan: JSON file of the plan, such as zoo/plans/v1.json; docs/population.md describes it.
        out: Folder of the runs, one folder for each.
        registry: Registry to publish to; default the installed one.
        groups: Only these groups: comma-separated globs over their names, such as 'scratch-*'.
        backend: Physics: native, mjx, mjx-warp, or auto for the fastest one here.
        dry_run: Print what is there, what is missing and what it will cost, and do nothing.
        train: Train; --no-train adopts and publishes only, with finished runs that need no
            checkpoints any more.
        publish: Publish; --no-publish trains only, and leaves out what the registry has.
        curves: Write the finished runs' learning curves to this folder, a small Parquet file for
            each group.
        json: Print the groups as JSON at the end.
        json_lines: Print a JSON object for each report of a training on standard output.

    Example:
        assistax-zoo train population --plan zoo/plans/v1.json --out runs/v1 --dry-run
    """
    from population.plan import read_plan
    from zoo.locations import registry_path

    content = read_plan(plan)
    work = _Work(
        content, content.select(groups), plan, out, registry_path(registry), backend, json_lines
    )
    if not dry_run:
        if publish:
            work.publish_ready()
        if train:
            work.train_missing(publish)
        if publish:
            work.complete()
        if curves:
            work.write_curves(curves)
        work.record()
    _report(work.survey(), json, json_lines)
    if work.errors:
        failed = "; ".join(f"{name}: {message}" for name, message in work.errors.items())
        raise ValueError(f"{len(work.errors)} failed, and the same command tries again: {failed}")


@dataclasses.dataclass
class _Work:
    """What one process does with a plan."""

    plan: "Plan"
    groups: "list[Group]"
    path: Path
    out: Path
    registry: Path
    backend: str
    json_lines: bool
    errors: dict[str, str] = dataclasses.field(
        default_factory=dict
    )  # messages by run, or by group for adoption

    def survey(self) -> list[Status]:
        """Return how far every chosen group is, by the registry and the folders of this moment."""
        return survey(self.groups, self.plan.release, self.out, self.load())

    def load(self) -> "Registry | None":
        from zoo.registry import load_registry

        return load_registry(self.registry) if self.registry.is_file() else None

    def record(self, trying: str | None = None) -> None:
        """Write the progress file; training goes on if it cannot be written."""
        errors = self.errors | ({trying: ""} if trying else {})
        with self._noting(path := self.path.with_suffix(".progress.json")):
            write_progress(path, self.plan, self.survey(), errors)

    def publish_ready(self) -> None:
        """Adopt and publish all that is there, in one publication: one shard and one split instead of many."""
        batches: dict[str, list[TrainedTeam]] = {}
        for status in self.survey():
            if status.adoptable:
                with self._noting(f"{status.group.name} from {status.group.adopt}"):
                    batches[f"{status.group.name} from {status.group.adopt}"] = self._adopted(
                        status
                    )
            for block in status.blocks:
                if block.state == "finished":
                    with self._noting(block.name):
                        batches[block.name] = _waiting_teams(status, block)
        try:
            self._publish([team for teams in batches.values() for team in teams])
        except Exception:  # one that is refused must not keep the others out
            for name, teams in batches.items():
                with self._noting(name):
                    self._publish(teams)
        self.record()

    def train_missing(self, publish: bool) -> None:
        """Train run after run that no other process holds, until none is left."""
        tried: set[str] = set()
        while taken := self._take(tried):
            status, block, hold = taken
            tried.add(block.name)
            with hold, self._noting(block.name):
                self._train(status, block)
                if publish:
                    self._publish(
                        _waiting_teams(status, dataclasses.replace(block, state="finished"))
                    )
            self.record()

    def complete(self) -> None:
        """Make the release the default one, with its default splits, once every team of the plan is in it."""
        from zoo.release import complete_release

        loaded = self.load()
        wanted = {
            str(team_id(group, (m.disability, m.seed), self.plan.release))
            for group in self.plan.groups
            for m in group.members
        }
        if loaded and wanted <= loaded.data.teams.keys():
            with self._noting(f"release {self.plan.release}"):
                complete_release(self.registry, self.plan.release)

    def write_curves(self, folder: Path) -> None:
        """Write the learning curves of the finished runs that have their metrics."""
        from population.learning_curves import write_curves
        from population.plan import find_blocks
        from population.run_folder import RunFolder

        for group in self.groups:
            finished = [
                block for block in find_blocks(group, self.out) if block.state == "finished"
            ]
            runs = [
                RunFolder(block.folder)
                for block in finished
                if (block.folder / "metrics.parquet").is_file()
            ]
            if runs:
                with self._noting(f"curves of {group.name}"):
                    configs = [run.config() for run in runs]
                    tables = [
                        run.read_metrics(config.updates)
                        for run, config in zip(runs, configs, strict=True)
                    ]
                    write_curves(
                        folder / f"{group.name}.parquet", list(zip(tables, configs, strict=True))
                    )

    def _take(self, tried: set[str]) -> "tuple[Status, Block, contextlib.ExitStack] | None":
        """Return the first run that is to be trained and that no other process holds, with the lock on it."""
        for name in [
            block.name
            for status in self.survey()
            for block in status.blocks
            if block.state != "finished"
        ]:
            if name in tried or not (hold := _hold(self.out, name)):
                continue
            for status in (
                self.survey()
            ):  # again, under the lock: another process may have finished it meanwhile
                for block in status.blocks:
                    if block.name == name and block.state != "finished":
                        return status, block, hold
            hold.close()
        return None

    def _train(self, status: Status, block: "Block") -> None:
        from population.team_training import run_training

        teams = f"{len(block.members)} teams, {status.group.task} {status.group.algorithm}"
        print(
            f"{block.name}: {teams}, {block.config().steps} steps each", file=sys.stderr, flush=True
        )
        if block.state == "begun" and (differences := block.differences()):
            print(
                f"{block.name} goes on as it was begun: {'; '.join(differences)}",
                file=sys.stderr,
                flush=True,
            )
        if self.json_lines:
            print(
                jsonlib.dumps(
                    {"run": block.name, "group": status.group.name, "teams": len(block.members)}
                ),
                flush=True,
            )
        self.record(trying=block.name)
        config = block.config()
        with shown_training(f"{config.task} {config.algorithm}", self.json_lines) as progress:
            run_training(config, self.backend, block.folder, progress=progress)

    def _adopted(self, status: Status) -> "list[TrainedTeam]":
        from zoo.republish import read_published

        registry, release = self.load(), status.group.adopt
        assert registry is not None and release is not None
        return read_published(
            registry, [team_id(status.group, key, release) for key in sorted(status.adoptable)]
        )

    def _publish(self, teams: "Sequence[TrainedTeam]") -> None:
        from zoo.publish import publish

        if teams:
            publish(
                teams,
                self.registry,
                self.plan.release,
                description=self.plan.description,
                complete=False,
            )
            print(
                f"published {len(teams)} teams in release {self.plan.release}",
                file=sys.stderr,
                flush=True,
            )

    @contextlib.contextmanager
    def _noting(self, what: str | Path) -> Generator[None]:
        """Note an error under a name and go on: a diverged run, a full disk, a device out of memory."""
        name = str(what)
        try:
            self.errors.pop(name, None)
            yield
        except Exception as error:
            self.errors[name] = str(error).partition("\n")[0] or type(error).__name__
            print(f"{name} failed: {self.errors[name]}", file=sys.stderr, flush=True)


def _hold(out: Path, name: str) -> contextlib.ExitStack | None:
    """Take the lock of a run, or return None if another process has it; a killed process lets go."""
    from evaluation.locks import locked

    stack = contextlib.ExitStack()
    try:
        stack.enter_context(locked(out, f".{name}.lock"))
    except ValueError:
        return None
    return stack


def _waiting_teams(status: Status, block: "Block") -> "list[TrainedTeam]":
    """Return the teams of a finished run that the group wants and the release does not have."""
    from zoo.runs import read_run

    waiting = status.waiting(block)
    return [team for team in read_run(block.folder) if (team.disability, team.seed) in waiting]


def _report(statuses: Sequence[Status], json: bool, json_lines: bool) -> None:
    rows = [status.to_json() for status in statuses]
    if json_lines:
        print(jsonlib.dumps({"groups": rows}), flush=True)
        return
    if json:
        print_json({"groups": rows})
        return
    columns = (
        "group",
        "teams",
        "published",
        "adoptable",
        "trained",
        "missing",
        "steps to train",
        "device minutes",
    )
    names = ("group", "teams", "published", "adoptable", "trained", "missing", "steps_to_train")
    lines = [(*(str(row[name]) for name in names), _minutes(row)) for row in rows]
    done, teams = sum(row["published"] for row in rows), sum(row["teams"] for row in rows)
    print_table(columns, lines, f"{done} of {teams} teams are published")


def _minutes(row: dict[str, Any]) -> str:
    """Return what a group cost so far and what is to come, with the origin of the estimate."""
    if not row["steps_to_train"]:
        return f"{row['device_minutes']}"
    to_go = "unknown: nothing like it was measured"
    if row["device_minutes_to_go"] is not None:
        to_go = f"about {row['device_minutes_to_go']}, at the speed of {row['estimated_from']}"
    return f"{row['device_minutes']} + {to_go}"
