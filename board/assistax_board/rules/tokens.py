"""Tokens with their scopes. The database holds only hashes; tokens travel in headers alone."""

import dataclasses
import secrets
from collections.abc import Sequence

import sqlalchemy as sa

from assistax_base.digest import sha256
from assistax_board.ids import new_id
from assistax_board.problems import Problem
from assistax_board.store import schema
from assistax_board.store.database import Database, Transaction
from assistax_board.store.schema import SUBMITTER, TOKEN
from assistax_board.vocabulary import SCOPES, Scope

PREFIX = "azt_"  # so that scanners of leaked secrets can know one


@dataclasses.dataclass(frozen=True)
class Principal:
    """Owner and scopes of a valid token."""

    token: str  # its id
    scopes: tuple[Scope, ...]
    submitter: str | None  # id


@dataclasses.dataclass(frozen=True)
class TokenInfo:
    """Description of a token, without its secret."""

    id: str
    label: str
    scopes: tuple[Scope, ...]
    submitter: str | None  # name
    created_at: float
    revoked_at: float | None


def create_token(
    transaction: Transaction,
    scopes: Sequence[Scope],
    *,
    label: str = "",
    submitter: str | None = None,
    contact: str | None = None,
) -> str:
    """Make a token and return it: the only time that it is seen.

    Args:
        transaction: In which it is made.
        scopes: What it may do.
        label: For the organiser's list.
        submitter: Name of the lab that submits with it; made if it is new.
        contact: Of a new lab, such as an address for questions.
    """
    if not scopes or set(scopes) - set(SCOPES):
        raise Problem("invalid", f"scopes {list(scopes)}: give some of {', '.join(SCOPES)}")
    if "submit" in scopes and not submitter:
        raise Problem("invalid", "a token that submits needs the name of a submitter")
    token = PREFIX + secrets.token_urlsafe(32)
    owner = find_or_add(transaction, submitter, contact) if submitter else None
    row = {
        "id": new_id(8),
        "sha256": sha256(token.encode()),
        "scopes": list(scopes),
        "submitter": owner,
        "label": label,
        "created_at": transaction.now,
    }
    transaction.execute(sa.insert(schema.tokens).values(row))
    return token


def authenticate(database: Database, token: str) -> Principal:
    """Return the principal of a token.

    Raises:
        Problem: It is unknown or was revoked; which of the two is not told.
    """
    with database.read() as connection:
        query = sa.select(schema.tokens).where(
            TOKEN.sha256 == sha256(token.encode()), TOKEN.revoked_at.is_(None)
        )
        row = connection.execute(query).first()
    if row is None:
        raise Problem("not_signed_in", "this token is not valid; ask the organiser for one")
    return Principal(row.id, tuple(row.scopes), row.submitter)


def revoke_token(transaction: Transaction, token_id: str) -> None:
    """Make a token invalid from now on."""
    where = (TOKEN.id == token_id) & TOKEN.revoked_at.is_(None)
    changed = transaction.execute(
        sa.update(schema.tokens).where(where).values(revoked_at=transaction.now)
    )
    if not changed.rowcount:
        raise Problem("not_found", f"no valid token {token_id!r}; `token list` shows them")


def list_tokens(database: Database) -> list[TokenInfo]:
    """Return every token, the oldest first."""
    query = (
        sa.select(schema.tokens, SUBMITTER.name)
        .outerjoin(schema.submitters, SUBMITTER.id == TOKEN.submitter)
        .order_by(TOKEN.created_at)
    )
    with database.read() as connection:
        return [
            TokenInfo(r.id, r.label, tuple(r.scopes), r.name, r.created_at, r.revoked_at)
            for r in connection.execute(query)
        ]


def submitter_id(database: Database, name: str) -> str:
    """Return the id of the lab of this name."""
    with database.read() as connection:
        owner = connection.execute(sa.select(SUBMITTER.id).where(SUBMITTER.name == name)).scalar()
    if owner is None:
        raise Problem("not_found", f"no submitter {name!r}")
    return owner


def find_or_add(transaction: Transaction, name: str, contact: str | None) -> str:
    """Return the id of the lab of this name, which is made if it is new."""
    owner = transaction.execute(sa.select(SUBMITTER.id).where(SUBMITTER.name == name)).scalar()
    if owner is not None:
        return owner
    row = {"id": new_id(), "name": name, "contact": contact, "created_at": transaction.now}
    transaction.execute(sa.insert(schema.submitters).values(row))
    return row["id"]
