"""Commands that read kept files are given another job's, and answer as the table says."""

import contextlib
import csv
import functools
import io
import shutil
import tempfile
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import pytest

from assistax_base.digest import json_sha256
from assistax_zoo.shell.main import run
from evaluation.play.parts import PARTS_FOLDER
from evaluation.record import tables
from tests.attack.commands import HUMAN, ROBOT, small_zoo
from tests.evaluation.test_sources import toy
from tests.untrained import halved, published, teams_of
from zoo.locations import cache_root
from zoo.registry import load_registry

TABLE = Path(__file__).parents[2] / "docs" / "tables" / "kept.csv"
ROBOTS = "scratch/ippo-d1-s*-v0/robot"
EVALUATE = ("evaluate", "--task", "scratch", f"zoo:{ROBOTS}", "--split", "both")
EVALUATE += ("--episodes", "2", "--include-own", "--backend", "native")
CROSSPLAY = ("crossplay", "--task", "scratch", "--episodes", "2", "--backend", "native")
TINY = ("--num-envs", "4", "--set", "rollout_steps=2", "--set", "minibatches=1")
TINY += ("--set", "hidden=(4, 4)", "--backend", "native")
STEPS = {"train": ("--disability", "d1", "--self-play-episodes", "0"), "train-ego": ()}


