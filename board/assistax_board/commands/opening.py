"""Shared by commands: a folder's service, a server's client, and the printing of answers."""

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclopts import Parameter

from assistax_board.vocabulary import SERVER_VARIABLE, TOKEN_VARIABLE
from assistax_zoo.shell.console import print_json

if TYPE_CHECKING:
    from assistax_board.client import Client
    from assistax_board.service import Service

SERVER = "http://127.0.0.1:8800"


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Server:
    """Address of a server, and the token to use there.

    Attributes:
        url: Address of the server; default $ASSISTAX_ZOO_SERVER, else this machine's.
        token_file: File with your token; default the token in $ASSISTAX_ZOO_TOKEN.
    """

    url: str | None = None
    token_file: Path | None = None


def open_folder(data: Path) -> "Service":
    """Open the service of a folder that exists: a mistyped name must not make a new one."""
    from assistax_board.serve import open_service

    if not (data / "signing-key.pem").is_file():
        raise ValueError(f"{data} is not a service's folder; `assistax-zoo serve` makes one")
    return open_service(data)


def open_client(url: str | None, token_file: Path | None) -> "Client":
    """Return the client of a server, with a token from a file or the environment."""
    from assistax_board.client import Client

    address = url or os.environ.get(SERVER_VARIABLE) or SERVER
    if token_file is None:
        token = os.environ.get(TOKEN_VARIABLE)
        return Client(address, None if token is None else token.strip())
    if not (token := token_file.read_text().strip()):
        raise ValueError(f"{token_file} is empty; it holds a token, such as azt_...")
    return Client(address, token)


def print_answer(answer: Any, json: bool) -> None:
    """Print fields, or one row a line, or all of it as JSON."""
    if json:
        print_json(answer)
    elif isinstance(answer, list):
        for row in answer:
            print("  ".join(f"{name} {value}" for name, value in row.items() if value is not None))
    else:
        for name, value in answer.items():
            print(f"{name}: {value}")
