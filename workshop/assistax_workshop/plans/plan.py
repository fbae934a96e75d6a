"""A plan: every team of a release, in groups that train in one program each.

A group is one task and one algorithm, with all its disability settings and seeds. Its run folders
are `NAME`, `NAME-2`, ... in the folder of the plan's runs, each with some of its members. The
members of a run folder are fixed when it is begun: a plan that changes later adds new folders, and
never alters existing ones. Imports no JAX.
"""

import collections
import dataclasses
import fnmatch
import json
import re
import secrets
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import count, islice
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    NonNegativeInt,
    PositiveInt,
    TypeAdapter,
    ValidationError,
)

from assistax_base.files import OWNER, atomic_write
from assistax_base.validated import Many, first_problem, validated
from population.config import (
    Member,
    Precision,
    TrainConfig,
    check_names,
    make_members,
    make_run,
    numbered,
)
from population.hyperparameters import TrainerConfig, preset
from population.runs.folder import RunFolder, differences

# The last word is not a number, so that a name is not mistaken for another group's second folder.
_NAME = re.compile(r"[a-z][a-z0-9_]*((-[a-z0-9_]+)*-[0-9]*[a-z_][a-z0-9_]*)?")

Key = tuple[str, int]  # disability setting and seed: a team within its group
SECRET_SEEDS = range(2**31, 2**63)  # no public plan uses these
Release = Annotated[str, Field(pattern=r"^v(0|[1-9][0-9]*)$")]


@validated
class Group:
    """Group of teams of one task and algorithm that train side by side."""

    name: str  # names its run folders, such as "scratch-ippo"
    task: str  # environment task
    algorithm: str  # preset of hyperparameters, and the name under which the teams are listed
    disabilities: Many[str]  # the human's settings
    seeds: Annotated[Many[int], BeforeValidator(numbered)]  # how many, or which
    steps: PositiveInt  # environment steps of each team
    set: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # changes of the preset
    updates_per_call: PositiveInt | None = None  # dispatched at once; None: the trainer's default
    checkpoint_every: PositiveInt | None = None  # in updates; None: the trainer's default
    self_play_episodes: NonNegativeInt = 16  # of each team's final evaluation; 0 leaves it out
    precision: Precision = "float32"  # of the published parameters, which are then evaluated
    max_members: PositiveInt | None = None  # most teams in one run, so that it fits the device
    adopt: Release | None = None  # release whose teams of at least `steps` join unchanged

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ValueError(
                f"name is {self.name!r}; it must be lower-case words joined by '-', the last one "
                "not a number"
            )
        check_names(self.task, self.disabilities)
        self.config(self.members)  # checks the rest
        if self.max_members and self.max_members < self.together:
            raise ValueError(
                f"max_members is {self.max_members}; the {self.together} seeds of a setting are "
                "one population, which trains in one run: allow that many, or fewer seeds"
            )

    @property
    def members(self) -> tuple[Member, ...]:
        """Every team, setting by setting."""
        return make_members(self.seeds, self.disabilities)

    @property
    def together(self) -> int:
        """Number of consecutive members that train in one run, such as a population's seeds."""
        return len(self.seeds) if self.trainer.population_coef else 1

    @property
    def trainer(self) -> TrainerConfig:
        """Hyperparameters."""
        return preset(self.algorithm, **self.set)

    def config(self, members: Sequence[Member]) -> TrainConfig:
        """Return the run that trains some of the members."""
        return make_run(
            self.task,
            self.algorithm,
            members,
            self.steps,
            self.trainer,
            checkpoint_every=self.checkpoint_every,
            updates_per_call=self.updates_per_call,
            self_play_episodes=self.self_play_episodes,
            precision=self.precision,
        )


