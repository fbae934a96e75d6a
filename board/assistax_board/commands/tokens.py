"""Who may use a service."""

import dataclasses
import sys
from pathlib import Path
from typing import Literal

from assistax_board.commands.opening import open_folder, print_answer


def token_create(
    *scopes: Literal["submit", "work", "organise"],
    data: Path,
    submitter: str | None = None,
    contact: str | None = None,
    webhook: str | None = None,
    label: str = "",
    database: str | None = None,
) -> None:
    """Make a token and print it; it is shown only once.

    Args:
        scopes: What it may do.
        data: Folder of the service.
        submitter: Lab that submits with it; made if it is new.
        contact: How to reach a new lab.
        webhook: Address to which the lab's ended submissions are posted from now on; its secret is
            printed on standard error. '' ends that.
        label: For `token list`.
        database: URL, if it is not in the folder.

    Example:
        assistax-zoo token create submit --submitter 'Lab of Ada' --data my-board
    """
    from assistax_board.rules.telling import set_webhook
    from assistax_board.work.webhook import check_address, lab_secret

    check_address(webhook or None)
    if webhook is not None and not submitter:
        raise ValueError("a webhook is a lab's; name the lab with --submitter")
    service = open_folder(data, database)
    options = {"submitter": submitter, "contact": contact, "label": label}
    print(service.create_token(scopes, **options))
    if webhook is not None and submitter:
        lab = set_webhook(service.database, submitter, webhook or None, service.clock())
        print(f"secret of its webhook: {lab_secret(service, lab)}", file=sys.stderr)


def token_list(*, data: Path, database: str | None = None, json: bool = False) -> None:
    """List the tokens, without their secrets.

    Args:
        data: Folder of the service.
        database: URL, if it is not in the folder.
        json: Print JSON.

    Example:
        assistax-zoo token list --data my-board
    """
    from assistax_board.rules.tokens import list_tokens

    tokens = list_tokens(open_folder(data, database).database)
    print_answer([dataclasses.asdict(token) for token in tokens], json)


def token_revoke(id: str, /, *, data: Path, database: str | None = None) -> None:
    """Make a token invalid.

    Args:
        id: As `token list` shows it.
        data: Folder of the service.
        database: URL, if it is not in the folder.

    Example:
        assistax-zoo token revoke 7kq2mz4a --data my-board
    """
    from assistax_board.rules.tokens import revoke_token

    service = open_folder(data, database)
    revoke_token(service.database, service.clock(), id)
