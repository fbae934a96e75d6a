"""Commands of an organiser on submissions, labs and seasons."""

import dataclasses
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from assistax_base.errors import counted
from assistax_board.clock import date_of, seconds_of
from assistax_board.commands.opening import open_folder, print_answer
from assistax_board.store.shown import Season


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
            "last": date_of(notice.last_at),
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
    """Let an open season close later than was announced, or set the date of a draft.

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


def season_list(*, data: Path, json: bool = False) -> None:
    """List all seasons, the newest first; drafts too, which the organiser alone sees.

    Args:
        data: Folder of the service.
        json: Print JSON.

    Example:
        assistax-zoo season list --data my-board
    """
    rows = [_described(season) for season in open_folder(data).queries.seasons(drafts=True)]
    if not rows and not json:
        print("there is no season; `assistax-zoo season create` makes one")
    else:
        print_answer(rows, json)


def season_show(name: str, /, *, data: Path, json: bool = False) -> None:
    """Show a season: its dates, its hidden partners, its root, and each lab's attempts.

    Args:
        name: Name or id of the season.
        data: Folder of the service.
        json: Print JSON.

    Example:
        assistax-zoo season show spring --data my-board
    """
    from assistax_board.problems import Problem
    from assistax_board.store.played import partners_in_words

    queries = open_folder(data).queries
    season = queries.season(name, drafts=True)
    if season is None:
        raise Problem("not_found", f"no season {name!r}; `assistax-zoo season list` shows them")
    labs = {row.submitter: row for row in queries.attempts(season.id)}
    attempts = {
        name: f"{row.spent} made, {row.reserved} under way, {row.left} left"
        for name, row in labs.items()
    }
    hidden = {"hides": partners_in_words(season.hidden), "root": season.root}
    answer = {**_described(season), **hidden, "rules": season.rules}
    if json:
        print_answer(answer | {"labs": attempts}, json)
    else:
        answer |= attempts
        print_answer({name: value for name, value in answer.items() if value is not None}, json)


def season_delete(name: str, /, *, data: Path) -> None:
    """Delete a draft and the copy of its partners; a season that was opened stays.

    Args:
        name: Name or id of the season.
        data: Folder of the service.

    Example:
        assistax-zoo season delete spring --data my-board
    """
    open_folder(data).delete_draft(name)
    print(f"the draft {name} is deleted; nobody saw it")


def _described(season: Season) -> dict[str, Any]:
    dates = {"opened": season.opened_at, "closes": season.closes_at, "closed": season.closed_at}
    return {
        **{name: getattr(season, name) for name in ("name", "id", "task", "state", "budget")},
        "partners": f"A {season.panel_sizes['A']}, B {season.panel_sizes['B']}",
        **{name: None if at is None else date_of(at) for name, at in dates.items()},
    }
