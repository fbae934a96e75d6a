"""Each command that reads something kept is given another job's, and says so.

`python -m tests.cli.test_kept` writes the table of docs/reliability.md anew from what they say.
"""

import contextlib
import csv
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
TINY = ("--num-envs", "4", "--set", "rollout_steps=2", "--set", "minibatches=1")
TINY += ("--set", "hidden=(4, 4)", "--backend", "native")
STEPS = {"train": ("--disability", "d1", "--self-play-episodes", "0"), "train-ego": ()}


class Home:
    """Two zoos of equal ids with other parameters, and the folders that commands made."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mine = small_zoo(folder / "mine")
        self.other = published(halved(teams_of(2, ROBOT, HUMAN)), folder / "other")

    def play(self, out: str, *more: str, zoo: Path | None = None, robots: str = ROBOTS) -> Path:
        """Evaluate robots of a zoo, unless that was done before."""
        words = ["evaluate", "--task", "scratch", "--policy", f"zoo:{robots}", "--split", "both"]
        words += ["--episodes", "2", "--include-own", "--backend", "native", *more]
        return self._made(words, out, zoo)

    def crossplay(self, out: str, *more: str, zoo: Path | None = None) -> Path:
        """Play all robots of a zoo with all humans, unless that was done before."""
        words = ["crossplay", "--task", "scratch", "--episodes", "2", "--backend", "native", *more]
        return self._made(words, out, zoo)

    def train(self, kind: str, out: str, *more: str, zoo: Path | None = None) -> Path:
        """Train teams or robots, unless that was done before."""
        words = [kind, "--task", "scratch", *STEPS[kind], *TINY, "--steps", "8", *more]
        return self._made(words, out, zoo if kind == "train-ego" else False)

    def copy(self, source: Path, *parts: str) -> Path:
        """Return a copy of a folder, under a name of its own."""
        place = Path(tempfile.mkdtemp(dir=self.folder)) / source.name
        shutil.copytree(source, place)
        return place.joinpath(*parts)

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


Case = tuple[str, str, Callable[[Home], list[str]], str]  # reads, given, words, what it says
CASES: dict[str, Case] = {}


def case(name: str, reads: str, given: str, says: str) -> Callable[..., Any]:
    """Register a case: the words of a command, and the expected message."""

    def note(words: Callable[[Home], list[str]]) -> Callable[[Home], list[str]]:
        CASES[f"{name}: {reads}, {given}"] = (name, f"{reads}|{given}", words, says)
        return words

    return note


def with_parts(home: Home, theirs: Path) -> Path:
    """Return an unfinished cross-play beside whose part another's lies."""
    place = home.copy(home.crossplay("half", "--share", "1/2", "--max-envs", "4"))
    shutil.copytree(theirs / PARTS_FOLDER, place / PARTS_FOLDER, dirs_exist_ok=True)
    return place


def merge(home: Home, place: Path, *more: str) -> list[str]:
    words = ["crossplay", "--task", "scratch", "--episodes", "2", "--backend", "native", *more]
    return [*words, "--max-envs", "4", "--registry", str(home.mine), "--out", str(place)]


@case("evaluate", "a finished folder", "of another seed", "holds another job (seed 1 there, 0 here")
def _(home: Home) -> list[str]:
    return again(home, home.copy(home.play("seed", "--seed", "1", "--no-references")))


@case(
    "evaluate", "a finished folder", "of a registry of equal ids", "holds another job (other egos"
)
def _(home: Home) -> list[str]:
    return again(home, home.copy(home.play("theirs", "--no-references", zoo=home.other)))


def again(home: Home, place: Path, *more: str) -> list[str]:
    """Return the words of the evaluation that `Home.play` makes, into another folder."""
    words = ["evaluate", "--task", "scratch", "--policy", f"zoo:{ROBOTS}", "--split", "both"]
    words += ["--episodes", "2", "--include-own", "--backend", "native", *more]
    words += [] if "--crossplay" in more or "--references" in more else ["--no-references"]
    words = [word for word in words if word != "--references"]
    return [*words, "--registry", str(home.mine), "--out", str(place)]


@case(
    "evaluate",
    "a cross-play's best responses",
    "of a registry of equal ids",
    "digest of partner scratch/ippo-d1-s0-v0/human is",
)
def _(home: Home) -> list[str]:
    return again(
        home, home.folder / "responses", "--crossplay", str(home.crossplay("xp2", zoo=home.other))
    )


@case("evaluate", "a cross-play's best responses", "of drawn actions", "stochastic is true in")
def _(home: Home) -> list[str]:
    drawn = home.crossplay("drawn", "--stochastic")
    return again(home, home.folder / "responses2", "--crossplay", str(drawn))


