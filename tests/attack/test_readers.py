"""What reads finished folders: odd names of folders, damaged files, and two results in one folder.

An answer from another folder, or from a changed file, is a false figure.
"""

import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from evaluation.record import manifest as provenance
from evaluation.record import tables
from tests.attack.commands import Figures, results_of
from tests.attack.damage import damaged
from tests.attack.ledger import Ledger, attack
from tests.attack.process import call
from tests.attack.readers import OF_CROSSPLAY, OF_EVALUATION, Reader, Refused

pytestmark = pytest.mark.attack

# A folder's name, and those of its neighbours that it would mean as a pattern.
NAMES: dict[str, tuple[str, ...]] = {
    "run[1]": ("run1",),
    "run[12]": ("run1", "run2"),
    "run[!2]": ("run1", "runx"),
    "run*": ("run1", "runs", "run"),
    "run?": ("run1", "runx"),
    "**": ("run",),
    "{run,x}": ("run", "x"),
    "run$": ("run",),
    "a b": ("a", "b"),
    " run ": ("run",),
    "ünï-データ-🤖": ("uni",),
    "e\u0301te": ("\u00e9te",),  # one letter to the eye
    "100%25": ("100%",),
    "run#1": ("run",),
    "run&x=1": ("run",),
    "$HOME": ("HOME",),
    "~": ("home",),
    'it\'s "it"': ("its",),
    "run\\1": ("run1",),
    "file:run": ("run",),
    "s3:run": ("run",),
    "-run": ("run",),
    "--json": ("run",),
    "run\nx": ("run",),
    "run\x1b[31m": ("run",),
    "<script>alert(1)<": ("run",),
    "x" * 240: ("x",),
    "...": ("run",),
    "run.parquet": ("run",),
    "[[1]]": ("1", "[1]"),
}


def test_names_of_folders(results: Path, tmp_path: Path) -> None:
    """A folder of any name answers as it does under a plain one, or is refused by its name."""
    readers = [
        *((f"evaluation, {name}", "a", read) for name, read in OF_EVALUATION.items()),
        *((f"cross-play, {name}", "xp", read) for name, read in OF_CROSSPLAY.items()),
    ]
    other = results / "b"
    true = {name: read(results / source, other, tmp_path) for name, source, read in readers}
    assert all(true.values())
    with attack("odd names of folders") as ledger:
        cases = [(folder, reader) for folder in NAMES for reader in readers]
        ledger.random.shuffle(cases)
        for number, (folder, (name, source, read)) in enumerate(cases[: ledger.wanted(len(cases))]):
            home = tmp_path / str(number)
            neighbours(results, source, home, folder)
            with ledger.trial(f"{name} of {folder!r}"):
                same = read(home / folder, other, tmp_path) == true[name]
                assert same, "the answer of another folder"
            shutil.rmtree(home)


def neighbours(results: Path, source: str, home: Path, name: str) -> None:
    """Put a result beside others, from which a pattern would take its figures."""
    shutil.copytree(results / source, home / name)
    for neighbour in NAMES[name]:
        shutil.copytree(results / "b", home / neighbour)


def test_damaged_folders_through_every_reader(results: Path, tmp_path: Path) -> None:
    """No figure is drawn from a file that is not what the manifest says."""
    with attack("damaged folders, every reader") as ledger:
        spoiled(ledger, results / "a", OF_EVALUATION, 360, results / "b", tmp_path)
        spoiled(ledger, results / "xp", OF_CROSSPLAY, 240, results / "b", tmp_path)


def spoiled(
    ledger: Ledger, source: Path, readers: dict[str, Reader], count: int, other: Path, home: Path
) -> None:
    """Damage a copy's files one at a time; whoever reads it refuses, or answers as before."""
    true = {name: read(source, other, home) for name, read in readers.items()}
    folder = Path(shutil.copytree(source, home / source.name))
    files = [path for name in tables.FILES if (path := folder / name).is_file()]
    files = [path for path in files if path.suffix in (".json", ".parquet")]
    files.append(folder / provenance.MANIFEST_FILE)
    for trial in range(ledger.wanted(count)):
        path, name = ledger.random.choice(files), ledger.random.choice(list(readers))
        whole = path.read_bytes()
        path.write_bytes(damaged(ledger.random, whole, path.suffix))
        with ledger.trial(f"{name} {trial}, {path.name}"):
            try:
                same = readers[name](folder, other, home) == true[name]
                assert same, "a false figure"
            except Refused as error:
                assert len(str(error)) < 3000, str(error)[:200]
        path.write_bytes(whole)


TOY = ["--task", "scratch", "--backend", "native"]
ROBOTS = {  # none declares DEPENDS
    "zeros.py": "import numpy as np\ndef make(): return lambda obs: np.zeros((len(obs), 1))",
    "ones.py": "import numpy as np\ndef make(): return lambda obs: np.ones((len(obs), 1))",
}


def jobs(registry: Path) -> dict[str, list[str]]:
    """Return jobs that differ in one thing or more, by what it is."""
    zoo = [*TOY, "--registry", str(registry)]
    evaluate = ["evaluate", *zoo, "--no-references"]
    code = [*evaluate, "python:zeros.py:make", "--episodes"]
    policy = [*evaluate, "zoo:scratch/ippo-d1-s0-v0/robot"]
    other = [*evaluate, "zoo:scratch/ippo-d1-s1-v0/robot"]
    return {
        "code": [*code, "2"],
        "code, one episode": [*code, "1"],
        "code, both sides": [*code, "2", "--split", "both"],
        "code, another seed": [*code, "2", "--seed", "1"],
        "other code": [*(word.replace("zeros", "ones") for word in code), "2"],
        "a policy": [*policy, "--episodes", "2"],
        "a policy, one episode": [*policy, "--episodes", "1"],
        "a policy, stochastic": [*policy, "--episodes", "2", "--stochastic"],
        "another policy": [*other, "--episodes", "2"],
        "a cross-play": ["crossplay", *zoo, "--episodes", "1"],
        "a cross-play, another seed": ["crossplay", *zoo, "--episodes", "1", "--seed", "1"],
    }


@pytest.mark.slow
def test_two_results_in_one_folder(registry_path: Path, tmp_path: Path) -> None:
    """The second is refused and the first stays whole; or it is the same job, and its answer.

    Whether code whose dependencies nobody declared is the same, nobody knows: it is refused.
    """
    words = jobs(registry_path)
    true: dict[str, Figures] = {}

    def alone(name: str) -> Figures:
        if name not in true:
            home = tmp_path / f"alone {name}"
            play(ledger, words[name], home)
            true[name] = results_of("out")(home)
        return true[name]

    with attack("two results in one folder") as ledger:
        cases = [(first, second) for first in words for second in words]
        ledger.random.shuffle(cases)
        for number, (first, second) in enumerate(cases[: ledger.wanted(len(cases))]):
            home = tmp_path / str(number)
            with ledger.trial(f"{first}, then {second}"):
                expected = alone(first)
                assert play(ledger, words[first], home) == 0
                code = play(ledger, words[second], home)
                same = first == second and "code" not in first
                assert code == (0 if same else 1), f"exit code {code}"
                assert results_of("out")(home) == expected, "the first result was changed"


def play(ledger: Ledger, words: Sequence[str], home: Path) -> int | None:
    """Run a job in a folder that has the robots' code."""
    home.mkdir(exist_ok=True)
    for name, code in ROBOTS.items():
        (home / name).write_text(code)
    outcome = call([*words, "--out", "out"], home)
    ledger.judge(outcome)
    return outcome.code
