"""A plan: every team of a release, in groups that train in one program each.

What exists of it, what is missing.

A group is one task and one algorithm, with all its disability settings and seeds. Its run folders
are `NAME`, `NAME-2`, ... in the folder of the plan's runs, each with a block of its members. What a
run folder holds is decided when it is
begun: a plan that changes later adds new folders, and never alters those that are there. Imports no
    JAX.
"""

import dataclasses
import fnmatch
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from assistax_envs.disability import DISABILITY_SETTINGS
from assistax_envs.versions import TASKS
from population.config import Member, TrainConfig, make_members, make_run, preset
from population.run_folder import RunFolder

PLAN_VERSION = 1
_NAME = re.compile(r"[a-z][a-z0-9_]*(-[a-z0-9_]+)*")
_RELEASE = re.compile(r"v(0|[1-9][0-9]*)")

Key = tuple[str, int]  # disability setting and seed: a team within its group


@dataclasses.dataclass(frozen=True)
class Group:
    """Teams of one task and algorithm that train side by side."""

    name: str  # names its run folders, such as "scratch-ippo"
    task: str  # environment task
    algorithm: str  # preset of hyperparameters, and the name under which the teams are listed
    disabilities: tuple[str, ...]  # the human's settings
    seeds: tuple[int, ...]  # training seeds; a number in the file stands for 0 to that number - 1
    steps: int  # environment steps of each team
    set: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # changes of the preset
    updates_per_call: int | None = (
        None  # updates dispatched to the device at once; None: the trainer's default
    )
    checkpoint_every: int | None = None  # updates between checkpoints; None: the trainer's default
    self_play_episodes: int = 16  # episodes of each team's final evaluation; 0 leaves it out
    max_members: int | None = (
        None  # most teams in one run, so that it fits the device; None: all in one
    )
    adopt: str | None = None  # earlier release whose teams of at least `steps` join unchanged

    def __post_init__(self) -> None:
        if isinstance(self.seeds, int) and not isinstance(self.seeds, bool):
            object.__setattr__(self, "seeds", tuple(range(self.seeds)))
        for name in ("disabilities", "seeds"):
            _check(isinstance(getattr(self, name), list | tuple), self, name, "a list")
            object.__setattr__(self, name, tuple(getattr(self, name)))
        _check(
            _whole_name(self.name),
            self,
            "name",
            "lower-case words joined by '-', the last one not a number",
        )
        _check(self.task in TASKS, self, "task", f"one of {', '.join(TASKS)}")
        _check(bool(self.seeds), self, "seeds", "a number above 0, or a list of at least one seed")
        _check(len(set(self.seeds)) == len(self.seeds), self, "seeds", "different numbers")
        known = bool(self.disabilities) and all(
            name in DISABILITY_SETTINGS for name in self.disabilities
        )
        _check(known, self, "disabilities", f"a list of {', '.join(DISABILITY_SETTINGS)}")
        _check(
            len(set(self.disabilities)) == len(self.disabilities),
            self,
            "disabilities",
            "different settings",
        )
        _check(isinstance(self.set, dict), self, "set", "an object of hyperparameters")
        _check(_above_0(self.steps), self, "steps", "an integer above 0")
        for name in ("max_members", "updates_per_call", "checkpoint_every"):
            value = getattr(self, name)
            _check(value is None or _above_0(value), self, name, "an integer above 0")
        release = isinstance(self.adopt, str) and _RELEASE.fullmatch(self.adopt)
        _check(
            self.adopt is None or bool(release), self, "adopt", "an earlier release, such as 'v0'"
        )
        self.config(self.members)  # checks the rest

    @property
    def members(self) -> tuple[Member, ...]:
        """Every team, setting by setting."""
        return make_members(self.seeds, self.disabilities)

    def config(self, members: Sequence[Member]) -> TrainConfig:
        """Return the run that trains some of the members."""
        return make_run(
            self.task,
            self.algorithm,
            members,
            self.steps,
            preset(self.algorithm, **self.set),
            checkpoint_every=self.checkpoint_every,
            updates_per_call=self.updates_per_call,
            self_play_episodes=self.self_play_episodes,
        )


