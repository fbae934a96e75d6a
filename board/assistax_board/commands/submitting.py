"""Commands of submitters."""

import dataclasses
from pathlib import Path

from cyclopts import Parameter

from assistax_board.commands.opening import Server, open_client, print_answer

_NO_METHOD = (
    "give --method with a name for the board, such as --method ppo-large; submissions of one name "
    "are seeds of one method, so another robot needs another name"
)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Words:
    """Texts for the method's page.

    Attributes:
        about: A text of at most 600 characters.
        link: Address of a paper or of code, https://...
        citation: How to cite it, such as a BibTeX entry.
    """

    about: str | None = None
    link: str | None = None
    citation: str | None = None


def submit(
    file: Path | None = None,
    /,
    *,
    task: str,
    method: str | None = None,
    season: str | None = None,
    licence: str = "evaluation-only",
    words: Words = Words(),
    limits: bool = False,
    check: bool = False,
    all: bool = False,
    watch: bool = False,
    server: Server = Server(),
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """Submit a robot to a service, or check at home whether the service would take it.

    Args:
        file: The robot: .safetensors of this project, .onnx, or an id of the zoo.
        task: Task, such as scratch.
        method: Name on the board, asked for unless you only check; submissions of one name are
            seeds of one method, and their mean counts.
        season: Season to take part in; default the public board alone.
        licence: What others may do with the file: evaluation-only, or a licence such as MIT.
        words: Texts for the method's page.
        limits: Only print how much you may still submit: in this hour, and in each open season.
        check: Only check: the server's own admission, and a few episodes with public partners.
        all: With `--check`: play the whole public half as the server does, and print its figures.
        watch: Wait for the end: print place in the queue and time left, then place on the board.
        server: Which server, and who asks.
        registry: Registry to check with instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo submit robot.onnx --task scratch --check
    """
    if limits:
        return _print_limits(server, json)
    if file is None:
        raise ValueError("give a file: .safetensors of this project, .onnx, or an id of the zoo")
    if all and not check:
        raise ValueError("--all is about a check at home; give it with --check")
    from assistax_board import submitting

    if check:
        answer = submitting.check_file(file, task, registry, whole=all)
    elif method is None:
        raise ValueError(_NO_METHOD)
    else:
        fields = {"task": task, "method": method, "season": season, "licence": licence}
        client = open_client(server.url, server.token_file)
        answer = submitting.hand_in(client, file, fields | vars(words), watch=watch)
        answer = answer if json else submitting.for_reader(answer, client.address)
    print_answer(answer, json)


def _print_limits(server: Server, json: bool) -> None:
    from assistax_board.submitting import limits_for_reader

    answer = open_client(server.url, server.token_file).limits()
    print_answer(answer if json else limits_for_reader(answer), json)


def season_enter(
    name: str,
    /,
    *submissions: str,
    url: str | None = None,
    token_file: Path | None = None,
    json: bool = False,
) -> None:
    """Choose which submissions play a season's panel B, instead of an earlier choice.

    At most two methods; submissions of one method are its seeds, and their mean counts. If
    you name none, the submission whose score on panel A was shown last plays.

    Args:
        name: Name or id of the season.
        submissions: Ids of your submissions.
        url: Address of the server; default $ASSISTAX_ZOO_SERVER, else this machine's.
        token_file: File with your token; default the token in $ASSISTAX_ZOO_TOKEN.
        json: Print JSON.

    Example:
        assistax-zoo season enter spring 7kq2mz4a 9xw4pd1c
    """
    entered = open_client(url, token_file).enter(name, submissions)
    print_answer(
        [{field: entry[field] for field in ("id", "method", "state")} for entry in entered], json
    )


def season_verify(name: str, /, *, root: str, url: str | None = None, json: bool = False) -> None:
    """Prove that a closed season reveals the partners with which it opened.

    Args:
        name: Name or id of the season.
        root: Merkle root as it was published when the season opened; keep a copy of your own.
        url: Address of the server; default $ASSISTAX_ZOO_SERVER, else this machine's.
        json: Print JSON.

    Example:
        assistax-zoo season verify spring --root 3f0c...
    """
    from assistax_board.submitting import verify_revealed

    proof = verify_revealed(open_client(url, None), name, root)
    if json:
        print_answer(proof, json)
    else:
        partners = f"the {proof['partners']} partners that season {proof['season']} revealed"
        print(f"proved: {partners} are those of the root with which it opened")


def receipt_verify(file: Path, /, *, key: str, json: bool = False) -> None:
    """Check a receipt without the server, and print its statement.

    Args:
        file: The receipt, as `submit --watch --json` or the web page gave it.
        key: The server's public key, as GET /api/about shows it.
        json: Print JSON.

    Example:
        assistax-zoo receipt verify receipt.json --key 'mB0r...='
    """
    import json as decoder

    from assistax_board.store.receipts import verify_receipt

    receipt = decoder.loads(file.read_text(encoding="utf-8"))
    receipt = receipt.get("receipt", receipt) if isinstance(receipt, dict) else receipt
    print_answer(verify_receipt(receipt, key), json)
