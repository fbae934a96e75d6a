"""Commands of submitters."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cyclopts import Parameter

from assistax_board.commands.opening import Server, open_client, print_answer

_NO_METHOD = (
    "give --method with a name for the board, such as --method ppo-large; another method needs "
    "another name"
)
_NO_FILE = "give a file: .safetensors of this project, .onnx, or an id of the zoo"
_CARD = ("steps", "partners_met", "code", "trained")


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


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class EntryCard:
    """Facts that the board asks of a declared entry, and shows as your word.

    Attributes:
        steps: Steps of the environment in each seed's training.
        partners_met: Partners met in training, such as "train side of fcp-1".
        code: Where the code is, or "not published".
        trained: How many seeds you trained so, those that you leave out too.
    """

    steps: int | None = None
    partners_met: str | None = None
    code: str | None = None
    trained: int | None = None


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class Check:
    """A check at home.

    Attributes:
        check: Only check: the server's own admission, and a few episodes with public partners.
        all: With `--check`: play the whole public half as the server does, and print its figures.
        check_seconds: Time limit of looking at a file, and then of each job of at most 25
            partners. A line each quarter of a minute says what the check does.
    """

    check: bool = False
    all: bool = False
    check_seconds: float = 600.0


def submit(
    *files: Path,
    task: str,
    method: str | None = None,
    season: str | None = None,
    licence: str = "evaluation-only",
    words: Words = Words(),
    card: EntryCard = EntryCard(),
    limits: bool = False,
    at_home: Check = Check(),
    watch: bool = False,
    server: Server = Server(),
    registry: Path | None = None,
    json: bool = False,
) -> None:
    """Submit robots to a service, or check at home whether the service would take them.

    Several files are a declared entry: the seeds of one method, which take a place as one. The
    board freezes the entry before its first score, and nothing leaves it afterwards. A file by
    itself is a single robot: its figures are shown, without a place.

    Args:
        files: The robot, or 2 to 10 seeds of one method: .safetensors of this project, .onnx, or
            ids of the zoo.
        task: Task, such as scratch.
        method: Name on the board, asked for unless you only check.
        season: Season to take part in; default the public board alone.
        licence: What others may do with the file: evaluation-only, or a licence such as MIT.
        words: Texts for the method's page.
        card: Of an entry, asked for with several files.
        limits: Only print how much you may still submit: in this hour, and in each open season.
        at_home: Whether and how to check only.
        watch: Wait for the end: print place in the queue and time left, then place on the board.
        server: Which server, and who asks.
        registry: Registry to check with instead of the installed one.
        json: Print JSON.

    Example:
        assistax-zoo submit robot.onnx --task scratch --check
        assistax-zoo submit s1.onnx s2.onnx s3.onnx --task scratch --method wide --steps 1000000
        --partners-met "train side of fcp-1" --code https://example.org/wide --trained 3
    """
    if limits:
        return _print_limits(server, json)
    _check_words(files, at_home)
    from assistax_board import submitting

    if at_home.check:
        answers = [_checked(file, task, registry, at_home) for file in files]
    elif method is None:
        raise ValueError(_NO_METHOD)
    else:
        said = _said(card, len(files))
        fields = {"task": task, "method": method, "season": season, "licence": licence}
        client = open_client(server.url, server.token_file)
        answers = submitting.hand_in(client, files, fields | vars(words), said, watch=watch)
        if not json:
            answers = [submitting.for_reader(answer, client.address) for answer in answers]
    _print_all(answers, json)


def _checked(file: Path, task: str, registry: Path | None, how: Check) -> dict[str, Any]:
    from assistax_board.submitting import check_file

    return check_file(file, task, registry, whole=how.all, seconds=how.check_seconds)


def _check_words(files: Sequence[Path], at_home: Check) -> None:
    if not files:
        raise ValueError(_NO_FILE)
    if at_home.all and not at_home.check:
        raise ValueError("--all is about a check at home; give it with --check")


def _print_all(answers: Sequence[dict[str, Any]], json: bool) -> None:
    """Print one document as JSON, an object of a single file, or all answers for a reader."""
    if json:
        print_answer(answers[0] if len(answers) == 1 else list(answers), json)
    else:
        for answer in answers:
            print_answer(answer, json)


def _said(card: EntryCard, files: int) -> dict[str, object] | None:
    """Return the card as the server takes it; None for a single robot.

    Raises:
        ValueError: An entry lacks something, or a single robot has a card.
    """
    options = {name: f"--{name.replace('_', '-')}" for name in _CARD}
    if files == 1:
        if given := [options[name] for name in _CARD if getattr(card, name) is not None]:
            raise ValueError(f"{given[0]} is of a declared entry; give 2 to 10 files, its seeds")
        return None
    if missing := [options[name] for name in _CARD if getattr(card, name) is None]:
        raise ValueError(f"{files} files are a declared entry; give {', '.join(missing)} as well")
    values = vars(card)
    return {name.removesuffix("_met"): values[name] for name in _CARD}


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
    """Choose which methods play a season's panel B, instead of an earlier choice.

    At most two methods, each named by one of its submissions and each whole: a declared entry, or
    all single robots of one name. If you name none, the method that was shown last on panel A
    plays, of declared entries if you have any.

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
