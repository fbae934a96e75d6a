"""Splits: which partners a robot may train with, and which it is tested with.

A split is a manifest: task, release, rule, seed, the sorted team ids of both sides, what their
humans like where preferences are held out, and the sha256 of all that. Its id ends in the first
eight digits of that sha256, so a published split never changes: when a release grows, its default
split becomes a new one with a new id, and the old one stays for whoever cited it.

| rule | train | test |
|---|---|---|
| `half` (default) | a random half of each algorithm x disability stratum | the other half |
| `leave-one-algorithm-out` | every other algorithm | the held-out algorithm |
| `leave-one-disability-out` | every other disability setting | the held-out setting |
| `small-train` | n teams of the half's train side, chosen at random | the half's test side |
| `custom` | the teams given | the teams given |

With any rule, a gentle task's split may hold preferences out too: its test partners then like what
no training partner did.

Humans that act nearly alike (`zoo/splitting/similar_humans.py`) may not stand on both sides.
`zoo.splitting.create.create_split` leaves such training partners out of a leave-one-out split,
whose test side is to be whole, and refuses any other.

In `half`, a team's side depends on its own id and the split's seed alone: seeds 2k and 2k+1 of a
stratum are a pair, and the lowest bit of
sha256("{seed}:{task}/{algorithm}-{disability}-{release}:{k}") says which of the two trains. So the
order of the registry does not matter, no team ever changes sides when teams are added, and strata
with consecutive seeds are halved exactly; the odd one of an odd stratum falls by that hash to
either side.
"""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, Literal, NoReturn, get_args

from assistax_base.digest import json_sha256, sha256
from assistax_base.errors import LeakageError, SplitError, listing, shorten
from assistax_envs.preferences import check_preferences, preferences_of
from zoo.ids import TeamId, parse_team
from zoo.schema import Rule, Split, Team

RULES = get_args(Rule)
SIDES = {"test": ("test",), "train": ("train",), "both": ("train", "test")}  # of `--split`
DEFAULT_SIDE = "test"
LEAVE_ONE_OUT = {
    "leave-one-algorithm-out": "algorithm",
    "leave-one-disability-out": "disability",
}  # what is held out


def parse_split(text: str | None, namespaces: Collection[str]) -> tuple[str | None, str]:
    """Return a split's id, None for the default one, and the side that `--split` asks for.

    The text is a side ("both"), an id ("half-s0"), or both ("half-s0:both"); before each may stand
    the namespace of a zoo that was added ("lab:half-s0:both"), "lab:" alone for its default split.

    Raises:
        ValueError: What stands after the last colon is no side.
    """
    text = text or DEFAULT_SIDE
    namespace, _, rest = text.partition(":")
    prefix = f"{namespace}:" if namespace and namespace in namespaces else ""
    rest = rest if prefix else text
    name, _, side = ("", "", rest) if rest in SIDES else rest.partition(":")
    if (side or DEFAULT_SIDE) not in SIDES:
        raise ValueError(f"split is {text!r}; after the colon {', '.join(SIDES)} are allowed")
    return prefix + name or None, side or DEFAULT_SIDE


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
) -> Split:
    """Return the split that the rule makes of the task's teams in a release.

    Args:
        teams: Team ids to split; those of another task or release are left out.
        task: Of the split.
        release: Of the split.
        rule: One of `RULES`.
        seed: Of the rules that choose at random, `half` and `small-train`.
        held_out: Algorithm or disability setting that a leave-one-out rule tests on.
        n: Number of training partners of `small-train`.
        train: Team ids of the train side of `custom`.
        test: Likewise.
        train_preferences: What the train side's humans of a gentle task like, such as ("p2", "p3");
            where only one side's are given, the other has the rest.
        test_preferences: What the test side's like.

    Raises:
        SplitError: An unknown rule or preference, no argument, or an empty side.
        LeakageError: A team or a preference is on both sides.
    """
    ids = set(map(parse_team, teams))
    known = sorted(str(t) for t in ids if (t.task, t.release, t.namespace) == (task, release, ""))
    if rule == "half":
        sides = _by(known, lambda team: half_side(team, seed))
    elif rule in LEAVE_ONE_OUT:
        sides = _leave_one_out(known, LEAVE_ONE_OUT[rule], held_out)
    elif rule == "small-train":
        sides = _small_train(known, n, seed)
    elif rule == "custom":
        sides = _custom(known, sorted(train), sorted(test))
    else:
        raise SplitError("rule", f"one of {', '.join(RULES)}", shorten(rule))
    content: dict[str, Any] = {
        "task": task,
        "release": release,
        "rule": rule,
        "held_out": held_out if rule in LEAVE_ONE_OUT else None,
        "n": n if rule == "small-train" else None,
        "seed": seed if rule in ("half", "small-train") else 0,
        **{side: tuple(own) for side, own in zip(SIDES["both"], sides, strict=True)},
    }
    preferences = _preferences(task, sorted(train_preferences), sorted(test_preferences))
    content |= {"preferences": preferences} if preferences else {}
    split = Split.model_validate({"id": _id(content), "sha256": json_sha256(content), **content})
    check_split(split)
    return split


