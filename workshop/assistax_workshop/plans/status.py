"""Status of a plan: teams in its registry and run folders, their cost, and the progress file."""

import dataclasses
import datetime
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from assistax_base.files import atomic_write, exclusive
from assistax_workshop.plans.plan import Group, Key, Plan, PlannedRun, planned_runs
from assistax_workshop.press.republish import republishable
from population.hyperparameters import PRESETS
from population.runs.folder import RunFolder
from zoo.ids import TeamId
from zoo.registry import Registry, load_registry


@dataclasses.dataclass(frozen=True)
class Status:
    """Status of one group of a plan."""

    group: Group
    published: frozenset[Key]  # teams that the release has
    adoptable: frozenset[Key]  # teams that another release has and this one lacks
    planned: tuple[PlannedRun, ...]  # runs of the other teams, finished or not
    # Entries of published and finished runs in progress.json, by name.
    runs: Mapping[str, Mapping[str, Any]]
    # Measured training steps per second and device, by task and algorithm.
    speeds: Mapping[tuple[str, str], int] = dataclasses.field(default_factory=dict)

    @property
    def done(self) -> frozenset[Key]:
        """Teams that need no run."""
        return self.published | self.adoptable

    @property
    def trained(self) -> int:
        """Number of teams that are trained, but not published."""
        return sum(
            len(self.waiting(planned)) for planned in self.planned if planned.state == "finished"
        )

    @property
    def missing(self) -> int:
        """Number of teams that are not trained."""
        return sum(
            len(self.waiting(planned)) for planned in self.planned if planned.state != "finished"
        )

    def waiting(self, planned: PlannedRun) -> set[Key]:
        """Return the teams of a run that the group wants and the release does not have."""
        return {
            (member.disability, member.seed) for member in self.group.members
        } & planned.keys - self.done

    @property
    def estimated_from(self) -> str | None:
        """Algorithm whose speed on the task fits best: the same, else one of the same trainer."""
        own = self.group.algorithm
        near = [name for name in PRESETS if PRESETS[name][0] == PRESETS[own][0]]
        measured = [name for name in (own, *near) if (self.group.task, name) in self.speeds]
        return measured[0] if measured and steps_to_train(self.planned) else None

    @property
    def estimate(self) -> float | None:
        """Device minutes of the missing teams; None without a measured speed."""
        if not (steps := steps_to_train(self.planned)):
            return 0.0
        source = self.estimated_from
        return round(steps / self.speeds[self.group.task, source] / 60, 1) if source else None

    def to_json(self) -> dict[str, Any]:
        """Return the row of a table."""
        return {
            "group": self.group.name,
            "teams": len(self.group.members),
            "published": len(self.published),
            "adoptable": len(self.adoptable),
            "trained": self.trained,
            "missing": self.missing,
            "steps_to_train": steps_to_train(self.planned),
            "device_minutes": round(_device_seconds(self.runs.values()) / 60, 1),
            "device_minutes_to_go": self.estimate,
            "estimated_from": self.estimated_from,
        }


def survey(
    groups: Sequence[Group], release: str, out: Path, registry: Registry | None
) -> list[Status]:
    """Return the status of each group.

    Raises:
        ValueError: A group adopts a release that the registry does not have.
    """
    statuses = [_status(group, release, out, registry) for group in groups]
    # Tasks and algorithms that were not trained here have the speed of published teams.
    speeds = {**_speeds(load_registry(), ()), **_speeds(registry, statuses)}
    return [dataclasses.replace(status, speeds=speeds) for status in statuses]


def team_id(group: Group, key: Key, release: str) -> TeamId:
    """Return a member's id in a release."""
    return TeamId(group.task, group.algorithm, key[0], key[1], release)


def steps_to_train(runs_of_plan: Sequence[PlannedRun]) -> int:
    """Return the environment steps of all members of unfinished runs.

    A begun run counts wholly.
    """
    configs = [planned.config() for planned in runs_of_plan if planned.state != "finished"]
    return sum(
        config.updates * config.trainer.batch_steps * len(config.members) for config in configs
    )