class Home:
    """Two zoos of equal ids with other parameters, and the folders that commands made."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mine = small_zoo(folder / "mine")
        self.other = published(halved(teams_of(2, ROBOT, HUMAN)), folder / "other")

    def play(self, out: str, *more: str, zoo: Path | None = None) -> Path:
        """Evaluate robots of a zoo, unless that was done before."""
        return self._made([*EVALUATE, *more], out, zoo)

    def crossplay(self, out: str, *more: str, zoo: Path | None = None) -> Path:
        """Play all robots of a zoo with all humans, unless that was done before."""
        return self._made([*CROSSPLAY, *more], out, zoo)

    def train(self, kind: str, out: str, *more: str, zoo: Path | None = None) -> Path:
        """Train teams or robots, unless that was done before."""
        words = [kind, "--task", "scratch", *STEPS[kind], *TINY, "--steps", "8", *more]
        return self._made(words, out, zoo if kind == "train-ego" else False)

    def copy(self, source: Path) -> Path:
        """Return a copy of a folder, under a name of its own."""
        place = Path(tempfile.mkdtemp(dir=self.folder)) / source.name
        shutil.copytree(source, place)
        return place

    def _made(self, words: list[str], out: str, zoo: Any) -> Path:
        place = self.folder / out
        if not place.exists():
            registry = [] if zoo is False else ["--registry", str(zoo or self.mine)]
            said = said_by([*words, *registry, "--out", str(place)])
            assert said is None, said
        return place


def said_by(words: list[str]) -> str | None:
    """Run a command; return the line of its error, and None where it ends well."""
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = run(words)
    except SystemExit as ended:
        code = int(ended.code or 0)
    lines = [line for line in err.getvalue().splitlines() if line.startswith("error: ")]
    return None if code == 0 else " ".join(lines) or out.getvalue()


CASES: dict[tuple[str, str, str], Callable[[Home], list[str]]] = {}


def case(command: str, reads: str, given: str, **arguments: Any) -> Callable[..., None]:
    """Register the words of a row of the table, as a function and its arguments."""

    def register(words: Callable[..., list[str]]) -> None:
        CASES[command, reads, given] = functools.partial(words, **arguments)

    return register


def again(home: Home, place: Path, *more: str, references: bool = False) -> list[str]:
    """Return the words of the evaluation that `Home.play` makes, into another folder."""
    words = [*EVALUATE, *more] if more or references else [*EVALUATE, "--no-references"]
    return [*words, "--registry", str(home.mine), "--out", str(place)]


@case("evaluate", "a finished folder", "of another seed")
def _(home: Home) -> list[str]:
    return again(home, home.copy(home.play("seed", "--seed", "1", "--no-references")))


@case("evaluate", "a finished folder", "of a registry of equal ids")
def _(home: Home) -> list[str]:
    return again(home, home.copy(home.play("theirs", "--no-references", zoo=home.other)))


@case("evaluate", "a cross-play's best responses", "of a registry of equal ids")
def _(home: Home) -> list[str]:
    theirs = home.crossplay("xp2", zoo=home.other)
    return again(home, home.folder / "responses", "--crossplay", str(theirs))


@case("evaluate", "a cross-play's best responses", "of drawn actions")
def _(home: Home) -> list[str]:
    drawn = home.crossplay("drawn", "--stochastic")
    return again(home, home.folder / "responses2", "--crossplay", str(drawn))


def merged(
    home: Home, other: str, options: tuple[str, ...] = (), theirs: bool = False
) -> list[str]:
    """Return the command that resumes a cross-play in a folder with a part of another job."""
    half = ("--share", "1/2", "--max-envs", "4")
    seed = () if theirs else ("--seed", "1")
    parts = home.crossplay(other, *seed, *half, zoo=home.other if theirs else None) / PARTS_FOLDER
    place = home.copy(home.crossplay("half", *half))
    shutil.copytree(parts, place / PARTS_FOLDER, dirs_exist_ok=True)
    words = [*CROSSPLAY, *options, "--max-envs", "4", "--registry", str(home.mine)]
    return [*words, "--out", str(place)]


PARTS = "parts of shares"
case("crossplay", PARTS, "of another seed", other="half-seed")(merged)
case("crossplay", PARTS, "of a registry of equal ids", other="half-other", theirs=True)(merged)
share = ("--share", "2/2")
case("crossplay --share", PARTS, "of another seed", other="half-seed", options=share)(merged)


def both(home: Home, given: str) -> list[str]:
    """Return the folders of an evaluation, and of one that was played otherwise."""
    first = home.play("own", "--no-references")
    if given == "of registries of equal ids":
        return [str(first), str(home.play("theirs", "--no-references", zoo=home.other))]
    if given == "one of drawn actions":
        return [str(first), str(home.play("drawn-one", "--no-references", "--stochastic"))]
    return [str(first), str(home.play("seed", "--no-references", "--seed", "1"))]


def compared(home: Home, words: list[str], other: str) -> list[str]:
    figure = [] if words == ["compare"] else ["--out", str(home.folder / "figure.png")]
    return [*words, *both(home, other), *figure]


for command, given in (
    ("compare", "of registries of equal ids"),
    ("compare", "one of drawn actions"),
    ("compare", "of other seeds"),
    ("plot zsc", "of registries of equal ids"),
    ("plot profile", "one of drawn actions"),
    ("plot disability", "of other seeds"),
):
    case(command, "two evaluations", given, words=command.split(), other=given)(compared)


@case("report", "a league's rows", "one of another seed")
def _(home: Home) -> list[str]:
    league = Path(tempfile.mkdtemp(dir=home.folder))
    for row, place in zip(("ppo", "gru"), both(home, "of other seeds"), strict=True):
        shutil.copytree(place, league / row)
    return ["report", str(league), "--out", str(home.folder / "page.html")]


def with_their_pairs(home: Home, words: list[str]) -> list[str]:
    """Give a command a cross-play with the table of pairs of another folder."""
    place = home.copy(home.crossplay("xp"))
    shutil.copy(home.crossplay("xp2", zoo=home.other) / tables.PAIRS_FILE, place)
    out = {"report": "page.html", "plot": "figure.png"}.get(words[0])
    return [*words, str(place), *(["--out", str(home.folder / out)] if out else [])]


for command in ("report", "plot crossplay", "strategies"):
    words = command.split()
    case(command, "a folder's table", "of another folder", words=words)(with_their_pairs)


def with_their_registry(home: Home, words: list[str]) -> list[str]:
    place = home.play("own", "--no-references")
    page = ["--out", str(home.folder / "page.html")] if words[0] == "report" else []
    return [words[0], str(place), *page, *words[1:], "--registry", str(home.other)]


for command in ("report --watch", "verify", "replay"):
    case(command, "a registry", "of equal ids", words=command.split())(with_their_registry)


@case("replay", "a cross-play's best responses", "of a registry of equal ids")
def _(home: Home) -> list[str]:
    place = home.play("with-responses", "--crossplay", str(home.crossplay("xp")))
    theirs = home.crossplay("xp2", zoo=home.other)
    return ["replay", str(place), "--crossplay", str(theirs), "--registry", str(home.mine)]


def with_their_crossplay(home: Home, option: str) -> list[str]:
    theirs = str(home.crossplay("xp2", zoo=home.other))
    words = ["split", "create", "--task", "scratch", "--rule", "three-sides"]
    return [*words, option, theirs, "--registry", str(home.mine)]


for reads in ("conventions", "best responses"):
    option = f"--{reads.replace(' ', '-')}"
    case("split create", reads, "of a registry of equal ids", option=option)(with_their_crossplay)


def more_training(home: Home, kind: str, place: Path, zoo: Path | None = None) -> list[str]:
    words = [kind, "--task", "scratch", *STEPS[kind], *TINY, "--out", str(place)]
    return [*words, "--steps", "8", "--registry", str(zoo)] if zoo else words


@case("train-ego", "a finished run", "of a registry of equal ids")
def _(home: Home) -> list[str]:
    return more_training(home, "train-ego", home.copy(home.train("train-ego", "ego")), home.other)


@case("train-ego", "a finished run", "of another seed")
def _(home: Home) -> list[str]:
    place = home.copy(home.train("train-ego", "ego"))
    return [*more_training(home, "train-ego", place, home.mine), "--seeds", "5-6"]


STEADY = ("--set", "anneal_lr=false", "--set", "anneal_entropy=false")  # such a run can go on


def longer(home: Home, name: str) -> list[str]:
    """Return the words that make a run longer, of which a part is another seed's."""
    place = home.copy(home.train("train", "team", *STEADY))
    other = home.train("train", "team-of-5", *STEADY, "--seeds", "5-5")
    if (other / name).is_dir():
        shutil.rmtree(place / name)
        shutil.copytree(other / name, place / name)
    else:
        shutil.copy(other / name, place / name)
    return [*more_training(home, "train", place), *STEADY, "--steps", "16"]


