"""Partners of a job that its robots met in training, and that figures therefore leave out.

M_test counts partners that are new to a robot, M_train counts its training partners. So a human
that learned together with a robot counts on no side. A frozen training partner counts on the
training side only.
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
    """A summary's record of training partners."""

    known: bool  # whether the training partners of all robots are known
    source: str  # "registry", "file", "declared", "not known", or several joined by ", "
    left_out: tuple[str, ...]  # partners that no figure counts


@dataclasses.dataclass(frozen=True)
class MetPartners:
    """Partners of a job, by id, that its robots met in training."""

    sources: tuple[str, ...]  # sources of the records, in alphabetical order
    own: frozenset[str] = frozenset()  # humans that learned together with one of the robots
    frozen: frozenset[str] = frozenset()  # frozen training partners of at least one robot
    by_all: frozenset[str] = frozenset()  # frozen training partners of every robot
    reasons: tuple[str, ...] = ()  # origins of the frozen partners, such as a split's side
    unknown: tuple[str, ...] = ()  # robots without a record, each with the reason

    @property
    def known(self) -> bool:
        """Whether every robot has a record of its training partners."""
        return "not known" not in self.sources

    def summary(self, left_out: Sequence[str]) -> MetSummary:
        """Return the summary's record, with the partners that are left out."""
        return MetSummary(self.known, ", ".join(self.sources), tuple(left_out))

    def left_out(self, partners: Mapping[str, str | None]) -> list[str]:
        """Return the partners that figures leave out; `partners` maps each to its side."""
        return [
            name
            for name, side in partners.items()
            if name in self.own or (name in self.frozen and side != "train")
        ]


NOTHING_KNOWN = MetPartners(("not known",))


def declare(
    egos: Roster, registry: Registry, task: str, trained_with: str | Sequence[str] | None
) -> Roster:
    """Return the robots with the training partners that the user declares added to their records.

    Args:
        egos: The robots, all trained alike.
        registry: The registry in which the partners are looked up.
        task: The partners' task.
        trained_with: See `zoo.met.claims.declared_met`; None declares nothing.

    Raises:
        ValueError: It is malformed, or is "nobody" although a robot has recorded partners.
        ZooError: There is no such split or partner.
    """
    if not trained_with:
        return egos
    declared = declared_met(registry, task, trained_with)
    members = {name: _declared(member, declared) for name, member in egos.members.items()}
    return dataclasses.replace(egos, members=members)


def met_partners(egos: Roster, partners: Iterable[PolicyEntry]) -> MetPartners:
    """Return the partners that the robots met, matched by the human's sha256 or its team."""
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
    """Return the manifest's fields: the user's declaration, and the record of each robot by id.

    Partners that are a split's training side are not listed one by one.
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
    """Return the partners of an episode table that figures leave out, in the table's order.

    These are the partners in `met`, and humans of the teams of the table's robots.
    """
    robots = set(table["ego_team"].drop_nulls())
    partners = table.select("partner", "partner_team", "side").unique(maintain_order=True)
    left = set(met.left_out(dict(partners.select("partner", "side").rows())))
    return [name for name, team, _ in partners.rows() if name in left or team in robots]


def check_new(
    sides: Mapping[str, str | None], left: Sequence[str], include_own: bool = False
) -> None:
    """Check that at least one partner is left for the figures.

    Args:
        sides: The sides of all partners, by id.
        left: The partners that are left out.
        include_own: Whether figures count those partners too.

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
    """Return notes on training partners of a table's robots, and on the sources of the records."""
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
    """Return notes on robots without a record, and on records that were not checked."""
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
    """Return the note on a matrix's columns that are frozen training partners of an ego."""
    if not met.frozen:
        return []
    names = listing(sorted(met.frozen), 3)
    return [
        f"{len(met.frozen)} partners were frozen partners of an ego in its training "
        f"({'; '.join(met.reasons)}) and count as cross-play: {names}"
    ]


def both_met(*results: tuple[MetSummary | None, pl.DataFrame]) -> MetSummary:
    """Return the record of a comparison, which leaves out partners that any method leaves out.

    Args:
        results: Each method's record in its summary, and its episode table. A method without a
            record leaves out its teams' own humans.
    """
    methods = [
        record or NOTHING_KNOWN.summary(left_out(table, NOTHING_KNOWN)) for record, table in results
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
    """Return the note on partners of the training side that not every robot met in training."""
    left = set(left_out(table, met))
    played = set(table.filter(side="train")["partner"].unique()) - left
    if not met.reasons or played <= met.by_all:
        return []
    return [
        f"M_train: {len(played & met.by_all)} of {len(played)} partners of the training side were "
        f"met in training by every ego ({'; '.join(met.reasons)}), the others are new"
    ]


def _declared(member: Member, declared: Met) -> Member:
    """Return a robot's member with declared training partners added to the recorded ones."""
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