@validated
class Plan:
    """Plan of a release's teams."""

    version: Literal[1]  # of the plan's format
    release: Release  # release that they join, such as "v1"
    groups: Annotated[Many[Group], Field(min_length=1)]  # in the order in which they are trained
    description: str = ""  # of the release, in one sentence
    default: bool = True  # whether the release becomes the registry's default once it is whole

    def __post_init__(self) -> None:
        owners: dict[str, str] = {}  # group of each team
        names = collections.Counter(group.name for group in self.groups)
        if (name := max(names, key=names.__getitem__)) and names[name] > 1:
            raise ValueError(f"two groups have the name {name!r}; give each its own")
        for group in self.groups:
            if group.adopt == self.release:
                raise ValueError(
                    f"group {group.name} adopts {group.adopt!r}, the plan's own release; name an "
                    "earlier"
                )
            for member in group.members:
                team = f"{group.task}/{group.algorithm}-{member.label}"
                other = owners.setdefault(team, group.name)
                if other != group.name:
                    raise ValueError(
                        f"groups {other} and {group.name} both have team {team}; leave it out of "
                        "one"
                    )

    def select(self, patterns: str) -> list[Group]:
        """Return the groups whose names match one of the comma-separated globs."""
        globs = [pattern.strip() for pattern in patterns.split(",")]
        groups = [
            group
            for group in self.groups
            if any(fnmatch.fnmatchcase(group.name, glob) for glob in globs)
        ]
        if not groups:
            names = ", ".join(group.name for group in self.groups)
            raise ValueError(f"no group matches {patterns!r}; the plan has {names}")
        return groups


def read_plan(path: Path) -> Plan:
    """Return the plan of a JSON file.

    Raises:
        ValueError: The file is not a plan; the message names the group and what is allowed.
        OSError: It cannot be read.
    """
    try:
        return TypeAdapter(Plan).validate_json(path.read_bytes())
    except ValidationError as error:
        raise ValueError(f"plan {path}: {first_problem(error)}") from None


def private_plan(
    plan: Plan, task: str | None = None, release: str | None = None, teams: int | None = None
) -> Plan:
    """Return a plan like a public one, with secret seeds.

    Seeds are drawn from the system's secrets, 63 bits each. They differ from one another and from
    the public ones. The plan adopts no teams.

    Args:
        plan: The public plan.
        task: Task whose groups are kept; None keeps all.
        release: Release that the teams join; None keeps the plan's.
        teams: Most teams, by fewer seeds in every group; None keeps the number of seeds.

    Raises:
        ValueError: The plan has no group of the task, the release is not "v" and a number, or so
            few teams leave a group without seeds.
    """
    groups = [group for group in plan.groups if task in (None, group.task)]
    if not groups:
        tasks = ", ".join(dict.fromkeys(group.task for group in plan.groups))
        raise ValueError(f"task is {task!r}; the plan has {tasks}: give one, or omit it for all")
    public = {seed for group in plan.groups for seed in group.seeds}
    counts = _seed_counts(groups, teams)
    enough = sum(counts) + len(public)  # public ones may be drawn
    drawn = secrets.SystemRandom().sample(SECRET_SEEDS, enough)
    fresh = (seed for seed in drawn if seed not in public)
    private = tuple(
        dataclasses.replace(group, seeds=tuple(islice(fresh, count)), adopt=None)
        for group, count in zip(groups, counts, strict=True)
    )
    release = plan.release if release is None else release
    return dataclasses.replace(plan, release=release, groups=private)


def _seed_counts(groups: Sequence[Group], teams: int | None) -> list[int]:
    """Return the number of seeds of each group in a plan of `teams`, in proportion.

    A group has at least one seed, a population two.
    """
    whole = sum(len(group.members) for group in groups)
    if teams is None or teams >= whole:
        return [len(group.seeds) for group in groups]
    least = [2 if group.together > 1 else 1 for group in groups]
    fewest = sum(base * len(group.disabilities) for base, group in zip(least, groups, strict=True))
    if teams < fewest:
        raise ValueError(f"teams is {teams}; every group needs a seed, which is {fewest} teams")
    share = (teams - fewest) / (whole - fewest)
    return [
        base + int((len(group.seeds) - base) * share)
        for group, base in zip(groups, least, strict=True)
    ]


def write_private_plan(plan: Plan, path: Path) -> None:
    """Write a plan to a new file that only its owner may read; its folder is created.

    Raises:
        ValueError: There is such a file; its seeds are nowhere else, so it stays.
        OSError: It cannot be written.
    """
    if path.exists():
        raise ValueError(
            f"{path} exists, and may hold the only copy of seeds that were trained with; choose a "
            "new file, or remove this one first"
        )
    content = TypeAdapter(Plan).dump_python(plan, mode="json", exclude_defaults=True)
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    atomic_write(path, (json.dumps(content, indent=2) + "\n").encode(), OWNER)