def half_side(team: TeamId, seed: int = 0) -> Literal["train", "test"]:
    """Return the side of a team in the `half` split: a function of its id and the split's seed."""
    stratum = f"{team.task}/{team.algorithm}-{team.disability}-{team.release}"
    coin = int(sha256(f"{seed}:{stratum}:{team.seed // 2}".encode())[-1], 16) & 1
    return "train" if team.seed % 2 == coin else "test"


def check_split(split: Split) -> None:
    """Check that a split's content gives its sha256 and id, and that nothing leaks.

    Raises:
        SplitError: The content differs from what was published, or a side is empty.
        LeakageError: A team or a preference is on both sides.
    """
    content = split.content
    digest = json_sha256(content)
    if digest != split.sha256:
        raise SplitError(f"split {split.id}", f"sha256 {split.sha256}", f"sha256 {digest}")
    if _id(content) != split.id:
        raise SplitError(f"split {split.id}", f"id {_id(content)}", split.id)
    for name, side in (("train", split.train), ("test", split.test)):
        if not side:
            raise SplitError(f"split {split.id}", f"at least one team in {name}", "none")
        if list(side) != sorted(set(side)):
            raise SplitError(
                f"split {split.id}", f"{name} sorted and without repetition", "another order"
            )
        foreign = [
            team
            for team in map(parse_team, side)
            if (team.task, team.release) != (split.task, split.release)
        ]
        if foreign:
            raise SplitError(
                f"split {split.id}",
                f"teams of {split.task} {split.release}",
                listing(map(str, foreign)),
            )
    both = sorted(set(split.train) & set(split.test))
    if both:
        refuse_leak(split.id, [(team, team) for team in both])
    if split.preferences:
        _check_preferences(split)


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


def _preferences(task: str, train: list[str], test: list[str]) -> dict[str, tuple[str, ...]]:
    """Return what the humans of each side like: of one that names nothing, what the other lacks."""
    if not train and not test:
        return {}
    lists = {"train": (train, test), "test": (test, train)}
    return {
        side: tuple(own or (name for name in preferences_of(task) if name not in other))
        for side, (own, other) in lists.items()
    }


def _check_preferences(split: Split) -> None:
    train, test = (split.preferences.get(side, ()) for side in ("train", "test"))
    for names in (train, test):
        try:
            check_preferences(split.task, names)
        except ValueError as error:
            expected = "preferences of its task on both sides"
            raise SplitError(f"split {split.id}", expected, str(error)) from None
    if both := sorted(set(train) & set(test)):
        expected = "no preference on both sides"
        raise LeakageError(f"split {split.id} leaks", expected, listing(both))


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


def _custom(known: Sequence[str], train: list[str], test: list[str]) -> tuple[list[str], list[str]]:
    foreign = sorted((set(train) | set(test)) - set(known))
    if foreign:
        raise SplitError(
            "custom split",
            f"some of the {len(known)} teams of the task and release",
            listing(foreign),
        )
    return sorted(set(train)), sorted(set(test))


def _id(content: Mapping[str, Any]) -> str:
    slug = {
        "leave-one-algorithm-out": f"without-{content['held_out']}",
        "leave-one-disability-out": f"without-{content['held_out']}",
        "small-train": f"small-{content['n']}",
    }.get(str(content["rule"]), str(content["rule"]))
    digest = json_sha256(content)[:8]
    slug = "-".join((slug, *content.get("preferences", {}).get("test", ())))
    return f"{content['task']}/{slug}-s{content['seed']}-{content['release']}-{digest}"
