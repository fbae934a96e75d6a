"""Everything that reads a finished folder: how it is called, and which figures it answers with."""

import contextlib
import io
import json
import re
import shutil
import warnings
from collections.abc import Callable, Generator
from pathlib import Path

from assistax_zoo.shell import main
from tests.attack.process import call
from tools.release_page import __main__ as release_page

EGOS = ("a", "b")  # evaluations of two robots, named by their folders
REPORTED = re.compile(r"<t[dh][^>]*>[^<]*<")  # cells of a page's tables

# Given the folder, another evaluation and a folder for what is written; return what was answered.
Reader = Callable[[Path, Path, Path], str]


class Refused(Exception):
    """A command ended with an error of one line or more, which is its message."""


def run(words: list[str], program: Callable[[list[str]], int] = main.run) -> str:
    """Run a command in this process; return what it prints."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), _letters_unknown():
        try:
            code = program(words)
        except SystemExit as ended:
            code = ended.code
    printed = err.getvalue()
    assert "Traceback" not in printed and "\x1b" not in printed + out.getvalue(), printed[-300:]
    assert "this is unexpected" not in printed, printed[-300:]
    assert code in (0, 1), f"{code}: {printed[-300:]}"
    if code:
        raise Refused(printed or out.getvalue())
    return out.getvalue()


def compare(folder: Path, other: Path, out: Path) -> str:
    return _compared(folder, other)


def compare_second(folder: Path, other: Path, out: Path) -> str:
    return _compared(other, folder)


def report(folder: Path, other: Path, out: Path) -> str:
    page = out / "page.html"
    run(["report", str(folder), "--out", str(page)])
    text = page.read_text(encoding="utf-8")
    assert "<script>alert(1)" not in text
    return "\n".join(REPORTED.findall(text.replace(str(folder), "")))


def verify(folder: Path, other: Path, out: Path) -> str:
    answer = json.loads(run(["verify", str(folder), "--json"]))
    return json.dumps({name: answer[name] for name in ("ok", "files", "problems")})


def plot(folder: Path, other: Path, out: Path) -> str:
    run(["plot", "profile", str(folder), "--out", str(out / "profile.svg")])
    text = (out / "profile.svg").read_text(encoding="utf-8")
    return "\n".join(re.findall(r'<path d="([^"]*)" clip-path', text))  # no letters of names


def matrix(folder: Path, other: Path, out: Path) -> str:
    run(["plot", "crossplay", str(folder), "--out", str(out / "matrix.svg")])
    return "\n".join(re.findall(r'xlink:href="data:([^"]*)"', (out / "matrix.svg").read_text()))


def strategies(folder: Path, other: Path, out: Path) -> str:
    return run(["strategies", str(folder), "--json"])


def collect(folder: Path, other: Path, out: Path) -> str:
    """Return the tables that a release's page would be made from."""
    shutil.rmtree(out / "data", ignore_errors=True)
    run(["collect", str(folder), "--out", str(out / "data")], release_page.run)
    files = sorted(path for path in (out / "data").rglob("*") if path.is_file())
    return "\n".join(f"{path.name} {path.read_bytes().hex()}" for path in files)


OF_EVALUATION: dict[str, Reader] = {
    "compare": compare,
    "compare, second": compare_second,
    "report": report,
    "verify": verify,
    "plot": plot,
    "collect": collect,
}
OF_CROSSPLAY: dict[str, Reader] = {
    "report": report,
    "verify": verify,
    "plot": matrix,
    "strategies": strategies,
    "collect": collect,
}


def make_results(registry: Path, home: Path) -> Path:
    """Fill `a` and `b` with evaluations of two robots' files, and `xp` with a cross-play."""
    toy = ["--task", "scratch", "--backend", "native", "--registry", str(registry)]
    both = ["--split", "both", "--episodes", "2", "--out"]
    for number, name in enumerate(EGOS):
        file = home / "policies" / f"ppo-s{number}.safetensors"
        team = f"scratch/ippo-d1-s{number}-v0/robot"
        export = ["export", team, "--format", "safetensors", "--registry", str(registry)]
        _done([[*export, "--out", str(file)]], home)
        _done([["evaluate", *toy, str(file), *both, str(home / name)]], home)
    _done([["crossplay", *toy, "--episodes", "1", "--out", str(home / "xp")]], home)
    return home


@contextlib.contextmanager
def _letters_unknown() -> Generator[None]:
    """Let figures be drawn whose font lacks a letter of a folder's name."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


def _compared(first: Path, second: Path) -> str:
    answer = json.loads(run(["compare", str(first), str(second), "--json"]))
    return json.dumps({name: value for name, value in answer.items() if name not in ("a", "b")})


def _done(commands: list[list[str]], home: Path) -> None:
    for words in commands:
        done = call(words, home)
        assert done.code == 0, done.err[-500:]