@dataclasses.dataclass(frozen=True)
class Plan:
    """The teams of a release."""

    release: str  # release that they join, such as "v1"
    groups: tuple[Group, ...]  # in the order in which they are trained
    description: str = ""  # of the release, in one sentence

    def __post_init__(self) -> None:
        release = isinstance(self.release, str) and _RELEASE.fullmatch(self.release)
        _check(bool(release), self, "release", "a release such as 'v1'")
        _check(isinstance(self.description, str), self, "description", "a sentence")
        if not self.groups:
            raise ValueError("the plan has no groups; give at least one")
        names: dict[str, Group] = {}
        teams: dict[tuple[str, str, str, int], str] = {}
        for group in self.groups:
            if group.name in names:
                raise ValueError(f"two groups have the name {group.name!r}; give each its own")
            names[group.name] = group
            if group.adopt == self.release:
                raise ValueError(
                    f"group {group.name} adopts {group.adopt!r}, the plan's own release; name an "
                    "earlier"
                )
            for member in group.members:
                team = (group.task, group.algorithm, member.disability, member.seed)
                other = teams.setdefault(team, group.name)
                if other != group.name:
                    label = f"{group.task}/{group.algorithm}-{member.label}"
                    raise ValueError(
                        f"groups {other} and {group.name} both have team {label}; leave it out of "
                        "one"
                    )

    def select(self, patterns: str) -> list[Group]:
        """Return the groups whose names match one of the comma-separated globs."""
        wanted = [pattern.strip() for pattern in patterns.split(",")]
        found = [
            group
            for group in self.groups
            if any(fnmatch.fnmatchcase(group.name, glob) for glob in wanted)
        ]
        if not found:
            names = ", ".join(group.name for group in self.groups)
            raise ValueError(f"no group matches {patterns!r}; the plan has {names}")
        return found


def read_plan(path: Path) -> Plan:
    """Return the plan of a JSON file.

    Raises:
        ValueError: The file is not a plan; the message names the group and what is allowed.
        OSError: It cannot be read.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"plan {path} is not JSON ({error})") from None
    try:
        fields = _fields(content, Plan, "the plan", extra=("version",))
        if fields.pop("version", None) != PLAN_VERSION:
            raise ValueError(
                f"version is {content.get('version')!r}; this installation reads version "
                f"{PLAN_VERSION}"
            )
        if not isinstance(fields["groups"], list):
            raise ValueError(f"groups is {type(fields['groups']).__name__}; give a list of groups")
        groups = tuple(_group(item, place) for place, item in enumerate(fields.pop("groups")))
        return Plan(groups=groups, **fields)
    except ValueError as error:
        raise ValueError(f"plan {path}: {error}") from None


@dataclasses.dataclass(frozen=True)
class Block:
    """Members of a group in one run folder."""

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
        """Return what the folder's run trains: what it was begun with, else what the plan says."""
        return (
            self.group.config(self.members)
            if self.state == "new"
            else RunFolder(self.folder).config()
        )

    def differences(self) -> list[str]:
        """Say in which numbers a begun run is another than the plan now wants."""
        wanted, found = self.group.config(self.members), self.config()
        pairs = [("steps", found.steps, wanted.steps)]
        pairs += [
            (field.name, getattr(found.trainer, field.name), getattr(wanted.trainer, field.name))
            for field in dataclasses.fields(wanted.trainer)
            if type(found.trainer) is type(wanted.trainer)
        ]
        return [
            f"{name} is {there} there and {here} in the plan"
            for name, there, here in pairs
            if there != here
        ]


