"""The commands of the service: parse, call one function, print."""

import functools
import os
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from assistax_zoo.commands.options import Engine
from assistax_zoo.shell.console import print_json

if TYPE_CHECKING:
    from assistax_board.client.client import Client
    from assistax_board.service import Service

SERVER = "http://127.0.0.1:8800"
BACKEND = "fused"  # what a service plays with, if it is told nothing else
SERVER_VARIABLE, TOKEN_VARIABLE = "ASSISTAX_ZOO_SERVER", "ASSISTAX_ZOO_TOKEN"


def serve(
    *,
    data: Path,
    host: str = "127.0.0.1",
    port: int = 8800,
    workers: int = 1,
    database: str | None = None,
    artefacts: str | None = None,
    registry: Path | None = None,
    backend: str = BACKEND,
    references: bool = True,
    proxy: str | None = None,
) -> None:
    """Run the evaluation service: a web server, its data in a folder, and a local worker.

    Prints the organiser's token once, when the folder is new.

    Args:
        data: Folder for the database, the artefacts and the signing key; made if it is new.
        host: Address to listen on; 0.0.0.0 is all, behind a proxy that speaks TLS.
        port: Port to listen on; 0 takes a free one.
        workers: Local worker processes; 0 where all work elsewhere.
        database: URL of a PostgreSQL database instead of SQLite in the folder.
        artefacts: Address of a store instead of the folder, such as s3://bucket/path.
        registry: Registry of the public partners instead of the installed one.
        backend: Backend that plays, the same for every worker.
        references: Play zero and random actions, scripts, published egos and the partners' own
            robots whenever nobody waits: the rows that a board measures by.
        proxy: Address of the proxy before the server, such as 127.0.0.1: whose word is taken for
            where a request comes from; default nobody's.

    Example:
        assistax-zoo serve --data board
    """
    serving = _module("serve")
    serving.check_proxy(proxy)
    with serving.stopped_by_signals():
        service = serving.open_service(
            data, database=database, artefacts=artefacts, registry=registry, backend=backend
        )
        port = serving.free_port(host, port)
        own = serving.worker_token(service, data) if workers else ""
        service.adopt_version()
        if references:
            serving.add_references_later(service)
        address = f"http://{host}:{port}"
        print(f"serving {address} from {data}; Ctrl-C stops", file=sys.stderr, flush=True)
        if token := serving.first_token(service):
            print(f"organiser's token, shown once: {token}", file=sys.stderr, flush=True)
        options = ["--backend", backend, *(["--registry", str(registry)] if registry else [])]
        local = address.replace("0.0.0.0", "127.0.0.1")
        with serving.local_workers(workers, local, own, options) as stop_workers:
            pages = serving.page_folders(data, registry)
            serving.run_server(service, host, port, stop_workers, proxy, **pages)


def worker(
    *,
    url: str | None = None,
    token_file: Path | None = None,
    registry: Path | None = None,
    backend: str = BACKEND,
    until_empty: bool = False,
    engine: Engine = Engine(),
) -> None:
    """Take jobs from a service and play them, until stopped.

    With `--engine ray` there are as many workers as a cluster has room for, each with its own jobs.

    Args:
        url: Address of the server; default $ASSISTAX_ZOO_SERVER.
        token_file: File with a token that may work; default the token in $ASSISTAX_ZOO_TOKEN.
        registry: Registry of the public partners instead of the installed one.
        backend: Backend that plays, the server's.
        until_empty: Stop when nothing waits.
        engine: What runs workers.

    Example:
        assistax-zoo worker --url https://board.example.org --token-file worker-token
    """
    working = _module("work.working_process")
    client, cluster = _client(url, token_file), engine.cluster()
    if cluster is None:
        working.run_worker(client, registry, backend, until_empty=until_empty)
    else:
        make = functools.partial(working.make_scorer, registry, backend)
        working.run_workers_on_ray(cluster, client, make, until_empty=until_empty)