@dataclasses.dataclass(frozen=True)
class PlannedRun:
    """Run of a group's members in one folder."""

    group: Group
    folder: Path
    members: tuple[Member, ...]
    state: Literal["new", "begun", "finished"]

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.name

    @property
    def keys(self) -> frozenset[Key]:
        """Members by setting and seed."""
        return frozenset((member.disability, member.seed) for member in self.members)

    def config(self) -> TrainConfig:
        """Return the config of a begun run's folder, or the plan's config for a new run."""
        return (
            self.group.config(self.members)
            if self.state == "new"
            else RunFolder(self.folder).config()
        )

    def differences(self) -> str:
        """Return a description of a begun run's differences from the plan; "" if there are none."""
        config = self.group.config(self.members)
        return differences(self.config().to_json(), config.to_json())


def planned_runs(group: Group, out: Path, done: Collection[Key] = ()) -> list[PlannedRun]:
    """Return the runs of a group for members that are not done: existing folders, then new ones.

    Members without a folder are cut in order into new runs of at most `max_members`, so that
    processes which look at different times cut alike. A population is never cut.

    Args:
        group: The group.
        out: Folder of the plan's runs.
        done: Members that need no run: published, or adopted from another release.

    Raises:
        ValueError: A population is there in part.
    """
    known = list(_existing(group, out))
    held = {key for planned in known for key in planned.keys} | set(done)
    missing = [member for member in group.members if (member.disability, member.seed) not in held]
    for setting in group.disabilities if group.together > 1 else ():
        left = sum(member.disability == setting for member in missing)
        if 0 < left < group.together:
            raise ValueError(
                f"group {group.name} lacks {left} of its {group.together} teams of {setting}, "
                "which are one population; put seeds that you add later into a new group"
            )
    size = group.max_members or len(group.members)
    size -= size % group.together
    parts = [tuple(missing[start : start + size]) for start in range(0, len(missing), size)]
    taken = {planned.name for planned in known}
    names = (f"{group.name}-{number}" if number > 1 else group.name for number in count(1))
    free = (name for name in names if name not in taken)
    new = [PlannedRun(group, out / next(free), part, "new") for part in parts]
    keys = {(member.disability, member.seed) for member in group.members} - set(done)
    return [planned for planned in known if planned.keys & keys] + new


def _existing(group: Group, out: Path) -> Iterator[PlannedRun]:
    """Yield the existing runs of a group, by number of their folders."""
    pattern = re.compile(rf"{re.escape(group.name)}(?:-([0-9]+))?")
    places = [
        (int(match[1] or 1), path)
        for path in out.glob("*")
        if (match := pattern.fullmatch(path.name))
    ]
    for _, path in sorted(places):
        if (path / "teams.json").is_file():
            yield PlannedRun(group, path, _finished_members(group, path), "finished")
        elif (path / "config.json").is_file():
            config = RunFolder(path).config()
            _check_owner(group, path, config.task, config.algorithm)
            yield PlannedRun(group, path, config.members, "begun")


def _finished_members(group: Group, folder: Path) -> tuple[Member, ...]:
    """Return the members that a run's teams.json names.

    Some runs have only this file and their parameters left.
    """
    try:
        teams = [item["team"] for item in RunFolder(folder).team_items()]
        for team in teams:
            _check_owner(group, folder, team["task"], team["algorithm"])
        return tuple(Member(team["seed"], team["disability"]) for team in teams)
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"{folder} has no list of teams ({type(error).__name__}: {error}); remove it"
        ) from None


def _check_owner(group: Group, folder: Path, task: str, algorithm: str) -> None:
    """Refuse a folder whose run is of another task or algorithm than the group."""
    if (task, algorithm) != (group.task, group.algorithm):
        raise ValueError(
            f"{folder} holds a run of {task} {algorithm}, but group {group.name} is {group.task} "
            f"{group.algorithm}; choose another folder, or rename the group"
        )
