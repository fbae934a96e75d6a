"""A service's folder: its files and its tokens.

DIR/service.db      SQLite, unless the board has another database
DIR/artefacts/      robots, results and private releases by sha256, unless it has another store
DIR/addresses.json  of the other database and store; only the owner can read it
DIR/signing-key.pem
DIR/films/          of pairs of published policies, made when a reader asks
DIR/crossplays/     a finished cross-play for each task, if the organiser puts them there
DIR/organiser-token the organiser's, made with the folder; only the owner can read it
DIR/worker-token    of the local workers; so is this
DIR/webhook-secret  of the organiser's notices
"""

import contextlib
from pathlib import Path

from assistax_base.errors import listing
from assistax_base.files import OWNER, atomic_write
from assistax_board.pages.videos import FILMS_FOLDER
from assistax_board.rules import tokens
from assistax_board.service import Service
from assistax_board.store.addresses import ADDRESSES_FILE
from assistax_board.store.artefacts import ARTEFACTS_FOLDER
from assistax_board.store.database import DATABASE_FILE
from assistax_board.store.receipts import KEY_FILE
from assistax_board.work.webhook import SECRET_FILE

WORKER_TOKEN_FILE, ORGANISER_TOKEN_FILE = "worker-token", "organiser-token"


def check_folder(data: Path) -> None:
    """Refuse to make a service in a folder that holds something else, such as a checkout's `board`.

    Raises:
        ValueError: It holds other files than a service's, and no service.
    """
    known = (DATABASE_FILE, ARTEFACTS_FOLDER, KEY_FILE, FILMS_FOLDER, "crossplays", SECRET_FILE)
    known += (WORKER_TOKEN_FILE, ORGANISER_TOKEN_FILE, ADDRESSES_FILE)
    if not data.exists() or (data / KEY_FILE).exists():
        return
    if not data.is_dir():
        raise ValueError(f"{data} is a file; name a new folder, such as my-board")
    found = sorted(path.name for path in data.iterdir())
    if other := [name for name in found if not name.startswith((".", *known))]:
        raise ValueError(
            f"{data} holds files that are not a service's ({listing(other)}), and keys would lie "
            "beside them; name a new folder, such as my-board"
        )


def page_folders(data: Path, registry: Path | None) -> dict[str, Path | None]:
    """Return where pages find partners, their cross-plays, and films: see `pages.add_pages`."""
    played = data / "crossplays"
    crossplays = played if played.is_dir() else None
    return {"films": data / FILMS_FOLDER, "registry": registry, "crossplays": crossplays}


def about_token(service: Service, data: Path) -> str:
    """Return where the organiser's token lies; it is made if this service never had one.

    The token itself is not printed: journals keep what a server prints.
    """
    path = data / ORGANISER_TOKEN_FILE
    if not any("organise" in token.scopes for token in tokens.list_tokens(service.database)):
        token = service.create_token(("organise", "submit"), label="first", submitter="organiser")
        atomic_write(path, f"{token}\n".encode(), OWNER)
    if path.is_file():
        return f"the organiser's token is in {path}; `cat {path}` prints it"
    return (
        "the organiser has a token, which is not kept here; if it is lost, make another by "
        f"`assistax-zoo token create organise submit --submitter organiser --data {data}`"
    )


def worker_token(service: Service, data: Path) -> str:
    """Return the token of the local workers, kept in a file that only the owner reads."""
    path = data / WORKER_TOKEN_FILE
    with contextlib.suppress(Exception):
        token = path.read_text().strip()
        tokens.authenticate(service.database, token)
        return token
    token = service.create_token(("work",), label="local workers")
    atomic_write(path, f"{token}\n".encode(), OWNER)
    return token
