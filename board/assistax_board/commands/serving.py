"""Commands that run: a server, and workers."""

import functools
import sys
from pathlib import Path

from assistax_board.commands.opening import open_client
from assistax_board.vocabulary import BACKEND
from assistax_zoo.commands.options import Engine


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
    webhook: str | None = None,
) -> None:
    """Run the evaluation service: a web server, its data in a folder, and a local worker.

    When the folder is new it makes the organiser's token, and keeps it in `organiser-token` there.

    Args:
        data: Folder for the database, the artefacts and the signing key; made if it is new.
        host: Address or name to listen on; 0.0.0.0 is all, behind a proxy that speaks TLS.
        port: Port to listen on; 0 takes a free one.
        workers: Local worker processes; 0 if all workers run elsewhere.
        database: URL of a new board's database, postgresql://user@host/name; the folder keeps it.
        artefacts: Address of a new board's store, s3://bucket/path; the folder keeps it too.
        registry: Registry of the public partners instead of the installed one.
        backend: Backend that plays, the same for every worker.
        references: Play rows to compare with, such as scripts, when no submission waits.
        proxy: Address of the proxy whose X-Forwarded-For is believed, such as 127.0.0.1; else none.
        webhook: Address to which notices are posted, signed with `webhook-secret` of the folder.

    Example:
        assistax-zoo serve --data my-board
    """
    from assistax_board import folder
    from assistax_board import serve as serving
    from assistax_board.api.guards import check_proxy
    from assistax_board.work.webhook import check_address, watched

    check_proxy(proxy)
    check_address(webhook)
    folder.check_folder(data)
    with serving.stopped_by_signals(), serving.only_server(data):
        service = serving.open_service(
            data, database=database, artefacts=artefacts, registry=registry, backend=backend
        )
        with service.database.only_server(), serving.listen(host, port) as (port, listeners):
            token = folder.worker_token(service, data) if workers else ""
            service.adopt_version()
            if references:
                serving.add_references_later(service)
            address = f"http://{f'[{host}]' if ':' in host else host}:{port}"
            print(f"serving {address} from {data}; Ctrl-C stops", file=sys.stderr, flush=True)
            print(folder.about_token(service, data), file=sys.stderr, flush=True)
            options = ["--backend", backend, *(["--registry", str(registry)] if registry else [])]
            local = address.replace("0.0.0.0", "127.0.0.1")
            playing = serving.local_workers(workers, local, token, options)
            with watched(service, data, webhook), playing as stop_workers:
                pages = folder.page_folders(data, registry)
                serving.run_server(service, listeners, stop_workers, proxy, **pages)


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
        until_empty: Stop when no job waits.
        engine: Where workers run.

    Example:
        assistax-zoo worker --url https://board.example.org --token-file worker-token
    """
    from assistax_board.work import working_process as working

    client, cluster = open_client(url, token_file), engine.cluster()
    if cluster is None:
        working.run_worker(client, registry, backend, until_empty=until_empty)
    else:
        make = functools.partial(working.make_scorer, registry, backend)
        working.run_workers_on_ray(cluster, client, make, until_empty=until_empty)
