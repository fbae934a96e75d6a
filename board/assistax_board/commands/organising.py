"""Commands of an organiser on submissions, labs and seasons."""

import dataclasses
from datetime import UTC, datetime
from pathlib import Path

from assistax_base.errors import counted
from assistax_board.clock import seconds_of
from assistax_board.commands.opening import open_folder, print_answer


def service_failures(*, data: Path, json: bool = False) -> None:
    """List the submissions of which jobs have failed.

    Args:
        data: Folder of the service.
        json: Print JSON.

    Example:
        assistax-zoo service failures --data my-board
    """
    rows = [dataclasses.asdict(row) for row in open_folder(data).failures()]
    if not rows and not json:
        print("no submission has jobs that failed")
    else:
        print_answer(rows, json)


def service_retry(submission: str, /, *, data: Path, extra_attempt: bool = False) -> None:
    """Queue failed work again: a submission, or its panel B while its season closes.

    What was played stays. A submission of a season uses again the attempt that was given back; if
    its lab has used that attempt since, nothing is queued.

    Args:
        submission: As `service failures` shows it.
        data: Folder of the service.
        extra_attempt: Give the lab an additional attempt if it has none left; the ledger records
            it.

    Example:
        assistax-zoo service retry 7kq2mz4a --data my-board
    """
    open_folder(data).retry(submission, extra_attempt=extra_attempt)


def service_notices(*, data: Path, clear: bool = False, json: bool = False) -> None:
    """List notices for the organiser: failures, errors, a full disk, seasons that closed.

    Args:
        data: Folder of the service.
        clear: Forget them once they are listed.
        json: Print JSON.

    Example:
        assistax-zoo service notices --data my-board
    """
    from assistax_board.store.notices import clear_notices, list_notices

    service = open_folder(data)
    notices = list_notices(service.database)
    rows = [
        {
            "kind": notice.kind,
            "about": notice.about,
            "count": notice.count,
            "last": datetime.fromtimestamp(notice.last_at, UTC).isoformat(timespec="seconds"),
            "text": notice.text,
        }
        for notice in notices
    ]
    if not rows and not json:
        print("no notices: nothing has failed, and no season has closed, since they were cleared")
    else:
        print_answer(rows, json)
    if clear and notices:
        clear_notices(service.database, notices[0].last_at)


def season_disqualify(season: str, lab: str, /, *, data: Path) -> None:
    """Take a lab out of a season: its submissions leave the boards, and it can submit no more.

    Scores and receipts stay known, as those of a withdrawn submission do.

    Args:
        season: Name or id of the season.
        lab: Name of the lab.
        data: Folder of the service.

    Example:
        assistax-zoo season disqualify spring 'Lab of Ada' --data my-board
    """
    count = open_folder(data).disqualify(season, lab)
    print(f"{counted(count, 'submission')} of {lab} left season {season}")


def season_extend(name: str, /, *, closes: datetime, data: Path) -> None:
    """Let an open season close later than was announced.

    Args:
        name: Name or id of the season.
        closes: When it closes by itself, in UTC if no zone is given.
        data: Folder of the service.

    Example:
        assistax-zoo season extend spring --closes 2026-12-15T12:00 --data my-board
    """
    at = seconds_of(closes)
    open_folder(data).extend_season(name, at)
    date = datetime.fromtimestamp(at, UTC)
    print(f"season {name} now closes by itself at {date:%Y-%m-%d %H:%M} UTC")