def _status(group: Group, release: str, out: Path, registry: Registry | None) -> Status:
    """Return the status of one group, without speeds."""
    teams = {(member.disability, member.seed) for member in group.members}
    published = frozenset(
        key
        for key in teams
        if registry and str(team_id(group, key, release)) in registry.data.teams
    )
    adopted = (
        _adoptable(group, teams - published, release, registry) if group.adopt else frozenset()
    )
    runs_of_plan = tuple(planned_runs(group, out, published | adopted))
    runs = _published_runs(group, published, release, registry) | _finished_runs(runs_of_plan)
    return Status(group, published, adopted, runs_of_plan, runs)


def _adoptable(
    group: Group, keys: set[Key], release: str, registry: Registry | None
) -> frozenset[Key]:
    """Return the teams among `keys` that the group's earlier release can give."""
    assert group.adopt is not None
    if registry is None or group.adopt not in registry.data.releases:
        where = f"the registry {registry.path} has none" if registry else "there is no registry"
        raise ValueError(
            f"group {group.name} adopts teams of release {group.adopt}, but {where}; "
            "name the registry that has it"
        )
    ids = [team_id(group, key, release) for key in sorted(keys)]
    return frozenset(
        (team.disability, team.seed)
        for team in republishable(registry, ids, group.adopt, group.steps)
    )


def _published_runs(
    group: Group, published: frozenset[Key], release: str, registry: Registry | None
) -> dict[str, dict[str, Any]]:
    """Return the entries of the runs of published teams, by name.

    An adopted run is named with its release, and counts all teams that it trained.
    """
    runs: dict[str, dict[str, Any]] = {}
    for key in sorted(published):
        assert registry is not None
        run = registry.team(str(team_id(group, key, release))).run
        origin = _origin(group, key, release, registry)
        # Runs of equal name, settings and seconds are one entry of the registry, but not one here.
        name = f"{origin}/{run}" if origin else run
        state = {"state": "adopted", "from": origin} if origin else {"state": "published"}
        count = runs.get(name, {"teams": 0})["teams"] + 1
        together = _teams_of(registry, run) if origin else count
        runs[name] = state | _of_registry(registry, run, count, together)
    return runs


def _origin(group: Group, key: Key, release: str, registry: Registry) -> str | None:
    """Return the release that a team was adopted from: its team there has equal parameters.

    None if the team was not adopted.
    """
    earlier = (
        registry.data.teams.get(str(team_id(group, key, group.adopt))) if group.adopt else None
    )
    own = registry.team(str(team_id(group, key, release)))
    if earlier is None:
        return None
    same = all(
        own.policies[role].sha256 == place.sha256 for role, place in earlier.policies.items()
    )
    return group.adopt if same else None


def _finished_runs(runs_of_plan: Sequence[PlannedRun]) -> dict[str, dict[str, Any]]:
    """Return the entries of finished runs, by name."""
    runs = {}
    for planned in runs_of_plan:
        if planned.state == "finished":
            teams = RunFolder(planned.folder).team_items()
            training = teams[0]["training"]
            cost = _cost(training, training.get("devices", 1), len(teams), len(teams))
            runs[planned.name] = {"state": "trained"} | cost
    return runs


def _of_registry(registry: Registry, run: str, teams: int, together: int) -> dict[str, Any]:
    """Return the cost entry of a published run, which trained `together` teams."""
    training = registry.data.runs[run]
    devices = training.notes.get("devices")
    count = devices if isinstance(devices, int) else 1
    return _cost(training.model_dump(), count, teams, together)


def _cost(training: Mapping[str, Any], devices: int, teams: int, together: int) -> dict[str, Any]:
    """Return the cost entry of a run.

    Its speed is that of all the teams that it trained together, on one device.
    """
    steps, seconds = training["steps"], training.get("seconds")
    return {
        "teams": teams,
        "steps": steps,
        "device": training.get("device"),
        "devices": devices,
        "seconds": seconds,
        "steps_per_second": round(steps * together / (seconds * devices)) if seconds else None,
        "trained": training.get("date"),
    }


