"""Training and publishing of a plan's missing teams, beside other processes of the same plan."""

import contextlib
import dataclasses
import sys
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

from filelock import AcquireReturnProxy, Timeout

from assistax_base.errors import counted
from assistax_base.files import exclusive
from assistax_workshop.plans.learning_curves import write_curves
from assistax_workshop.plans.plan import Group, Plan, PlannedRun, planned_runs
from assistax_workshop.plans.status import Status, survey, team_id, write_progress
from assistax_workshop.press.publish import publish
from assistax_workshop.press.release import complete_release
from assistax_workshop.press.republish import read_published
from assistax_workshop.press.trained_runs import read_run
from population.runs.folder import RunFolder
from population.runs.trained import TrainedTeam
from zoo.registry import Registry, load_registry
from zoo.saving import writable_registry

# Function from a run to a context, which yields the receiver of the training's reports.
Shown = Callable[[Any], contextlib.AbstractContextManager[Callable[[Any], None]]]


@dataclasses.dataclass
class PlanTraining:
    """Work of one process on a plan; a failure is noted in `errors`, and the rest goes on."""

    plan: Plan
    groups: list[Group]
    path: Path
    out: Path
    registry: Path
    backend: str
    shown: Shown  # shows the reports of a training
    errors: dict[str, str] = dataclasses.field(default_factory=dict)  # by run, or adopting group

    def do(self, *, train: bool, publish: bool, curves: Path | None) -> None:
        """Run the enabled stages for teams that the release lacks.

        Raises:
            PublishError: The registry to publish to is official.
        """
        if publish:
            writable_registry(self.registry)  # before hours of training
            self.publish_ready()
        if train:
            self.train_missing(publish)
        if publish:
            self.complete()
        if curves:
            self.write_curves(curves)
        self.record()

    def survey(self) -> list[Status]:
        """Return the present status of every chosen group, by registry and folders."""
        return survey(self.groups, self.plan.release, self.out, self.load())

    def load(self) -> Registry | None:
        return load_registry(self.registry) if self.registry.is_file() else None

    def record(self, trying: str | None = None) -> None:
        """Write the progress file; an error is noted, and training goes on."""
        errors = self.errors | ({trying: ""} if trying else {})
        with self._noting(path := self.path.with_suffix(".progress.json")):
            write_progress(path, self.plan, self.survey(), errors)

    def publish_ready(self) -> None:
        """Adopt and publish all finished teams in one publication.

        This makes one shard and one split instead of many.
        """
        batches: dict[str, list[TrainedTeam]] = {}
        for status in self.survey():
            if status.adoptable:
                with self._noting(f"{status.group.name} from {status.group.adopt}"):
                    batches[f"{status.group.name} from {status.group.adopt}"] = self._adopted(
                        status
                    )
            for planned in status.planned:
                if planned.state == "finished":
                    with self._noting(planned.name):
                        batches[planned.name] = _waiting_teams(status, planned)
        try:
            self._publish([team for teams in batches.values() for team in teams])
        except Exception:  # a refused batch must not block the others
            for name, teams in batches.items():
                with self._noting(name):
                    self._publish(teams)
        self.record()

    def train_missing(self, publish: bool) -> None:
        """Train the runs that no other process holds, one after the other."""
        tried: set[str] = set()
        while taken := self._take(tried):
            status, planned, hold = taken
            tried.add(planned.name)
            with hold, self._noting(planned.name):
                self._train(status, planned)
                if publish:
                    self._publish(
                        _waiting_teams(status, dataclasses.replace(planned, state="finished"))
                    )
            self.record()

    def complete(self) -> None:
        """Give the release its default splits once every team of the plan is in it."""
        loaded = self.load()
        teams = {
            str(team_id(group, (m.disability, m.seed), self.plan.release))
            for group in self.plan.groups
            for m in group.members
        }
        if loaded and teams <= loaded.data.teams.keys():
            with self._noting(f"release {self.plan.release}"):
                complete_release(self.registry, self.plan.release, self.plan.default)

    def write_curves(self, folder: Path) -> None:
        """Write the learning curves of the finished runs that have their metrics."""
        for group in self.groups:
            finished = [
                planned for planned in planned_runs(group, self.out) if planned.state == "finished"
            ]
            runs = [
                RunFolder(planned.folder)
                for planned in finished
                if (planned.folder / "metrics.parquet").is_file()
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

    def _take(self, tried: set[str]) -> tuple[Status, PlannedRun, AcquireReturnProxy] | None:
        """Return the first run to be trained that no other process holds, with the lock on it."""
        for name in [
            planned.name
            for status in self.survey()
            for planned in status.planned
            if planned.state != "finished"
        ]:
            if name in tried or not (hold := _hold(self.out, name)):
                continue
            # Surveyed again under the lock, since another process may have finished the run.
            for status in self.survey():
                for planned in status.planned:
                    if planned.name == name and planned.state != "finished":
                        return status, planned, hold
            hold.lock.release()
        return None

    def _train(self, status: Status, planned: PlannedRun) -> None:
        """Train one run, with a line on standard error."""
        from population.runs.logged_run import run_training

        teams = (
            f"{counted(len(planned.members), 'team')}, {status.group.task} {status.group.algorithm}"
        )
        print(
            f"{planned.name}: {teams}, {planned.config().steps} steps each",
            file=sys.stderr,
            flush=True,
        )
        if planned.state == "begun" and (differences := planned.differences()):
            print(
                f"{planned.name} goes on as it was begun, not as the plan says: {differences}",
                file=sys.stderr,
                flush=True,
            )
        self.record(trying=planned.name)
        config = planned.config()
        with self.shown(planned) as progress:
            run_training(config, self.backend, planned.folder, progress=progress)

    def _adopted(self, status: Status) -> list[TrainedTeam]:
        """Return a group's adoptable teams, ready to be published."""
        registry, release = self.load(), status.group.adopt
        assert registry is not None and release is not None
        return read_published(
            registry, [team_id(status.group, key, release) for key in sorted(status.adoptable)]
        )

    def _publish(self, teams: Sequence[TrainedTeam]) -> None:
        """Publish teams in the plan's release, if there are any."""
        if teams:
            publish(
                teams,
                self.registry,
                self.plan.release,
                description=self.plan.description,
                complete=False,
            )
            print(
                f"published {counted(len(teams), 'team')} in release {self.plan.release}",
                file=sys.stderr,
                flush=True,
            )

    @contextlib.contextmanager
    def _noting(self, what: str | Path) -> Generator[None]:
        """Note an error under a name and suppress it.

        Examples are a diverged run, a full disk, or a device out of memory.
        """
        name = str(what)
        try:
            self.errors.pop(name, None)
            yield
        except Exception as error:
            self.errors[name] = str(error).partition("\n")[0] or type(error).__name__
            print(f"{name} failed: {self.errors[name]}", file=sys.stderr, flush=True)


def _hold(out: Path, name: str) -> AcquireReturnProxy | None:
    """Return the acquired lock of a run, or None if another process holds it.

    The lock of a killed process is free.
    """
    try:
        return exclusive(out / name).acquire(blocking=False)
    except Timeout:
        return None


def _waiting_teams(status: Status, planned: PlannedRun) -> list[TrainedTeam]:
    """Return the teams of a finished run that the group wants and the release lacks."""
    waiting = status.waiting(planned)
    return [team for team in read_run(planned.folder) if (team.disability, team.seed) in waiting]