def find_blocks(group: Group, out: Path, done: Collection[Key] = ()) -> list[Block]:
    """Return the runs of a group that hold, or are to hold, members that are not done.

    Members that no folder holds are cut in order into new blocks of at most `max_members`, so that
    processes which look at different times cut alike.

    Args:
        group: The group.
        out: Folder of the plan's runs.
        done: Members that need no run: published, or adopted from another release.
    """
    known = list(_existing(group, out))
    held = {key for block in known for key in block.keys} | set(done)
    missing = [member for member in group.members if (member.disability, member.seed) not in held]
    size = group.max_members or len(group.members)
    parts = [tuple(missing[start : start + size]) for start in range(0, len(missing), size)]
    names = _free_names(group, {block.name for block in known})
    new = [Block(group, out / next(names), part, "new") for part in parts]
    wanted = {(member.disability, member.seed) for member in group.members} - set(done)
    return [block for block in known if block.keys & wanted] + new


def _existing(group: Group, out: Path) -> Iterator[Block]:
    """Yield the run folders of a group, by number."""
    pattern = re.compile(rf"{re.escape(group.name)}(?:-([0-9]+))?")
    places = [
        (int(match[1] or 1), path)
        for path in out.glob("*")
        if (match := pattern.fullmatch(path.name))
    ]
    for _, path in sorted(places):
        if (path / "teams.json").is_file():
            yield Block(group, path, _finished_members(group, path / "teams.json"), "finished")
        elif (path / "config.json").is_file():
            config = RunFolder(path).config()
            _check_owner(group, path, config.task, config.algorithm)
            yield Block(group, path, config.members, "begun")


def _finished_members(group: Group, path: Path) -> tuple[Member, ...]:
    """Return the members that a run's teams.json names.

    All that is left of some runs but their parameters.
    """
    try:
        teams = [item["team"] for item in json.loads(path.read_text(encoding="utf-8"))]
        for team in teams:
            _check_owner(group, path.parent, team["task"], team["algorithm"])
        return tuple(Member(team["seed"], team["disability"]) for team in teams)
    except (KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is no list of teams ({type(error).__name__}: {error}); remove its folder"
        ) from None


def _check_owner(group: Group, folder: Path, task: str, algorithm: str) -> None:
    if (task, algorithm) != (group.task, group.algorithm):
        raise ValueError(
            f"{folder} holds a run of {task} {algorithm}, but group {group.name} is {group.task} "
            f"{group.algorithm}; choose another --out, or rename the group"
        )


def _free_names(group: Group, taken: Collection[str]) -> Iterator[str]:
    number = 1
    while True:
        name = group.name if number == 1 else f"{group.name}-{number}"
        if name not in taken:
            yield name
        number += 1


def _group(item: Any, place: int) -> Group:
    name = item.get("name") if isinstance(item, dict) else None
    where = f"group {name}" if isinstance(name, str) else f"group number {place + 1}"
    fields = _fields(item, Group, where)
    try:
        return Group(**fields)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{where}: {error}") from None


def _fields(
    content: Any, kind: type[Plan] | type[Group], where: str, extra: tuple[str, ...] = ()
) -> dict[str, Any]:
    """Check that an object has the fields of a dataclass, and return them."""
    if not isinstance(content, dict):
        raise ValueError(f"{where} is {type(content).__name__}; give an object")
    fields = dataclasses.fields(kind)
    allowed = [*extra, *(field.name for field in fields)]
    if unknown := sorted(content.keys() - allowed):
        raise ValueError(
            f"{where} has the unknown field {unknown[0]!r}; allowed are {', '.join(allowed)}"
        )
    plain = (dataclasses.MISSING, dataclasses.MISSING)
    needed = [
        *extra,
        *(field.name for field in fields if (field.default, field.default_factory) == plain),
    ]
    if missing := [name for name in needed if name not in content]:
        raise ValueError(f"{where} lacks {', '.join(missing)}")
    return dict(content)


def _whole_name(name: Any) -> bool:
    """Return whether a group's name cannot be taken for the second folder of another group."""
    return (
        isinstance(name, str)
        and bool(_NAME.fullmatch(name))
        and not name.rpartition("-")[2].isdigit()
    )


def _above_0(value: Any) -> bool:
    return type(value) is int and value >= 1


def _check(valid: bool, config: object, name: str, allowed: str) -> None:
    if not valid:
        raise ValueError(f"{name} is {getattr(config, name)!r}; it must be {allowed}")