@case(
    "crossplay",
    "parts of shares",
    "of another seed",
    "other policies, settings or versions played them",
)
def _(home: Home) -> list[str]:
    half = ("--seed", "1", "--share", "1/2", "--max-envs", "4")
    return merge(home, with_parts(home, home.crossplay("half-seed", *half)))


@case(
    "crossplay",
    "parts of shares",
    "of a registry of equal ids",
    "other policies, settings or versions played them",
)
def _(home: Home) -> list[str]:
    half = ("--share", "1/2", "--max-envs", "4")
    return merge(home, with_parts(home, home.crossplay("half-other", *half, zoo=home.other)))


@case(
    "crossplay --share",
    "parts of shares",
    "of another seed",
    "other policies, settings or versions played them",
)
def _(home: Home) -> list[str]:
    half = ("--seed", "1", "--share", "1/2", "--max-envs", "4")
    return merge(home, with_parts(home, home.crossplay("half-seed", *half)), "--share", "2/2")


@case("compare", "two evaluations", "of registries of equal ids", "digest of partner")
def _(home: Home) -> list[str]:
    return ["compare", *both(home, "theirs", zoo=home.other)]


@case("compare", "two evaluations", "one of drawn actions", "stochastic is")
def _(home: Home) -> list[str]:
    return ["compare", *both(home, "drawn-one", "--stochastic")]


@case("compare", "two evaluations", "of other seeds", "seed is")
def _(home: Home) -> list[str]:
    return ["compare", *both(home, "seed", "--seed", "1")]


@case("plot zsc", "two evaluations", "of registries of equal ids", "digest of partner")
def _(home: Home) -> list[str]:
    figure = ["--out", str(home.folder / "figure.png")]
    return ["plot", "zsc", *both(home, "theirs", zoo=home.other), *figure]


@case("plot profile", "two evaluations", "one of drawn actions", "stochastic is")
def _(home: Home) -> list[str]:
    figure = ["--out", str(home.folder / "figure.png")]
    return ["plot", "profile", *both(home, "drawn-one", "--stochastic"), *figure]


@case("plot disability", "two evaluations", "of other seeds", "seed is")
def _(home: Home) -> list[str]:
    figure = ["--out", str(home.folder / "figure.png")]
    return ["plot", "disability", *both(home, "seed", "--seed", "1"), *figure]


def both(home: Home, other: str, *more: str, zoo: Path | None = None) -> list[str]:
    first = home.play("own", "--no-references")
    return [str(first), str(home.play(other, "--no-references", *more, zoo=zoo))]


@case("report", "a league's rows", "one of another seed", "seed is")
def _(home: Home) -> list[str]:
    league = Path(tempfile.mkdtemp(dir=home.folder))
    for row, place in zip(("ppo", "gru"), both(home, "seed", "--seed", "1"), strict=True):
        shutil.copytree(place, league / row)
    return ["report", str(league), "--out", str(home.folder / "page.html")]


def with_their_pairs(home: Home) -> Path:
    """Return a cross-play whose table of pairs is another folder's."""
    place = home.copy(home.crossplay("xp"))
    shutil.copy(home.crossplay("xp2", zoo=home.other) / tables.PAIRS_FILE, place)
    return place


@case("report", "a folder's table", "of another folder", "pairs.parquet: expected sha256")
def _(home: Home) -> list[str]:
    place = with_their_pairs(home)
    return ["report", str(place), "--out", str(home.folder / "page.html")]


@case("plot crossplay", "a folder's table", "of another folder", "pairs.parquet: expected sha256")
def _(home: Home) -> list[str]:
    place = with_their_pairs(home)
    return ["plot", "crossplay", str(place), "--out", str(home.folder / "figure.png")]


@case("strategies", "a folder's table", "of another folder", "pairs.parquet: expected sha256")
def _(home: Home) -> list[str]:
    place = with_their_pairs(home)
    return ["strategies", str(place)]


@case("report --watch", "a registry", "of equal ids", "is not the one that played")
def _(home: Home) -> list[str]:
    place = home.play("own", "--no-references")
    page = ["--out", str(home.folder / "page.html"), "--watch"]
    return ["report", str(place), *page, "--registry", str(home.other)]


@case("verify", "a registry", "of equal ids", "is not what the figures are of")
def _(home: Home) -> list[str]:
    return ["verify", str(home.play("own", "--no-references")), "--registry", str(home.other)]


@case("replay", "a registry", "of equal ids", "is not the one that played")
def _(home: Home) -> list[str]:
    return ["replay", str(home.play("own", "--no-references")), "--registry", str(home.other)]


