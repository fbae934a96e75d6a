"""Commands of a lab on its own submissions."""

import contextlib
from pathlib import Path

from assistax_board.clock import date_of
from assistax_board.commands.opening import open_client, print_answer

_FIELDS = ("id", "state", "reason", "attempt", "task", "method", "season")


def submission_list(
    *,
    season: str | None = None,
    url: str | None = None,
    token_file: Path | None = None,
    json: bool = False,
) -> None:
    """List your submissions, the newest first.

    Args:
        season: Only those of this season; default all.
        url: Address of the server; default $ASSISTAX_ZOO_SERVER, else this machine's.
        token_file: File with your token; default the token in $ASSISTAX_ZOO_TOKEN.
        json: Print JSON, with all fields.

    Example:
        assistax-zoo submission list --season spring
    """
    with contextlib.closing(open_client(url, token_file)) as client:
        rows = client.mine(season)
    if json:
        print_answer(rows, json)
    elif not rows:
        print("you have handed in nothing" + (f" in season {season}" if season else ""))
    else:
        print_answer(
            [
                {name: row[name] for name in _FIELDS} | {"handed in": date_of(row["created_at"])}
                for row in rows
            ],
            json,
        )


def submission_withdraw(
    id: str, /, *, url: str | None = None, token_file: Path | None = None, json: bool = False
) -> None:
    """Take a submission back.

    One that waits or is played ends; its attempt comes back unless it met hidden partners. One that
    was scored leaves its board; its score, attempt and receipt stay known.

    Args:
        id: As `submission list` shows it.
        url: Address of the server; default $ASSISTAX_ZOO_SERVER, else this machine's.
        token_file: File with your token; default the token in $ASSISTAX_ZOO_TOKEN.
        json: Print JSON, with all fields.

    Example:
        assistax-zoo submission withdraw 7kq2mz4a
    """
    with contextlib.closing(open_client(url, token_file)) as client:
        row = client.withdraw(id)
    shown = {name: row[name] for name in _FIELDS if row[name] is not None}
    print_answer(row if json else shown, json)