def _device_seconds(runs: Iterable[Mapping[str, Any]]) -> float:
    """Return the seconds that runs took on all their devices, without adopted runs."""
    return sum(
        (run.get("seconds") or 0.0) * run.get("devices", 1)
        for run in runs
        if run["state"] != "adopted"
    )


def _teams_of(registry: Registry, run: str) -> int:
    """Return the number of different teams of a published run."""
    return len(
        {name.rpartition("-")[0] for name, team in registry.data.teams.items() if team.run == run}
    )


def _speeds(registry: Registry | None, statuses: Sequence[Status]) -> dict[tuple[str, str], int]:
    """Return training steps per second and device by task and algorithm, of the largest runs."""
    runs = [
        ((status.group.task, status.group.algorithm), run)
        for status in statuses
        for run in status.runs.values()
        if run["state"] == "trained"
    ]
    if registry:
        kinds = {entry.run: (entry.task, entry.algorithm) for entry in registry.policies}
        counts = {run: _teams_of(registry, run) for run in kinds}
        runs += [
            (kinds[run], _of_registry(registry, run, count, count)) for run, count in counts.items()
        ]
    runs.sort(key=lambda item: item[1]["steps"] * item[1]["teams"])
    return {kind: run["steps_per_second"] for kind, run in runs if run["steps_per_second"]}


def write_progress(
    path: Path, plan: Plan, statuses: Sequence[Status], errors: Mapping[str, str]
) -> dict[str, Any]:
    """Update a plan's progress file, which other processes write too, and return its content.

    Entries of runs that this process sees in registry or folders are replaced. Other entries stay
    until their teams are published.

    Args:
        path: The file.
        plan: The whole plan.
        statuses: Groups as this process sees them.
        errors: Message of each run that failed; "" for one that is tried, so that an earlier
            message goes.
    """
    with exclusive(path):
        old = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        groups = dict(old.get("groups", {}))
        for status in statuses:
            groups[status.group.name] = _entry(status, groups.get(status.group.name, {}), errors)
        groups = {group.name: groups[group.name] for group in plan.groups if group.name in groups}
        content = {
            "release": plan.release,
            "teams": sum(len(group.members) for group in plan.groups),
            "published": sum(entry["published"] for entry in groups.values()),
            "device_minutes": round(sum(entry["device_minutes"] for entry in groups.values()), 1),
            "groups": groups,
        }
        text = json.dumps(content, indent=2) + "\n"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            atomic_write(path, text.encode())
    return content


def _entry(status: Status, old: Mapping[str, Any], errors: Mapping[str, str]) -> dict[str, Any]:
    """Return a group's entry: its runs as seen now, and the file's entries of other runs."""
    before = old.get("runs", {})
    runs = {name: _dated(run, before.get(name, {})) for name, run in status.runs.items()}
    complete = len(status.published) == len(status.group.members)
    for planned in status.planned:
        error = errors.get(planned.name, before.get(planned.name, {}).get("error"))
        if planned.state != "finished" and error:
            runs[planned.name] = {"state": "failed", "teams": len(planned.members), "error": error}
        elif planned.state == "begun" or (planned.state == "new" and planned.name in errors):
            runs[planned.name] = {"state": "training", "teams": len(planned.members)}
    if not complete:
        runs = {name: run for name, run in before.items() if run["state"] != "published"} | runs
    state = "published" if complete else "missing"
    if not complete and (states := {run["state"] for run in runs.values()}):
        state = next(
            (name for name in ("failed", "training", "trained") if name in states), "missing"
        )
    return {
        "state": state,
        "teams": len(status.group.members),
        "published": len(status.published),
        "device_minutes": round(_device_seconds(runs.values()) / 60, 2),
        "runs": dict(sorted(runs.items())),
    }


def _dated(run: Mapping[str, Any], before: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run's entry with the day of its publication, if it is published."""
    if run["state"] != "published":
        return dict(run)
    today = datetime.date.today().isoformat()
    return {**run, "published": before.get("published") or today}
