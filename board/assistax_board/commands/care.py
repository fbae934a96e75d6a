"""Commands that care for a service's data."""

import tempfile
from pathlib import Path

from assistax_base.errors import printable
from assistax_board.commands.opening import open_client, open_folder, print_answer
from assistax_zoo.commands.options import Source
from assistax_zoo.shell.console import answer, stdout_is_data
from zoo.registry import load_registry


def ledger_verify(*, url: str | None = None, json: bool = False) -> None:
    """Check that a server's ledger is an unbroken chain, and print its end.

    Keep the output: if a later ledger has another hash at this number, it was changed.

    Args:
        url: Address of the server; default $ASSISTAX_ZOO_SERVER, else this machine's.
        json: Print JSON.

    Example:
        assistax-zoo ledger verify --url https://board.example.org
    """
    from assistax_board.checking import check_ledger

    print_answer(check_ledger(open_client(url, None)), json)


def service_check(
    *,
    data: Path | None = None,
    backup: Path | None = None,
    json: bool = False,
) -> None:
    """Check that a service's data are whole: database, ledger, artefacts and receipts.

    It counts the organiser's notices too; `service notices` lists them.

    Args:
        data: Folder of the service.
        backup: A backup to check instead: it is restored to a temporary folder.
        json: Print JSON.

    Example:
        assistax-zoo service check --data my-board
    """
    from assistax_board.checking import check_service
    from assistax_board.store.backup import restore

    if backup is None and data is not None:
        print_answer(check_service(open_folder(data)), json)
    elif backup is not None and data is None:
        with tempfile.TemporaryDirectory() as folder:
            restored = Path(folder) / "board"
            restore(backup, restored)
            print_answer(check_service(open_folder(restored)), json)
    else:
        raise ValueError("give --data with a service's folder, or --backup with a backup's file")


def service_backup(target: Path, /, *, data: Path) -> None:
    """Write a service's folder to one file, while it runs.

    Args:
        target: File to write.
        data: Folder of the service.

    Example:
        assistax-zoo service backup my-board.zip --data my-board
    """
    from assistax_board.store.backup import back_up

    print(f"{target} has the database, the key and {back_up(data, target)} artefacts")


def service_restore(source: Path, /, *, data: Path) -> None:
    """Write a backup to a new folder. It has no tokens in clear, the organiser's neither.

    Args:
        source: The backup.
        data: Folder to make.

    Example:
        assistax-zoo service restore my-board.zip --data my-board2
    """
    from assistax_board.store.backup import restore

    restore(source, data)
    print(f"{data} has the board of {source}; tokens are valid as they were then")
    print(
        "no backup has the organiser's token: use yours, or make another by `assistax-zoo token "
        f"create organise submit --submitter organiser --data {data}`"
    )


def service_move(*, data: Path, to: str) -> None:
    """Move a board to another database: from SQLite to PostgreSQL, or back.

    Stop its server before. All rows are copied and compared, then the folder takes the new address.
    If anything fails, the board stays where it is. The database before is kept as it was.

    Args:
        data: Folder of the service.
        to: URL of a new database, such as postgresql://user@host/name.

    Example:
        assistax-zoo service move --to postgresql://zoo@db.example.org/board --data my-board
    """
    from assistax_board.serve import only_server
    from assistax_board.store.migrations.moving import move_board

    service = open_folder(data)
    before = service.database.url.render_as_string()
    with only_server(data):
        count = move_board(data, service.database, to)
    print(f"the board of {data} is moved: {count} rows, all compared; all commands find it there")
    print(f"{before} has its rows too; remove it when you like")


def service_erase(submitter: str, /, *, data: Path) -> None:
    """Erase a lab: name, contact, method names, files and films; hashes and scores stay.

    Args:
        submitter: Name of the lab.
        data: Folder of the service.

    Example:
        assistax-zoo service erase 'Lab of Ada' --data my-board
    """
    from assistax_board.pages.videos import FILMS_FOLDER, erase_robots
    from assistax_board.rules.tokens import submitter_id

    service = open_folder(data)
    service.erase_submitter(submitter_id(service.database, submitter))
    erase_robots(data / FILMS_FOLDER)


def service_people(
    folder: Path | None = None,
    /,
    *,
    data: Path,
    withdraw: str | None = None,
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Accept logs of people, for the column "with people" of the boards of gentle tasks.

    Each log is played again; those that do not fit their episodes are refused. The ledger records
    the figures of each row and the logs' hashes; the logs themselves stay with you. An acceptance
    takes the place of an earlier one of the same task, so accept anew what is left once somebody
    withdraws. No log proves that a person played: accept those that you collected.

    Args:
        folder: Logs that the page saved; a subfolder holds those of one person, named by a code.
        data: Folder of the service.
        withdraw: Task whose figures with people leave the board, in place of logs.
        source: Where robots come from.
        json: Print JSON.

    Example:
        assistax-zoo service people logs --data my-board
    """
    from assistax_board.robots.people import accept_people, withdraw_people

    if (folder is None) == (withdraw is None):
        raise ValueError("give a folder of logs, or --withdraw and a task")
    service = open_folder(data)
    if folder is None:
        withdraw_people(service, str(withdraw))
        answer(json, {"withdrawn": withdraw}, f"the board of {withdraw} has no column of people")
        return
    with stdout_is_data():
        accepted = accept_people(service, folder, load_registry(source.registry))
    refused = {str(one.path): one.why for one in (*accepted.refused, *accepted.left_out)}
    lines = [f"not accepted: {path}: {why}" for path, why in refused.items()]
    lines += [
        f"{body['task']}, {name}: {row['people']} people, {row['episodes']} episodes, caring "
        f"success {row['caring_success']:.0%}"
        for body in accepted.tasks
        for name, row in body["methods"].items()
    ]
    answer(json, {"accepted": accepted.tasks, "not_accepted": refused}, *map(printable, lines))
