"""Seasons: a private release is committed to, played against, and revealed.

    draft -> open -> closing -> closed

Opening publishes a Merkle root over salted leaves: partners, panels and seeds, and when it closes.
`closing` plays panel B, then publishes leaves and weights, and everybody can check that they were
the ones.
"""

import dataclasses
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa

from assistax_base.digest import leaf_sha256, merkle_root
from assistax_board.clock import date_of
from assistax_board.ids import new_id
from assistax_board.problems import Problem
from assistax_board.rules.closing import find_season
from assistax_board.rules.release_pack import (
    check_program,
    hidden_partners,
    hidden_persons,
    ordinal,
    own_families,
    pack,
    revealed_program,
    secret_persons,
    unpack,
)
from assistax_board.store import schema
from assistax_board.store.artefacts import Artefacts, record_artefact
from assistax_board.store.database import Database, Transaction
from assistax_board.store.played import describe_partners
from assistax_board.store.schema import SEASON

if TYPE_CHECKING:
    from assistax_board.service import Service
    from zoo.registry import Registry
    from zoo.schema import PolicyEntry

OPEN_SECONDS = 90 * 86_400.0  # of a season whose closing date is not given
MAX_OPEN_SECONDS = 3 * 366 * 86_400.0
ENOUGH_IN_B = 60  # partners, so that panel B's interval is narrow enough to name a winner
DEFAULT_RULES = (
    "One lab, one name. Train on public partners as you like: the public half may be trained with. "
    "Scores on panel A are shown when "
    "they beat your last shown one beyond chance; panel B decides, once, when the season closes. "
    "A place needs a declared entry, and an entry plays whole. "
    "Files are kept for the season and used for scoring alone, unless their licence says more."
)


@dataclasses.dataclass(frozen=True)
class Plan:
    """An organiser's plan of a season."""

    name: str
    task: str
    budget: int = 20  # attempts of each lab
    rules: str = DEFAULT_RULES
    small: bool = False  # allow fewer than `ENOUGH_IN_B` partners in panel B


def create_season(service: "Service", plan: Plan, folder: Path, public: "Registry") -> str:
    """Make a season of the private release in a folder, and return its id.

    Raises:
        Problem: The release has too few partners, or one of the public ones.
    """
    packed = pack(folder)
    from zoo.registry import load_registry

    private = load_registry(folder / "registry.json")
    entries = hidden_partners(private, plan.task)
    known = {entry.sha256 for entry in public.policies}
    if shared := [entry.id for entry in entries if entry.sha256 in known]:
        raise Problem("invalid", f"{shared[0]} is public; a private release has only new partners")
    leaves = _leaves(entries, hidden_persons(private, plan.task))
    sizes = {panel: sum(leaf.get("panel") == panel for leaf in leaves) for panel in ("A", "B")}
    if min(sizes.values()) < 2 or (sizes["B"] < ENOUGH_IN_B and not plan.small):
        raise Problem(
            "invalid",
            f"panels of {sizes['A']} and {sizes['B']} partners; panel B needs {ENOUGH_IN_B} for a "
            "useful interval: train more, or plan a small season",
            remedy="allow small",
        )
    row = {
        "id": new_id(),
        "name": plan.name,
        "task": plan.task,
        "state": "draft",
        "budget": plan.budget,
        "rules": plan.rules,
        "release": service.artefacts.put(packed),
        "secret": {"leaves": leaves},
        "panel_sizes": sizes,
        "hidden": describe_partners(private, entries),
    }
    with service.begin() as transaction:
        if transaction.execute(sa.select(SEASON.id).where(SEASON.name == plan.name)).first():
            raise Problem("conflict", f"there is a season {plan.name!r}; choose another name")
        _check_unseen(transaction, row["id"], leaves)
        record_artefact(transaction, row["release"], len(packed))
        transaction.execute(sa.insert(schema.seasons).values(row | {"created_at": transaction.now}))
    return row["id"]


def open_season(transaction: Transaction, name: str, closes_at: float | None = None) -> str:
    """Publish the Merkle root and the closing date, and let labs submit; return the root.

    Args:
        transaction: In which the opening is recorded.
        name: Name or id of the season.
        closes_at: When it closes by itself; if not given the draft's date, or `OPEN_SECONDS` from
            now.

    Raises:
        Problem: There is no such draft, or the date is not ahead.
    """
    row = find_season(transaction, name, "draft")
    planned = row.closes_at or transaction.now + OPEN_SECONDS
    closes_at = planned if closes_at is None else closes_at
    check_date(transaction, closes_at)
    _check_unseen(transaction, row.id, row.secret["leaves"])
    check_program(row.name, row.secret["leaves"])
    root = merkle_root(map(leaf_sha256, row.secret["leaves"]))
    values = {"state": "open", "root": root, "opened_at": transaction.now, "closes_at": closes_at}
    transaction.execute(sa.update(schema.seasons).where(SEASON.id == row.id).values(values))
    body = {"season": row.id, "name": row.name, "task": row.task, "root": root}
    body |= {"panel_sizes": row.panel_sizes, "budget": row.budget, "closes_at": closes_at}
    transaction.record("season_open", body)
    return root