@case(
    "replay",
    "a cross-play's best responses",
    "of a registry of equal ids",
    "is not the one that played",
)
def _(home: Home) -> list[str]:
    place = home.play("with-responses", "--crossplay", str(home.crossplay("xp")))
    theirs = home.crossplay("xp2", zoo=home.other)
    return ["replay", str(place), "--crossplay", str(theirs), "--registry", str(home.mine)]


@case(
    "split create",
    "conventions",
    "of a registry of equal ids",
    "was played with other partners than this registry's",
)
def _(home: Home) -> list[str]:
    theirs = str(home.crossplay("xp2", zoo=home.other))
    words = ["split", "create", "--task", "scratch", "--rule", "three-sides"]
    return [*words, "--conventions", theirs, "--registry", str(home.mine)]


@case(
    "split create",
    "best responses",
    "of a registry of equal ids",
    "was played with other partners than this registry's",
)
def _(home: Home) -> list[str]:
    theirs = str(home.crossplay("xp2", zoo=home.other))
    words = ["split", "create", "--task", "scratch", "--rule", "three-sides"]
    return [*words, "--best-responses", theirs, "--registry", str(home.mine)]


@case(
    "train-ego",
    "a finished run",
    "of a registry of equal ids",
    "its partners have other parameters or settings",
)
def _(home: Home) -> list[str]:
    return more_training(home, "train-ego", home.copy(home.train("train-ego", "ego")), home.other)


@case(
    "train-ego",
    "a finished run",
    "of another seed",
    "holds a run with another configuration: members is",
)
def _(home: Home) -> list[str]:
    place = home.copy(home.train("train-ego", "ego"))
    return [*more_training(home, "train-ego", place, home.mine), "--seeds", "5-6"]


def more_training(home: Home, kind: str, place: Path, zoo: Path | None = None) -> list[str]:
    words = [kind, "--task", "scratch", *STEPS[kind], *TINY, "--out", str(place)]
    return [*words, "--steps", "8", "--registry", str(zoo)] if zoo else words


@case(
    "train", "checkpoints", "of another seed", "is of another run than the folder's configuration"
)
def _(home: Home) -> list[str]:
    return longer(home, "checkpoints")


@case("train", "metrics", "of another seed", "is of another run than config.json beside it")
def _(home: Home) -> list[str]:
    return longer(home, "metrics.parquet")


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


@case("publish", "parameters of a run", "of another run", "another run's in robot.safetensors")
def _(home: Home) -> list[str]:
    place = home.copy(home.train("train", "plain"))
    shutil.copy(home.train("train", "plain-of-5", "--seeds", "5-5") / "robot.safetensors", place)
    new = str(home.folder / "published" / "registry.json")
    return ["publish", str(place), "--release", "v1", "--registry", new]


@case("publish", "the split of a run", "of another split", "split of the run")
def _(home: Home) -> list[str]:
    place = home.copy(home.train("train-ego", "ego"))
    split = load_registry(home.mine).splits[0]
    turned = split.model_copy(update={"train": split.test, "test": split.train})
    digest = json_sha256(turned.content)
    new = {"sha256": digest, "id": f"{split.id.rpartition('-')[0]}-{digest[:8]}"}
    (place / "split.json").write_text(turned.model_copy(update=new).model_dump_json())
    out = str(home.folder / "published2" / "registry.json")
    return ["publish", str(place), "--release", "v1", "--registry", out]


@case("evaluate", "kept references", "of another job", "are of another job; remove that folder")
def _(home: Home) -> list[str]:
    home.play("referred")
    kept = sorted((cache_root() / "references").iterdir(), key=lambda path: path.stat().st_mtime)
    for place, source in zip(kept, reversed(home_copies(home, kept)), strict=True):
        shutil.rmtree(place)
        shutil.copytree(source, place)
    return again(home, home.folder / "referring", "--references")


def home_copies(home: Home, places: list[Path]) -> list[Path]:
    return [home.copy(place) for place in places]


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
@pytest.mark.parametrize("name", list(CASES))
def test_a_command_notices_another_job(home: Home, name: str) -> None:
    _, _, words, says = CASES[name]
    said = said_by(words(home))
    assert said is not None, "another job was taken without a word"
    assert says in said, said


def rows() -> list[list[str]]:
    """Return the table's rows: command, input, its replacement, the message."""
    return [[name, *what.split("|"), says] for name, what, _, says in CASES.values()]


def test_the_table_of_the_docs_is_what_is_tested() -> None:
    with TABLE.open(newline="", encoding="utf-8") as file:
        assert list(csv.reader(file)) == [["command", "reads", "given", "says"], *rows()]


if __name__ == "__main__":
    with TABLE.open("w", newline="", encoding="utf-8") as table:
        lines = csv.writer(table, lineterminator="\n")
        lines.writerows([["command", "reads", "given", "says"], *rows()])