def submit(
    file: Path | None = None,
    /,
    *,
    task: str,
    method: str | None = None,
    season: str | None = None,
    licence: str = "evaluation-only",
    live: str | None = None,
    check: bool = False,
    all: bool = False,
    watch: bool = False,
    url: str | None = None,
    token_file: Path | None = None,
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """Hand a robot in to a service, or check at home what the service will say.

    Args:
        file: The robot: .safetensors of this project, .onnx, or an id of the zoo.
        task: Task, such as scratch.
        method: Name on the board, asked for unless you only check; submissions of one name are
            seeds of one method, and their mean counts.
        season: Season to take part in; default the public board alone.
        licence: What others may do with the file: evaluation-only, or a licence such as MIT.
        live: A robot that stays here instead of a file, such as python:mine:make.
        check: Only check: the server's own admission, and a few episodes with public partners.
        all: With `--check`: play the whole public half as the server does, and print its figures.
        watch: Wait for the end: print place in the queue and time left, then place on the board.
        url: Address of the server; default $ASSISTAX_ZOO_SERVER, else this machine's.
        token_file: File with your token; default the token in $ASSISTAX_ZOO_TOKEN.
        registry: Registry to check with instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo submit robot.onnx --task scratch --check
    """
    if (file is None) == (live is None):
        raise ValueError("give a file, or --live with a robot such as python:mine:make")
    if all and not check:
        raise ValueError("--all is about a check at home; give it with --check")
    submitting = _module("client.submitting")
    if check:
        if file is None:
            raise ValueError("--check is about a file; a live robot is tried with `evaluate`")
        answer = submitting.check_file(file, task, registry, whole=all)
    elif method is None:
        raise ValueError(
            "give --method with a name for the board, such as --method ppo-large; submissions of "
            "one name are seeds of one method, so another robot needs another name"
        )
    else:
        fields = {"task": task, "method": method, "season": season, "licence": licence}
        client = _client(url, token_file)
        answer = submitting.hand_in(client, file, live, fields, watch=watch)
        answer = answer if json else submitting.for_reader(answer, client.address)
    _print(answer, json)


def token_create(
    *scopes: Literal["submit", "work", "organise"],
    data: Path,
    submitter: str | None = None,
    contact: str | None = None,
    label: str = "",
    database: str | None = None,
) -> None:
    """Make a token and print it: the only time that it is seen.

    Args:
        scopes: What it may do.
        data: Folder of the service.
        submitter: Lab that submits with it; made if it is new.
        contact: How to reach a new lab.
        label: For `token list`.
        database: URL, where it is not the folder's.

    Example:
        assistax-zoo token create submit --submitter 'Lab of Ada' --data board
    """
    options = {"submitter": submitter, "contact": contact, "label": label}
    print(_service(data, database).create_token(scopes, **options))


def token_list(*, data: Path, database: str | None = None, json: bool = False) -> None:
    """List the tokens; their secrets are known to nobody but their owners.

    Args:
        data: Folder of the service.
        database: URL, where it is not the folder's.
        json: Print JSON.

    Example:
        assistax-zoo token list --data board
    """
    import dataclasses

    tokens = _module("rules.tokens").list_tokens(_service(data, database).database)
    _print([dataclasses.asdict(token) for token in tokens], json)


def token_revoke(id: str, /, *, data: Path, database: str | None = None) -> None:
    """Make a token invalid.

    Args:
        id: As `token list` shows it.
        data: Folder of the service.
        database: URL, where it is not the folder's.

    Example:
        assistax-zoo token revoke 7kq2mz4a --data board
    """
    service = _service(data, database)
    _module("rules.tokens").revoke_token(service.database, service.clock(), id)


def season_plan(
    plan: Path,
    /,
    *,
    out: Path,
    task: str | None = None,
    release: str | None = None,
) -> None:
    """Write a private plan: a public one's teams, with seeds that nobody can guess.

    `train population` trains and publishes it to a private release. Whoever has the plan, the runs
    or the registry has the partners: keep them out of repositories and shared folders.

    Args:
        plan: Public plan, such as zoo/plans/v2.json.
        out: File to write, for its owner alone; one that exists is never overwritten.
        task: Only the groups of this task; default all.
        release: Name of the private release, such as v3; default the plan's.

    Example:
        assistax-zoo season plan zoo/plans/v2.json --task gentle_scratch --out private/plan.json
    """
    from assistax_workshop.plans.plan import private_plan, read_plan, write_private_plan

    private = private_plan(read_plan(plan), task, release)
    write_private_plan(private, out)
    teams = sum(len(group.members) for group in private.groups)
    print(f"{out} has {teams} teams; keep it secret, since it is all one needs to train them")


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
    database: str | None = None,
    artefacts: str | None = None,
) -> None:
    """Make a season of a private release, which nobody sees yet.

    Args:
        name: Name of the season.
        data: Folder of the service.
        task: Task.
        release: Folder of the private release: its registry.json and shards.
        budget: Attempts of each lab.
        rules: File with the season's rules; default those of docs/service.md.
        small: Allow a panel B of fewer than 60 partners.
        database: URL, where it is not the folder's.
        artefacts: Address, where it is not the folder's.

    Example:
        assistax-zoo season create spring --task scratch --release private --data board
    """
    from zoo.registry import load_registry

    seasons = _module("rules.seasons")
    text = seasons.DEFAULT_RULES if rules is None else rules.read_text(encoding="utf-8")
    plan = seasons.Plan(name, task, budget, text, small)
    service = _service(data, database, artefacts)
    print(service.create_season(plan, release, load_registry()))


