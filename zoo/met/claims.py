"""Partners that a received robot met in training, by the claim of its file or its user."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from assistax_base.errors import IdError, nearest, shorten
from assistax_envs.versions import TASKS
from zoo.ids import parse_team, task_and_release
from zoo.met.published import (
    CLAIMED,
    Humans,
    Met,
    made_split_met,
    met_in_training,
)
from zoo.namespaces import plain_name
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split, TrainedAgainst

MOST_VERSIONS = 10_000  # of an environment: a claim of a later one is ignored
NOBODY = "nobody"  # declared of a robot that met no partner of the zoo


def side_met(registry: Registry, split: Split) -> Met:
    """Return the partners of a robot that was trained with a split's training side."""
    partners = registry.source_of_split(split).identities(split)
    against = TrainedAgainst(split=split.id, sha256=split.sha256)
    return Met(source="registry", partners=partners, split=against)


def claimed_met(registry: Registry, metadata: Mapping[str, Any]) -> Met:
    """Return the partners that a robot met, by the claim of its file, which may be false.

    Older files name their policy or the split of the training in place of the partners.
    """
    if "met" in metadata:
        try:
            if not set(metadata["met"]) - set(CLAIMED):
                return _with_partners(
                    registry, Met.model_validate({"source": "file", **metadata["met"]})
                )
        except (ValidationError, TypeError):
            pass
        return Met(source="not known", reason="its file does not say it in a known form")
    named = metadata.get("id"), metadata.get("sha256")
    for entry in registry.policies:
        if (entry.id, entry.sha256) == named and entry.role == "robot":
            met = met_in_training(registry, entry)
            return met.model_copy(update={"source": "file"}) if met.known else met
    for split in registry.splits if "split" in metadata else ():
        if split.id == metadata["split"]:
            return side_met(registry, split).model_copy(update={"source": "file"})
    return Met(source="not known", reason="its file does not say it")


def claimed_version(metadata: Mapping[str, Any]) -> int | None:
    """Return the environment version of a robot's training, by its file.

    Returns:
        None if the file names no valid version.
    """
    training = metadata.get("training")
    claims = metadata, training if isinstance(training, Mapping) else {}
    versions = [claim.get("env_version") for claim in claims]
    return next((v for v in versions if type(v) is int and 0 < v < MOST_VERSIONS), None)


def declared_met(registry: Registry, task: str, trained_with: str | Sequence[str]) -> Met:
    """Return the partners that a robot met, by the declaration of its user.

    Args:
        registry: Where the partners are looked up.
        task: Task of the partners.
        trained_with: "nobody"; or split ids, each for its training side, and globs over partners or
            teams.

    Raises:
        ValueError: It is no text and no list of texts, "nobody" is one of several names, or a name
            is of another task.
        ZooError: There is no such split, or no partner matches.
    """
    names = [trained_with] if isinstance(trained_with, str) else list(trained_with)
    if not names or not all(isinstance(name, str) for name in names):
        raise ValueError(
            f"trained_with is {shorten(trained_with)}; allowed are {NOBODY!r}, or split ids and "
            "globs over partners"
        )
    if names == [NOBODY]:
        return Met(source="declared")
    if NOBODY in names:
        raise ValueError(f"trained_with has {NOBODY!r} beside others; leave one of them out")
    partners: Humans = {}
    sides = []
    for name in names:
        other = name.rpartition(":")[2].partition("/")[0]
        if other in TASKS and other != task:
            raise ValueError(
                f"trained_with is {shorten(name)}, of task {other}, and {task} is played; name "
                f"partners or splits of {task}, or {NOBODY!r} if the robot met none of its partners"
            )
        if _names_partners(registry, name):
            chosen = registry.select(name, task=task, role="human")
            partners |= {entry.team: entry.sha256 for entry in chosen}
        elif meant := _misspelt(registry, name):
            raise ValueError(
                f"trained_with is {name!r}; allowed are {NOBODY!r}, or split ids, each for its "
                f"training side, and globs over partners; did you mean {meant[0]!r}?"
            )
        else:
            chosen = registry.split(task, name)
            if plain_name(name) == chosen.rule:  # a kind's word means partners of that kind alone
                chosen = registry.source_of_split(chosen).alone(chosen)
            sides.append(side_met(registry, chosen))
            partners |= sides[-1].partners
    split = sides[0].split if len(sides) == len(names) == 1 else None
    return Met(source="declared", partners=partners, split=split)


def known_humans(entries: Iterable[PolicyEntry], humans: Humans) -> frozenset[str]:
    """Return the ids of those human entries that a robot met."""
    digests = set(humans.values())
    return frozenset(
        entry.id for entry in entries if entry.team in humans or entry.sha256 in digests
    )


def _with_partners(registry: Registry, met: Met) -> Met:
    """Return a file's claim; if it lists no partners, with those of the split that it names."""
    if met.split is None or met.partners:
        return met
    if (made := made_split_met(registry, met.split)) is None:
        reason = f"split {shorten(met.split.split)}, which its file names, is not in this registry"
        return Met(source="not known", split=met.split, reason=reason)
    return met.model_copy(update={"partners": made.partners})


def _misspelt(registry: Registry, name: str) -> list[str]:
    """Return the words that a name is near to; empty if it may be a split's id."""
    if name in ("none", "None", "no", "-"):
        return [NOBODY]
    words = [source.word for source in registry.sources if source.word]
    plain = name.partition(":")[2] if name.partition(":")[0] in words else name
    return nearest(name, (NOBODY, *words)) if name not in words and plain.isalpha() else []


def _names_partners(registry: Registry, text: str) -> bool:
    """Return whether a text is a glob, or the id of a team or a policy, and no split's."""
    if set(text) & set("*?["):
        return True
    plain = text.removesuffix("/human").removesuffix("/robot")
    try:
        if registry.source_of(text).word:
            task_and_release(plain)
        else:
            parse_team(plain)
    except IdError:
        return False
    return True
