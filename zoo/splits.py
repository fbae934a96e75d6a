"""Splits: partners for training a robot, and partners for its test.

A split is a manifest: task, release, rule, seed, the sorted team ids of its sides, the preferences
of their humans if preferences are held out, and the sha256 of all these. Its sides are training and
test. Newer splits have a validation side too, by which every choice is made before the test side is
played. The id of a split ends in the first eight digits of that sha256, so a published split never
changes. When a release grows, it gets a new default split with a new id, and the old split stays.

`zoo.splitting` makes splits, by rules. A reader of a split checks its content, its id, and that no
team stands on two sides.
"""

import itertools
import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NoReturn

from assistax_base.digest import json_sha256
from assistax_base.errors import LeakageError, SplitError, listing
from assistax_envs.preferences import check_preferences
from zoo.ids import task_and_release
from zoo.schema import RULES, RegistryFile, Split, Team

LEAST = 0.25  # share of the median return; partners with whom robots earn less are left out


def check_split(split: Split) -> None:
    """Check that a split's content gives its sha256 and id, and that nothing leaks.

    Raises:
        SplitError: The content differs from the published one, or a side is empty.
        LeakageError: A team is on two sides, or a preference of the test side on another.
    """
    content = split.content
    digest = json_sha256(content)
    if digest != split.sha256:
        raise SplitError(f"split {split.id}", f"sha256 {split.sha256}", f"sha256 {digest}")
    if split_id(content) != split.id:
        raise SplitError(f"split {split.id}", f"id {split_id(content)}", split.id)
    for name, side in split.sides.items():
        if not side:
            raise SplitError(f"split {split.id}", f"at least one team in {name}", "none")
        if list(side) != sorted(set(side)):
            raise SplitError(
                f"split {split.id}", f"{name} sorted and without repetition", "another order"
            )
        foreign = [team for team in side if task_and_release(team) != (split.task, split.release)]
        if foreign:
            raise SplitError(
                f"split {split.id}",
                f"teams of {split.task} {split.release}",
                listing(foreign),
            )
    counts = Counter(team for side in split.sides.values() for team in side)
    if both := sorted(team for team, count in counts.items() if count > 1):
        refuse_leak(split.id, [(team, team) for team in both])
    if split.preferences:
        _check_preferences(split)


def partner_teams(data: RegistryFile, task: str, release: str) -> list[str]:
    """Return the teams of a task in a release that have a human, and so can be partners."""
    return [
        team
        for team, entry in data.teams.items()
        if "human" in entry.policies
        and team.startswith(f"{task}/")
        and team.endswith(f"-{release}")
    ]


def competent(data: RegistryFile, teams: Iterable[str], earned: Mapping[str, float]) -> list[str]:
    """Return the teams whose human lets a robot earn `LEAST` of the median, or more.

    Teams without a known return stay. If the median is not above 0, all teams stay.

    Args:
        data: The registry, with the teams' returns in self-play.
        teams: Ids of the teams that are chosen among.
        earned: Return of the best response to a team's human by team, which replaces self-play.
    """
    teams = list(teams)
    own = {team: data.teams[team].self_play for team in teams}
    known = {team: figure.mean for team, figure in own.items() if figure is not None}
    known |= {team: earned[team] for team in teams if team in earned}
    median = statistics.median(known.values()) if known else 0.0
    return [team for team in teams if median <= 0 or known.get(team, median) >= LEAST * median]


def leaks(split: Split, teams: Mapping[str, Team]) -> list[tuple[str, str]]:
    """Return the pairs of teams on two sides that have identical parameters in one role."""
    sides = itertools.combinations(split.sides.values(), 2)
    return sorted(pair for two in sides for pair in shared_parameters(*two, teams))


def shared_parameters(
    train: Sequence[str], test: Sequence[str], teams: Mapping[str, Team]
) -> list[tuple[str, str]]:
    """Return the pairs (team in train, team in test) that have identical parameters in one role."""
    owners = {
        (role, place.sha256): team for team in train for role, place in teams[team].policies.items()
    }
    pairs = {
        (owners[role, place.sha256], team)
        for team in test
        for role, place in teams[team].policies.items()
        if (role, place.sha256) in owners
    }
    return sorted(pairs)


def refuse_leak(split: str, pairs: Sequence[tuple[str, str]]) -> NoReturn:
    """Raise the error for pairs of teams that are one and the same on both sides."""
    raise LeakageError(
        f"split {split} leaks",
        "no team and no parameters on both sides",
        f"{len(pairs)} on both: {listing([f'{a} = {b}' for a, b in pairs], 3)}",
    )


def _check_preferences(split: Split) -> None:
    missing = sorted(set(split.sides) ^ set(split.preferences))
    if missing:
        raise SplitError(f"split {split.id}", "preferences of each of its sides", listing(missing))
    for names in split.preferences.values():
        try:
            check_preferences(split.task, names)
        except ValueError as error:
            expected = "preferences of its task on both sides"
            raise SplitError(f"split {split.id}", expected, str(error)) from None
    seen = {name for side, names in split.preferences.items() for name in names if side != "test"}
    if both := sorted(seen & set(split.preferences["test"])):
        expected = "no preference on both sides"
        raise LeakageError(f"split {split.id} leaks", expected, listing(both))


def split_id(content: Mapping[str, Any]) -> str:
    """Return the id of a split of this content."""
    rule, held_out = str(content["rule"]), content["held_out"]
    made = rule if rule in RULES else "-".join(filter(None, (rule, held_out)))
    slug = {
        "leave-one-algorithm-out": f"without-{held_out}",
        "leave-one-disability-out": f"without-{held_out}",
        "small-train": f"small-{content['n']}",
    }.get(rule, made)
    digest = json_sha256(content)[:8]
    slug = "-".join((slug, *content.get("preferences", {}).get("test", ())))
    return f"{content['task']}/{slug}-s{content['seed']}-{content['release']}-{digest}"


def made_split(
    rule: str,
    task: str,
    release: str,
    train: Sequence[str],
    test: Sequence[str],
    *,
    validation: Sequence[str] = (),
) -> Split:
    """Return a split that a kind of partner makes and nothing stores.

    Args:
        rule: The kind's word.
        task: Task of the partners.
        release: Their release.
        train: Ids of the training side, without roles.
        test: Ids of the test side, without roles.
        validation: Ids of the validation side, if the split has one.
    """
    fields = {"task": task, "release": release, "rule": rule, "held_out": None}
    content = {**fields, "n": None, "seed": 0, "train": tuple(train), "test": tuple(test)}
    content |= {"validation": tuple(validation)} if validation else {}
    named = {"id": split_id(content), "sha256": json_sha256(content)}
    return Split.model_validate({**content, **named})