def season_open(
    name: str, /, *, data: Path, closes: datetime | None = None, database: str | None = None
) -> None:
    """Publish a season's Merkle root and its closing date, and let labs submit; print the root.

    Args:
        name: Name or id of the season.
        data: Folder of the service.
        closes: When it closes by itself, in UTC if no zone is given; default in 90 days.
        database: URL, where it is not the folder's.

    Example:
        assistax-zoo season open spring --closes 2026-12-01T12:00 --data board
    """
    if closes is not None and closes.tzinfo is None:
        closes = closes.replace(tzinfo=UTC)
    service = _service(data, database)
    print(service.open_season(name, closes.timestamp() if closes else None))
    opened = service.queries.season(name)
    date = datetime.fromtimestamp(opened.closes_at, UTC) if opened and opened.closes_at else None
    print(f"it closes by itself at {date:%Y-%m-%d %H:%M} UTC", file=sys.stderr)


def season_enter(
    name: str,
    /,
    *submissions: str,
    url: str | None = None,
    token_file: Path | None = None,
    json: bool = False,
) -> None:
    """Choose what of yours plays a season's panel B, in place of what you chose before.

    At most two methods; submissions of one method are its seeds, and their mean counts. Without any
    the submission whose score on panel A was shown last plays.

    Args:
        name: Name or id of the season.
        submissions: Ids of your submissions.
        url: Address of the server; default $ASSISTAX_ZOO_SERVER, else this machine's.
        token_file: File with your token; default the token in $ASSISTAX_ZOO_TOKEN.
        json: Print JSON.

    Example:
        assistax-zoo season enter spring 7kq2mz4a 9xw4pd1c
    """
    entered = _client(url, token_file).enter(name, submissions)
    _print([{name: one[name] for name in ("id", "method", "state")} for one in entered], json)


def season_close(name: str, /, *, data: Path, database: str | None = None) -> None:
    """Close a season before its date: workers play what is in, then panel B; all is revealed.

    Args:
        name: Name or id of the season.
        data: Folder of the service.
        database: URL, where it is not the folder's.

    Example:
        assistax-zoo season close spring --data board
    """
    _service(data, database).close_season(name)


def season_verify(name: str, /, *, root: str, url: str | None = None, json: bool = False) -> None:
    """Prove that the partners that a closed season reveals are those it opened with.

    Args:
        name: Name or id of the season.
        root: Merkle root as it was published when the season opened; keep a copy of your own.
        url: Address of the server; default $ASSISTAX_ZOO_SERVER, else this machine's.
        json: Print JSON.

    Example:
        assistax-zoo season verify spring --root 3f0c...
    """
    _print(_module("client.submitting").verify_revealed(_client(url, None), name, root), json)


