"""The rules that make a split of a release's teams.

| rule | train | test |
|---|---|---|
| `half` (default) | a random half of each algorithm x disability stratum | the other half |
| `leave-one-algorithm-out` | every other algorithm | the held-out algorithm |
| `leave-one-disability-out` | every other disability setting | the held-out setting |
| `small-train` | n teams of the half's train side, chosen at random | the half's test side |
| `custom` | the teams given | the teams given |
| `three-sides` | 60% of each algorithm x disability x convention group | 25% |

`three-sides` has a validation side too, the other 15%. By it checkpoints, seeds and
hyperparameters are chosen, so that the test side is played once. Teams are dealt stratum by
stratum, each to the side that lacks most of its share so far: the sides have their shares of all
teams to within one team, and nearly so of each stratum.

With any rule, a gentle task's split may hold preferences out too: its test partners then have
preferences that no partner of the training and validation sides has. Such a split has an id of its
own, so that results with new preferences differ from those with new partners alone.

Humans that act nearly alike (`zoo/splitting/similar_humans.py`) may not stand on two sides.
`zoo.splitting.create.create_split` leaves one of them out where the rule can do without, and
refuses the split otherwise.

In `half`, a team's side depends on its own id and the split's seed alone: seeds 2k and 2k+1 of a
stratum are a pair, and the lowest bit of
sha256("{seed}:{task}/{algorithm}-{disability}-{release}:{k}") says which of the two trains. So the
order of the registry does not matter, no team ever changes sides when teams are added, and strata
with consecutive seeds are halved exactly; the odd one of an odd stratum falls by that hash to
either side.
"""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal

from assistax_base.digest import json_sha256, sha256
from assistax_base.errors import SplitError, listing, shorten
from assistax_envs.preferences import preferences_of
from zoo.ids import TeamId, parse_team
from zoo.schema import RULES, Split
from zoo.splits import check_split, split_id

LEAVE_ONE_OUT = {
    "leave-one-algorithm-out": "algorithm",
    "leave-one-disability-out": "disability",
}  # the held-out property
THREE = "three-sides"
SHARES = {"train": 0.60, "validation": 0.15, "test": 0.25}  # of the teams, by `three-sides`


def make_split(
    teams: Iterable[str],
    *,
    task: str,
    release: str,
    rule: str = "half",
    seed: int = 0,
    held_out: str | None = None,
    n: int = 5,
    train: Iterable[str] = (),
    test: Iterable[str] = (),
    train_preferences: Iterable[str] = (),
    test_preferences: Iterable[str] = (),
    groups: Mapping[str, str] | None = None,
) -> Split:
    """Return the split that the rule makes of the task's teams in a release.

    Args:
        teams: Team ids to split; those of another task or release are left out.
        task: Of the split.
        release: Of the split.
        rule: One of `RULES`.
        seed: Of the rules that choose at random: `half`, `small-train` and `three-sides`.
        held_out: Algorithm or disability setting that a leave-one-out rule tests on.
        n: Number of training partners of `small-train`.
        train: Team ids of the train side of `custom`.
        test: Those of the test side.
        train_preferences: Preferences of the train side's humans; if only one side's are given, the
            other side has the rest.
        test_preferences: Those of the test side's humans.
        groups: Convention group of each team, by which `three-sides` stratifies too.

    Raises:
        SplitError: An unknown rule or preference, no argument, or an empty side.
        LeakageError: A team is on two sides, or a preference of the test side on another.
    """
    ids = set(map(parse_team, teams))
    known = sorted(str(t) for t in ids if (t.task, t.release, t.namespace) == (task, release, ""))
    given = sorted(train), sorted(test)
    sides = _sides(known, rule, seed, held_out, n, given, groups or {})
    content: dict[str, Any] = {
        "task": task,
        "release": release,
        "rule": rule,
        "held_out": held_out if rule in LEAVE_ONE_OUT else None,
        "n": n if rule == "small-train" else None,
        "seed": seed if rule in ("half", "small-train", THREE) else 0,
        **{side: tuple(own) for side, own in sides.items()},
    }
    preferences = _preferences(task, sorted(train_preferences), sorted(test_preferences))
    if preferences and rule == THREE:
        preferences["validation"] = preferences["train"]
    content |= {"preferences": preferences} if preferences else {}
    named = {"id": split_id(content), "sha256": json_sha256(content)}
    split = Split.model_validate(named | content)
    check_split(split)
    return split


