"""Every command of README and docs is one, with options that it has."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from cyclopts import CycloptsError

from assistax_zoo.shell import main

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
NOT_WORDS = {"&", "|", ">", ">>", "&&", "||", ";"}  # what ends a command in a shell


def printed_commands(text: str) -> Iterator[list[str]]:
    """Yield the words after `assistax-zoo` of each line in blocks for a shell."""
    for block in re.findall(r"```(?:sh|bash|console)\n(.*?)```", text, re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            words = [word.removesuffix(";") for word in words]
            if "assistax-zoo" not in words or {"podman", "docker", "cd"} & {words[0]}:
                continue
            after = words[words.index("assistax-zoo") + 1 :]
            ends = [place for place, word in enumerate(after) if word in NOT_WORDS]
            yield after[: ends[0]] if ends else after


def parse(words: list[str]) -> None:
    """Parse a command line as the program does, and run nothing."""
    app = main.build_app()
    main._add_subcommands(app, words)  # private: the step of `run` before it calls the command
    app.parse_args(words, print_error=False, exit_on_error=False)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_of_the_page_parses(page: Path) -> None:
    wrong = []
    text = page.read_text(encoding="utf-8")
    # `tests/test_outside.py` runs the commands of the package of docs/extend.md.
    text = text.replace("gentle_wave", "gentle_scratch").replace("--metrics unsteadiness ", "")
    for words in printed_commands(text):
        if words == ["--install-completion"]:
            continue
        try:
            parse(words)
        except CycloptsError as error:
            wrong.append(f"{shlex.join(words)}: {error}")
    assert wrong == []


def test_the_guides_have_commands() -> None:
    for name in ("start", "robot", "training", "publish", "run_board"):
        page = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
        assert len(list(printed_commands(page))) >= 4, name


@pytest.mark.parametrize(
    "line",
    [
        "assistax-zoo evaluate --task scratch x --nothing 3",
        "assistax-zoo unknown --task scratch",
        "X=1 assistax-zoo train population --plan p.json --out r --block 2 # comment",
        "assistax-zoo crossplay --robots x",
    ],
)
def test_a_planted_mistake_is_found(line: str) -> None:
    ((words),) = printed_commands(f"```sh\n{line}\n```")
    with pytest.raises(CycloptsError):
        parse(words)
