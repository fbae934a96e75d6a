"""`assistax-zoo play`: a page, and one line why not."""

import json
import webbrowser
from pathlib import Path

import pytest

from assistax_zoo.shell.main import run

TASK = "gentle_scratch"


@pytest.fixture(autouse=True)
def opened(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """Addresses that the command opens, in place of a browser."""
    monkeypatch.chdir(tmp_path)
    addresses: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: bool(addresses.append(url)))
    return addresses


@pytest.mark.slow
def test_a_page_is_written_and_opened(tmp_path: Path, opened: list[str], capfd) -> None:
    assert run(["play", TASK]) == 0
    assert capfd.readouterr().out == f"play-{TASK}.html\n"
    assert opened == [(tmp_path / f"play-{TASK}.html").as_uri()]


def test_robots_and_place_are_chosen(tmp_path: Path, opened: list[str], capfd) -> None:
    options = ["--robot", "script", "--out", "new/x.html", "--no-open", "--study", "--json"]
    assert run(["play", TASK, *options]) == 0
    size = (tmp_path / "new" / "x.html").stat().st_size
    told = json.loads(capfd.readouterr().out)
    assert told == {"page": "new/x.html", "bytes": size, "robots": ["script"]}
    assert size < 500_000 and opened == []


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["scratch"], "scratch cannot be played in a page; allowed are gentle_bath"),
        ([TASK, "--out", "x.txt"], "x.txt ends in '.txt'; allowed is .html"),
        ([TASK, "--robot", "gentle_scratch/none"], "gentle_scratch/none"),
        ([TASK, "--robot", "scratch/ppo-ego-s0-v1/robot"], "choose a robot with that shape"),
    ],
)
def test_what_cannot_be_is_said(arguments: list[str], why: str, capfd) -> None:
    assert run(["play", *arguments, "--no-open"]) == 1
    assert why in capfd.readouterr().err