def _sides(
    known: Sequence[str],
    rule: str,
    seed: int,
    held_out: str | None,
    n: int,
    given: tuple[list[str], list[str]],
    groups: Mapping[str, str],
) -> dict[str, list[str]]:
    """Return the teams of each side by a rule."""
    if rule == THREE:
        return _three_sides(known, seed, groups)
    if rule == "half":
        sides = _by(known, lambda team: half_side(team, seed))
    elif rule in LEAVE_ONE_OUT:
        sides = _leave_one_out(known, LEAVE_ONE_OUT[rule], held_out)
    elif rule == "small-train":
        sides = _small_train(known, n, seed)
    elif rule == "custom":
        sides = _custom(known, *given)
    else:
        raise SplitError("rule", f"one of {', '.join(RULES)}", shorten(rule))
    return dict(zip(("train", "test"), sides, strict=True))


def half_side(team: TeamId, seed: int = 0) -> Literal["train", "test"]:
    """Return the side of a team in the `half` split: a function of its id and the split's seed."""
    stratum = f"{team.task}/{team.algorithm}-{team.disability}-{team.release}"
    coin = int(sha256(f"{seed}:{stratum}:{team.seed // 2}".encode())[-1], 16) & 1
    return "train" if team.seed % 2 == coin else "test"


def _preferences(task: str, train: list[str], test: list[str]) -> dict[str, tuple[str, ...]]:
    """Return the preferences of each side; a side without any has those that the other lacks."""
    if not train and not test:
        return {}
    lists = {"train": (train, test), "test": (test, train)}
    return {
        side: tuple(own or (name for name in preferences_of(task) if name not in other))
        for side, (own, other) in lists.items()
    }


def _by(known: Sequence[str], side_of: Callable[[TeamId], str]) -> tuple[list[str], list[str]]:
    sides = {team: side_of(parse_team(team)) for team in known}
    return [team for team in known if sides[team] == "train"], [
        team for team in known if sides[team] == "test"
    ]


def _leave_one_out(
    known: Sequence[str], field: str, held_out: str | None
) -> tuple[list[str], list[str]]:
    present = sorted({getattr(parse_team(team), field) for team in known})
    if held_out not in present:
        raise SplitError(
            f"{field} to hold out", f"one of {listing(present, 12)}", shorten(held_out)
        )
    return _by(known, lambda team: "test" if getattr(team, field) == held_out else "train")


def _small_train(known: Sequence[str], n: int, seed: int) -> tuple[list[str], list[str]]:
    train, test = _by(known, lambda team: half_side(team, seed))
    if not 1 <= n <= len(train):
        raise SplitError(
            "n of small-train", f"1 to {len(train)}, the teams of the half's train side", str(n)
        )
    return sorted(sorted(train, key=lambda team: sha256(f"{seed}:{team}".encode()))[:n]), test


def _three_sides(
    known: Sequence[str], seed: int, groups: Mapping[str, str]
) -> dict[str, list[str]]:
    """Return the teams of three sides."""

    def place(team: str) -> tuple[str, ...]:
        named = parse_team(team)
        stratum = (named.algorithm, named.disability, groups.get(team, ""))
        return *stratum, sha256(f"{seed}:{team}".encode())

    dealt: dict[str, list[str]] = {side: [] for side in SHARES}
    for count, team in zip(itertools.count(1), sorted(known, key=place), strict=False):
        lacking = max(SHARES, key=lambda side: SHARES[side] * count - len(dealt[side]))
        dealt[lacking].append(team)
    if not all(dealt.values()):
        raise SplitError(THREE, "5 teams or more", str(len(known)))
    return {side: sorted(teams) for side, teams in dealt.items()}


def _custom(known: Sequence[str], train: list[str], test: list[str]) -> tuple[list[str], list[str]]:
    foreign = sorted((set(train) | set(test)) - set(known))
    if foreign:
        raise SplitError(
            "custom split",
            f"some of the {len(known)} teams of the task and release",
            listing(foreign),
        )
    return sorted(set(train)), sorted(set(test))
