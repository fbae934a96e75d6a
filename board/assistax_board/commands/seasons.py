"""Seasons, for their organiser."""

import contextlib
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path

from assistax_base.errors import counted
from assistax_board.clock import seconds_of
from assistax_board.commands.opening import open_folder


def season_plan(
    plan: Path,
    /,
    *,
    out: Path,
    task: str | None = None,
    release: str | None = None,
    teams: int | None = None,
) -> None:
    """Write a private plan: the teams of a public plan, with secret seeds.

    `train population` trains and publishes it to a private release. The plan, the runs or the
    registry give access to the partners: keep all of them out of repositories and shared folders.

    Args:
        plan: Public plan, such as zoo/plans/paper.json.
        out: File to write, readable by its owner only; an existing file is never overwritten.
        task: Only the groups of this task; default all.
        release: Name of the private release, such as v3; default the plan's.
        teams: At most so many, by fewer seeds in every group; default as many as the plan has.

    Example:
        assistax-zoo season plan zoo/plans/paper.json --task scratch --out private/plan.json
    """
    from assistax_workshop.plans.plan import private_plan, read_plan, write_private_plan

    private = private_plan(read_plan(plan), task, release, teams)
    write_private_plan(private, out)
    count = sum(len(group.members) for group in private.groups)
    print(
        f"{out} has {counted(count, 'team')}; keep it secret, since it is all one needs to train "
        "them"
    )


def season_persons(
    folder: Path, /, *, task: str, count: int = 200, family: str | None = None
) -> None:
    """Let a private release hide persons that follow from a new secret.

    They are the whole release if the folder is new; in the folder of trained partners they stand
    beside these. Nothing is trained or stored of them: whoever has the folder's registry has them.

    Args:
        folder: Folder of the private release.
        task: Gentle task.
        count: How many persons; half of them are panel A, half panel B.
        family: A family of your own for a third of them: its name in a package that is installed
            here and where workers run. Its files' sha256 is committed to; they are revealed when
            the season closes.

    Example:
        assistax-zoo season persons private --task gentle_scratch --count 200
    """
    from assistax_board.rules.release_pack import add_persons

    path = add_persons(folder, task, count, family)
    mine = f", a third of them of the family {family}" if family else ""
    print(f"{path} hides {count} persons{mine}; keep it secret: it is all one needs to draw them")


def season_create(
    name: str,
    /,
    *,
    data: Path,
    task: str,
    release: Path,
    budget: int = 20,
    rules: Path | None = None,
    small: bool = False,
) -> None:
    """Make a season of a private release; it is not visible yet.

    Args:
        name: Name of the season.
        data: Folder of the service.
        task: Task.
        release: Folder of the private release: its registry.json and shards.
        budget: Attempts of each lab.
        rules: File with the season's rules; default those of docs/service.md.
        small: Allow a panel B of fewer than 60 partners.

    Example:
        assistax-zoo season create spring --task scratch --release private --data my-board
    """
    from assistax_board.rules import seasons
    from assistax_board.store.played import partners_in_words
    from zoo.registry import load_registry

    text = seasons.DEFAULT_RULES if rules is None else rules.read_text(encoding="utf-8")
    plan = seasons.Plan(name, task, budget, text, small)
    service = open_folder(data)
    id = service.create_season(plan, release, load_registry())
    season = service.queries.season(id, drafts=True)
    hidden = season.hidden if season else None
    print(f"season {name} is made, id {id}: it hides {partners_in_words(hidden)}")
    print("nobody sees it until you open it: `assistax-zoo season open`")


def season_open(name: str, /, *, data: Path, closes: datetime | None = None) -> None:
    """Publish a season's Merkle root and its closing date, and let labs submit; print the root.

    Args:
        name: Name or id of the season.
        data: Folder of the service.
        closes: When it closes by itself, in UTC if no zone is given; default in 90 days.

    Example:
        assistax-zoo season open spring --closes 2026-12-01T12:00 --data my-board
    """
    service = open_folder(data)
    root = service.open_season(name, seconds_of(closes) if closes else None)
    print(f"season {name} is open; announce its Merkle root: {root}")
    opened = service.queries.season(name)
    date = datetime.fromtimestamp(opened.closes_at, UTC) if opened and opened.closes_at else None
    print(f"it closes by itself at {date:%Y-%m-%d %H:%M} UTC")


def season_close(name: str, /, *, data: Path) -> None:
    """Close a season early: workers play all submissions, then panel B; all is revealed.

    Args:
        name: Name or id of the season.
        data: Folder of the service.

    Example:
        assistax-zoo season close spring --data my-board
    """
    open_folder(data).close_season(name)
    print(f"season {name} is closing: nothing more is taken, and panel B is played")


def season_rehearse(
    *,
    task: str = "gentle_scratch",
    data: Path | None = None,
    registry: Path | None = None,
    minutes: float = 1.0,
) -> None:
    """Rehearse a whole tiny season on this machine, in nine stages, and print each step.

    Trains tiny teams, draws hidden persons of a gentle task, serves, lets two labs hand in files,
    closes by date, reveals and proves. Meanwhile it fills the board's disk, upgrades the server and
    rolls it back, moves the board to PostgreSQL and back, and kills the server. What this machine
    cannot do is left out, and said.

    Args:
        task: Task.
        data: Folder to make and keep; default a temporary one.
        registry: Registry of the public partners, which takes longer; default tiny ones.
        minutes: How long the season stays open after all was tried.

    Example:
        assistax-zoo season rehearse --data rehearsal
    """
    from assistax_board.rehearsal.season import rehearse
    from assistax_board.rehearsal.stage import Stage

    if data is not None and data.exists():
        raise ValueError(f"{data} exists; name a new folder")
    began = time.monotonic()
    with contextlib.ExitStack() as stack:
        folder = data or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for line in rehearse(Stage(folder, task, registry, open_seconds=60 * minutes)):
            print(f"{time.monotonic() - began:4.0f} s  {line}", flush=True)