def receipt_verify(file: Path, /, *, key: str, json: bool = False) -> None:
    """Check a receipt without the server, and print what it states.

    Args:
        file: The receipt, as `submit --watch --json` or the web page gave it.
        key: The server's public key, as GET /api/about shows it.
        json: Print JSON.

    Example:
        assistax-zoo receipt verify receipt.json --key 'mB0r...='
    """
    import json as decoder

    receipt = decoder.loads(file.read_text(encoding="utf-8"))
    receipt = receipt.get("receipt", receipt) if isinstance(receipt, dict) else receipt
    _print(_module("store.receipts").verify_receipt(receipt, key), json)


def ledger_verify(*, url: str | None = None, json: bool = False) -> None:
    """Check that a server's ledger is an unbroken chain, and print its end.

    Keep what it prints: a later ledger that has another hash at this number was changed.

    Args:
        url: Address of the server; default $ASSISTAX_ZOO_SERVER, else this machine's.
        json: Print JSON.

    Example:
        assistax-zoo ledger verify --url https://board.example.org
    """
    _print(_module("client.checking").check_ledger(_client(url, None)), json)


def service_check(
    *,
    data: Path,
    database: str | None = None,
    artefacts: str | None = None,
    json: bool = False,
) -> None:
    """Check that what a service keeps is whole: database, ledger, artefacts and receipts.

    Args:
        data: Folder of the service, or one that a backup was restored to.
        database: URL, where it is not the folder's.
        artefacts: Address, where it is not the folder's.
        json: Print JSON.

    Example:
        assistax-zoo service check --data board
    """
    _print(_module("client.checking").check_service(_service(data, database, artefacts)), json)


def service_backup(target: Path, /, *, data: Path) -> None:
    """Write a service's folder to one file, while it runs.

    Args:
        target: File to write.
        data: Folder of the service.

    Example:
        assistax-zoo service backup board.zip --data board
    """
    count = _module("store.backup").back_up(data, target)
    print(f"{target} has the database, the key and {count} artefacts")


def service_restore(source: Path, /, *, data: Path) -> None:
    """Write a backup to a new folder.

    Args:
        source: The backup.
        data: Folder to make.

    Example:
        assistax-zoo service restore board.zip --data board2
    """
    _module("store.backup").restore(source, data)


def service_erase(submitter: str, /, *, data: Path, database: str | None = None) -> None:
    """Erase a lab: name, contact, method names and files; hashes and scores stay.

    Args:
        submitter: Name of the lab.
        data: Folder of the service.
        database: URL, where it is not the folder's.

    Example:
        assistax-zoo service erase 'Lab of Ada' --data board
    """
    service = _service(data, database)
    service.erase_submitter(_module("rules.tokens").submitter_id(service.database, submitter))


def _module(name: str) -> Any:
    """Import a module of the service, or say what to install."""
    import importlib

    try:
        return importlib.import_module(f"assistax_board.{name}")
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("assistax_"):
            raise
        raise ValueError(
            f"the service needs {error.name}: pip install assistax-zoo-board"
        ) from None


def _service(data: Path, database: str | None, artefacts: str | None = None) -> "Service":
    """Open the service of a folder that exists: a mistyped one must not make a new service."""
    serving = _module("serve")
    if not (data / "signing-key.pem").is_file():
        raise ValueError(f"{data} is no folder of a service; `assistax-zoo serve` makes one")
    return serving.open_service(data, database=database, artefacts=artefacts)


def _client(url: str | None, token_file: Path | None) -> "Client":
    address = url or os.environ.get(SERVER_VARIABLE) or SERVER
    token = token_file.read_text().strip() if token_file else os.environ.get(TOKEN_VARIABLE)
    return _module("client.client").Client(address, token)


def _print(answer: Any, json: bool) -> None:
    if json:
        print_json(answer)
    elif isinstance(answer, list):
        for row in answer:
            print("  ".join(f"{name} {value}" for name, value in row.items() if value is not None))
    else:
        for name, value in answer.items():
            print(f"{name}: {value}")