case("train", "checkpoints", "of another seed", name="checkpoints")(longer)
case("train", "metrics", "of another seed", name="metrics.parquet")(longer)


@case("publish", "parameters of a run", "of another run")
def _(home: Home) -> list[str]:
    place = home.copy(home.train("train", "plain"))
    shutil.copy(home.train("train", "plain-of-5", "--seeds", "5-5") / "robot.safetensors", place)
    new = str(home.folder / "published" / "registry.json")
    return ["publish", str(place), "--release", "v1", "--registry", new]


@case("publish", "the split of a run", "of another split")
def _(home: Home) -> list[str]:
    place = home.copy(home.train("train-ego", "ego"))
    split = load_registry(home.mine).splits[0]
    turned = split.model_copy(update={"train": split.test, "test": split.train})
    digest = json_sha256(turned.content)
    new = {"sha256": digest, "id": f"{split.id.rpartition('-')[0]}-{digest[:8]}"}
    (place / "split.json").write_text(turned.model_copy(update=new).model_dump_json())
    out = str(home.folder / "published2" / "registry.json")
    return ["publish", str(place), "--release", "v1", "--registry", out]


@case("evaluate", "kept references", "of another job")
def _(home: Home) -> list[str]:
    home.play("referred")
    kept = sorted((cache_root() / "references").iterdir(), key=lambda path: path.stat().st_mtime)
    copies = [home.copy(place) for place in kept]
    for place, source in zip(kept, reversed(copies), strict=True):
        shutil.rmtree(place)
        shutil.copytree(source, place)
    return again(home, home.folder / "referring", references=True)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Home]:
    with prepared(tmp_path_factory.mktemp("home")) as home:
        yield home


@contextlib.contextmanager
def prepared(folder: Path) -> Generator[Home]:
    """Lend a home whose commands play a toy environment and use a cache of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("assistax_envs.make", toy)
        patch.setattr("evaluation.play.baselines.SCRIPTS", {})  # they read true observations
        patch.setenv("ASSISTAX_ZOO_CACHE", str(folder / "cache"))
        patch.setenv("ASSISTAX_ZOO_DATA", str(folder / "data"))
        yield Home(folder)


@pytest.mark.slow
@pytest.mark.parametrize("row", list(CASES), ids=", ".join)
def test_a_command_notices_another_job(home: Home, row: tuple[str, str, str]) -> None:
    said = said_by(CASES[row](home))
    assert said is not None, "another job was taken without a word"
    assert read_table()[row] in said, said


def read_table() -> dict[tuple[str, ...], str]:
    """Return the messages of the table by command, input and its replacement."""
    with TABLE.open(newline="", encoding="utf-8") as file:
        return {tuple(row): message for *row, message in list(csv.reader(file))[1:]}


def test_every_row_of_the_table_is_tested() -> None:
    assert set(read_table()) == set(CASES)
