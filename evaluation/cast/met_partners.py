"""Which partners of a job its robots met in training: figures of new partners leave them out.

M_test is about partners that a robot never met, M_train about those that it was trained with. So a
human that learned together with a robot is counted on no side, and a frozen one that it was trained
with on the training side alone.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import polars as pl

from assistax_base.errors import counted, listing, shorten
from evaluation.cast.roster import Member, Roster
from zoo.met.claims import declared_met, known_humans
from zoo.met.published import Met
from zoo.registry import Registry
from zoo.schema import PolicyEntry

UNKNOWN = "partners met in training: not known"
DECLARED = "partners met in training: as declared, not checked"


@dataclasses.dataclass(frozen=True)
class MetSummary:
    """What a summary says of it."""

    known: bool  # of all robots
    source: str  # "registry", "file", "declared", "not known"; or several of them
    left_out: tuple[str, ...]  # partners that no figure counts


@dataclasses.dataclass(frozen=True)
class MetPartners:
    """Partners of a job, by id, that its robots met."""

    sources: tuple[str, ...]  # of what is known, in alphabetical order
    own: frozenset[str] = frozenset()  # learned together with one of the robots
    frozen: frozenset[str] = frozenset()  # that one of the robots was trained with
    by_all: frozenset[str] = frozenset()  # and those that all robots were
    reasons: tuple[str, ...] = ()  # of whose training these are
    unknown: tuple[str, ...] = ()  # robots of which nothing is known, and why

    @property
    def known(self) -> bool:
        """Whether something is known of every robot."""
        return "not known" not in self.sources

    def summary(self, left_out: Sequence[str]) -> MetSummary:
        """Return what a summary says."""
        return MetSummary(self.known, ", ".join(self.sources), tuple(left_out))

    def left_out(self, partners: Mapping[str, str | None]) -> list[str]:
        """Return which partners, given with their sides, are not new where they play."""
        return [
            name
            for name, side in partners.items()
            if name in self.own or (name in self.frozen and side != "train")
        ]


NOTHING_KNOWN = MetPartners(("not known",))


def declare(
    egos: Roster, registry: Registry, task: str, trained_with: str | Sequence[str] | None
) -> Roster:
    """Return the robots with what their user declares of them, beside what is known anyhow.

    Args:
        egos: The robots, all trained alike.
        registry: Where the partners are looked up.
        task: Whose partners.
        trained_with: See `zoo.met.claims.declared_met`; None declares nothing.

    Raises:
        ValueError: It is malformed, or says "nobody" of a robot that is known to have met some.
        ZooError: There is no such split or partner.
    """
    if not trained_with:
        return egos
    declared = declared_met(registry, task, trained_with)
    members = {name: _declared(member, declared) for name, member in egos.members.items()}
    return dataclasses.replace(egos, members=members)


def met_partners(egos: Roster, partners: Iterable[PolicyEntry]) -> MetPartners:
    """Return which partners the robots met, by the sha256 of the human or by its team."""
    humans = list(partners)
    robots = egos.describe(egos.ids)
    own = [known_humans(humans, robot.met.own) for robot in robots]
    frozen = [known_humans(humans, robot.met.partners) for robot in robots]
    return MetPartners(
        sources=tuple(sorted({robot.met.source for robot in robots})),
        own=frozenset().union(*own),
        frozen=frozenset().union(*frozen),
        by_all=frozenset.intersection(*frozen) if frozen else frozenset(),
        reasons=tuple(dict.fromkeys(_reason(r.met) for r in robots if r.met.partners)),
        unknown=tuple(
            f"{shorten(robot.id)}{f' ({robot.met.reason})' if robot.met.reason else ''}"
            for robot in robots
            if not robot.met.known
        ),
    )


def describe_met(egos: Roster, trained_with: str | Sequence[str] | None) -> dict[str, Any]:
    """Return what the manifest says: what was declared, and what is known of each robot.

    The partners of a split are its training side, so they are not listed.
    """
    robots = {}
    for member in egos.describe(egos.ids):
        known = member.met.model_dump(mode="json", exclude_defaults=True)
        if member.met.split is not None:
            known.pop("partners", None)
        robots[member.id] = known
    declared = [trained_with] if isinstance(trained_with, str) else list(trained_with or ())
    return {"declared": declared, "robots": robots}


def left_out(table: pl.DataFrame, met: MetPartners) -> list[str]:
    """Return the partners of a table that are not new to one of its robots, in its order."""
    robots = set(table["ego_team"].drop_nulls())
    partners = table.select("partner", "partner_team", "side").unique(maintain_order=True)
    left = set(met.left_out(dict(partners.select("partner", "side").rows())))
    return [name for name, team, _ in partners.rows() if name in left or team in robots]


def check_new(
    sides: Mapping[str, str | None], left: Sequence[str], include_own: bool = False
) -> None:
    """Refuse partners of whom no figure could speak.

    Args:
        sides: Of all partners, by id.
        left: Those that are left out.
        include_own: Whether they are counted all the same.

    Raises:
        ValueError: All partners are left out, or all of the test side.
    """
    tested = [name for name, side in sides.items() if side != "train"]
    for names in (tested, list(sides)):
        if names and not include_own and set(names) <= set(left):
            side = "of the test side " * (len(names) < len(sides))
            raise ValueError(
                f"every partner {side}that matches was trained with one of the robots ({names[0]}),"
                " so is not new to it; choose others, or let include_own count them"
            )


def met_notes(table: pl.DataFrame, met: MetPartners, include_own: bool) -> list[str]:
    """Say which partners the robots of a table met in training, and who says so."""
    notes = []
    if left := left_out(table, met):
        done = (
            "counted all the same" if include_own else "left out of the figures, kept in the tables"
        )
        why = f" ({'; '.join(met.reasons)})" if met.frozen & set(left) else ""
        notes.append(
            f"{counted(len(left), 'partner')} that one of the egos was trained "
            f"with{why}, hence not new to it, {done}: {listing(left, 3)}"
        )
    return [*notes, *_training_notes(table, met), *source_notes(met)]


def source_notes(met: MetPartners) -> list[str]:
    """Say of which robots nothing is known, and what was believed without a check."""
    notes = []
    if not met.known:
        whose = f" of {listing(met.unknown, 3)}" if met.unknown else ""
        notes.append(f"{UNKNOWN}{whose}; figures may count some; trained_with declares them")
    if "declared" in met.sources:
        notes.append(DECLARED)
    if "file" in met.sources:
        notes.append("partners met in training: as the robot's file claims")
    return notes


def crossplay_notes(met: MetPartners) -> list[str]:
    """Say which columns of a matrix are of partners that one of its egos was trained with."""
    if not met.frozen:
        return []
    names = listing(sorted(met.frozen), 3)
    return [
        f"{len(met.frozen)} partners were frozen partners of an ego in its training "
        f"({'; '.join(met.reasons)}) and count as cross-play: {names}"
    ]


def both_met(*results: tuple[MetSummary | None, pl.DataFrame]) -> MetSummary:
    """Return what holds of a comparison: it leaves out whom a robot of either method met.

    Args:
        results: Of each method what its summary says, and its episodes. A summary of before it was
            recorded left out teams' own humans.
    """
    methods = [
        said or NOTHING_KNOWN.summary(left_out(table, NOTHING_KNOWN)) for said, table in results
    ]
    sources = sorted({source for method in methods for source in method.source.split(", ")})
    names = dict.fromkeys(name for method in methods for name in method.left_out)
    return MetSummary(all(method.known for method in methods), ", ".join(sources), tuple(names))


def comparison_notes(met: MetSummary, methods: int) -> list[str]:
    """Return the notes on partners that a comparison leaves out, and on unknown training."""
    notes = []
    if met.left_out:
        names = listing(met.left_out, 3)
        either, both = ("either", "both") if methods == 2 else ("one", "all")
        notes.append(f"trained with a robot of {either} method, hence left out of {both}: {names}")
    if not met.known:
        notes.append(f"{UNKNOWN} of one of the methods at least; differences may count some")
    return notes


def _training_notes(table: pl.DataFrame, met: MetPartners) -> list[str]:
    """Say where the training side has partners that the robots, trained with others, never met."""
    left = set(left_out(table, met))
    played = set(table.filter(side="train")["partner"].unique()) - left
    if not met.reasons or played <= met.by_all:
        return []
    return [
        f"M_train: {len(played & met.by_all)} of {len(played)} partners of the training side were "
        f"met in training by every ego ({'; '.join(met.reasons)}), the others are new"
    ]


def _declared(member: Member, declared: Met) -> Member:
    """Return a robot with a declaration, which adds to what is known and takes nothing away."""
    known = member.met
    if not known.known:
        return dataclasses.replace(member, met=declared)
    if not declared.partners and (known.own or known.partners):
        raise ValueError(
            f"trained_with is 'nobody', but {member.id} was trained with partners of the zoo as "
            f"its {known.source} says; leave trained_with out"
        )
    split = known.split if known.split == declared.split or not declared.partners else None
    split = split if known.partners else declared.split
    partners = {**known.partners, **declared.partners}
    met = known.model_copy(update={"partners": partners, "split": split, "source": "declared"})
    return dataclasses.replace(member, met=met)


def _reason(met: Met) -> str:
    if met.split is not None:
        return f"the training side of {shorten(met.split.split)}"
    return "as its file claims" if met.source == "file" else "as declared"
