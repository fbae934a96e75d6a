"""Commands for the tokens of a service's users."""

import dataclasses
from pathlib import Path
from typing import Literal

from assistax_board.clock import date_of
from assistax_board.commands.opening import open_folder, print_answer


def token_create(
    *scopes: Literal["submit", "work", "organise"],
    data: Path,
    submitter: str | None = None,
    contact: str | None = None,
    label: str = "",
) -> None:
    """Make a token and print it; it is shown only once.

    Args:
        scopes: What it may do.
        data: Folder of the service.
        submitter: Lab that submits with it; made if it is new.
        contact: How to reach a new lab.
        label: For `token list`.

    Example:
        assistax-zoo token create submit --submitter 'Lab of Ada' --data my-board
    """
    options = {"submitter": submitter, "contact": contact, "label": label}
    print(open_folder(data).create_token(scopes, **options))


def token_list(*, data: Path, json: bool = False) -> None:
    """List the tokens, without their secrets.

    Args:
        data: Folder of the service.
        json: Print JSON.

    Example:
        assistax-zoo token list --data my-board
    """
    from assistax_board.rules.tokens import list_tokens

    tokens = list_tokens(open_folder(data).database)
    rows = [dataclasses.asdict(token) for token in tokens]
    for row in rows:
        for name in ("created_at", "revoked_at"):
            row[name] = date_of(row[name]) if row[name] is not None else None
    print_answer(rows, json)


def token_revoke(id: str, /, *, data: Path) -> None:
    """Make a token invalid.

    Args:
        id: As `token list` shows it.
        data: Folder of the service.

    Example:
        assistax-zoo token revoke 7kq2mz4a --data my-board
    """
    from assistax_board.rules.tokens import revoke_token

    service = open_folder(data)
    with service.begin() as transaction:
        revoke_token(transaction, id)