def check_date(transaction: Transaction, closes_at: float) -> None:
    """Refuse a closing date that is past, or too far ahead.

    Raises:
        Problem: It is.
    """
    now, last = transaction.now, transaction.now + MAX_OPEN_SECONDS
    if not now < closes_at < last:
        when = "past" if closes_at <= now else "more than three years ahead"
        raise Problem(
            "invalid",
            f"the closing date {date_of(closes_at)} is {when}; give one from {date_of(now)} to "
            f"{date_of(last)}",
        )


def revealed(database: Database, name: str) -> dict[str, Any]:
    """Return the statement of a closed season: root, leaves with salts, and release.

    Raises:
        Problem: It is not closed; nothing of it is told before.
    """
    with database.read() as connection:
        query = sa.select(schema.seasons).where((SEASON.id == name) | (SEASON.name == name))
        row = connection.execute(query).first()
    if row is None or row.state == "draft":
        raise Problem("not_found", f"no season {name!r}")
    if row.state != "closed":
        raise Problem(
            "too_late",
            f"season {row.name} is {row.state}; its partners are revealed, and can be verified, "
            "when it has closed",
        )
    statement = {"season": row.id, "name": row.name, "task": row.task, "root": row.root}
    return {**statement, "release": row.release, "leaves": row.secret["leaves"]}


def revealed_release(database: Database, artefacts: Artefacts, name: str) -> bytes:
    """Return the packed release of a closed season."""
    return artefacts.get(revealed(database, name)["release"])


def verify_season(statement: dict[str, Any], packed: bytes, root: str, folder: Path) -> int:
    """Prove that a revealed release is the one whose root was published; return its partners.

    Args:
        statement: What `revealed` returned.
        packed: The release that it names.
        root: As it was published when the season opened: from the ledger, or a receipt's copy.
        folder: Empty, to unpack to.

    Raises:
        ValueError: Something differs.
    """
    if merkle_root(map(leaf_sha256, statement["leaves"])) != root:
        raise ValueError("the leaves are not those whose root was published when it opened")
    registry = unpack(packed, folder)
    entries = hidden_partners(registry, statement["task"])
    partners = [leaf for leaf in statement["leaves"] if "policy" in leaf]
    if [(leaf["policy"], leaf["sha256"]) for leaf in partners] != [
        (e.id, e.sha256) for e in entries
    ]:
        raise ValueError("the release holds other partners than the leaves say")
    if secret_persons(statement["leaves"]) != hidden_persons(registry, statement["task"]):
        raise ValueError("the release draws its persons from another secret than the leaves say")
    for own in own_families(registry):
        if revealed_program(own, folder) != own.sha256:
            raise ValueError(f"the files of the family {own.name!r} are not those of the leaves")
    from zoo.parameters.storage import load_stacks

    load_stacks(registry, entries)  # hashes of all parameters; rows of persons are drawn anew
    return len(entries)


def panel_partners(leaves: Sequence[dict[str, Any]], panel: str) -> list[str]:
    """Return the ordinals of a panel, in the order in which they are cut into jobs."""
    return [leaf["ordinal"] for leaf in leaves if leaf.get("panel") == panel]


def panel_seed(leaves: Sequence[dict[str, Any]], panel: str) -> str:
    """Return the seed of a panel's episodes, in hex."""
    return next(leaf["seeds"][panel] for leaf in leaves if "seeds" in leaf)


def _check_unseen(transaction: Transaction, id: str, leaves: Sequence[dict[str, Any]]) -> None:
    """Refuse partners of a season that was opened: they are known, or will be when it closes."""
    mine = {leaf["sha256"] for leaf in leaves if "policy" in leaf}
    others = sa.select(SEASON.name, SEASON.secret).where(SEASON.id != id, SEASON.state != "draft")
    for name, secret in transaction.execute(others):
        if any(leaf.get("sha256") in mine for leaf in secret["leaves"] if "policy" in leaf):
            raise Problem(
                "conflict",
                f"partners of this release were in season {name}, which reveals them when it "
                "closes; train a new release (`season plan` draws new seeds)",
            )


def _leaves(entries: Sequence["PolicyEntry"], persons: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a salted leaf for seeds and persons' secrets, then one a partner by its ordinal."""
    panels = _stratify(entries)
    seeds = {panel: secrets.token_hex(16) for panel in ("A", "B")}
    partners = [
        {
            "ordinal": ordinal(index),
            "panel": panels[index],
            "policy": entry.id,
            "sha256": entry.sha256,
            "salt": secrets.token_hex(16),
        }
        for index, entry in enumerate(entries)
    ]
    drawn = {"persons": persons} if persons else {}
    return [{"seeds": seeds, **drawn, "salt": secrets.token_hex(16)}, *partners]


def _stratify(entries: Sequence["PolicyEntry"]) -> list[str]:
    """Deal partners to A and B in turn, shuffled within each algorithm and disability."""
    random = secrets.SystemRandom()
    order = sorted(
        range(len(entries)),
        key=lambda i: (entries[i].algorithm, entries[i].disability, random.random()),
    )
    panels = [""] * len(entries)
    for turn, index in enumerate(order):
        panels[index] = "BA"[turn % 2]
    return panels
