"""Exit codes and messages of the command line, its help pages, and what commands share."""

import ctypes
import json
import os
import re
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from assistax_base import extensions
from assistax_base.errors import ZooError
from assistax_zoo.shell import console, installed, main

ROOT = Path(__file__).parents[2]
FIRST_WORDS = {name.split(".")[0] for name in main.all_commands()}
ALL_PATHS = main.all_commands()
ALL_COMMANDS = [tuple(name.split(".")) for name in main.all_commands()]


@pytest.fixture
def fake(monkeypatch) -> Callable[[Callable[[], None]], None]:
    """Make `assistax-zoo fake` run a function."""

    def install(work: Callable[[], None]) -> None:
        def fake(*, episodes: int = 1) -> None:
            """Do as the test says."""
            work()

        module = types.ModuleType("fake_commands")
        module.fake = fake  # ty: ignore[missing-attribute]
        monkeypatch.setitem(sys.modules, "fake_commands", module)
        monkeypatch.setitem(main.COMMANDS, "fake", "fake_commands:fake")

    return install


def raises(error: BaseException) -> Callable[[], None]:
    def work() -> None:
        raise error

    return work


OF_THE_ZOO = ZooError(
    "unknown policy", expected="an id", found="x", done="nothing was done", next_step="run list"
)


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (ValueError("--episodes is 0; 1 or more is needed"), 1, None),
        (TypeError("a list is needed"), 1, None),
        (OSError("the folder is full"), 1, None),
        (OF_THE_ZOO, 1, None),
        (PermissionError(13, "Permission denied", "/out"), 1, "Permission denied: /out"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_an_expected_error_is_its_message(
    fake: Callable, capsys, error: BaseException, code: int, message: str | None
) -> None:
    fake(raises(error))
    assert main.run(["fake"]) == code
    assert capsys.readouterr() == ("", f"error: {message or error}\n")


def test_an_unexpected_error_is_named_without_a_traceback(
    fake: Callable, capsys, monkeypatch
) -> None:
    monkeypatch.delenv(main.DEBUG_VARIABLE, raising=False)
    fake(raises(RuntimeError("a shape is wrong\nframes\nof the compiler")))
    assert main.run(["fake"]) == 1
    first, second = capsys.readouterr().err.splitlines()
    assert first == "error: RuntimeError: a shape is wrong"
    assert "ASSISTAX_ZOO_DEBUG=1" in second
    monkeypatch.setenv(main.DEBUG_VARIABLE, "1")
    with pytest.raises(RuntimeError, match="a shape is wrong"):
        main.run(["fake"])


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (MemoryError(), ""),
        (MemoryError("table.parquet was not read"), " (table.parquet was not read)"),
        (RuntimeError("RESOURCE_EXHAUSTED: out of memory\nf"), " (RESOURCE_EXHAUSTED: out of "),
        (OSError(12, "Cannot allocate memory", "/out"), " ([Errno 12] Cannot allocate memory"),
    ],
)
def test_too_little_memory_is_expected(
    fake: Callable, capsys, error: Exception, reason: str
) -> None:
    fake(raises(error))
    assert main.run(["fake"]) == 1
    text = "error: this process may take no more memory, or start no more threads; see `ulimit -a`"
    assert capsys.readouterr().err.startswith(f"{text}{reason}")


@pytest.mark.parametrize(
    ("arguments", "words", "hint"),
    [
        (["fakke"], 'Unknown command "fakke". Did you mean "fake"?', "try: assistax-zoo --help"),
        (["fake", "--bogus", "1"], "--bogus", "try: assistax-zoo fake --help"),
        (["fake", "--episodes", "two"], "two", "try: assistax-zoo fake --help"),
        (["plot", "nothing"], 'Unknown command "nothing"', "try: assistax-zoo plot --help"),
    ],
)
def test_wrong_usage_exits_2(
    fake: Callable, capsys, arguments: list[str], words: str, hint: str
) -> None:
    fake(lambda: None)
    assert main.run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("error: ") and words in err
    assert err.splitlines()[-1] == hint


def test_a_reader_that_leaves_is_no_error() -> None:
    script = (
        "import sys, types; from assistax_zoo.shell import main\n"
        "module = sys.modules['fakes'] = types.ModuleType('fakes')\n"
        "exec('def fake():\\n    for i in range(10**6): print(i)', module.__dict__)\n"
        "main.COMMANDS['fake'] = 'fakes:fake'; sys.exit(main.run(['fake']))"
    )
    command = [sys.executable, "-c", script]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == "0\n"
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == main.EXIT_BROKEN_PIPE


def test_a_closed_standard_output_is_told() -> None:
    script = f"exec {sys.executable} -m assistax_zoo list >&-"
    done = subprocess.run(["sh", "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == main.EXIT_ERROR
    assert done.stderr.startswith("error: standard output is closed; direct it to a file")


def test_help_groups_all_commands_by_audience(capsys) -> None:
    assert main.run(["--help"]) == 0
    boxes = re.findall(r"╭─ ([\w ,]+) ─+╮\n(.*?)╰─", capsys.readouterr().out, re.DOTALL)
    assert [title for title, _ in boxes] == list(main.AUDIENCES)  # none left for "Commands"
    for title, box in boxes:
        lines = [line.strip("│ ").split(maxsplit=1) for line in box.splitlines()]
        summaries = {words[0]: words[1:] for words in lines}
        assert all(summaries[name] for name in main.AUDIENCES[title].split()), title
    named = [word for names in main.AUDIENCES.values() for word in names.split()]
    assert len(named) == len(set(named)) and set(named) >= FIRST_WORDS


@pytest.mark.parametrize("command", ALL_COMMANDS, ids=" ".join)
def test_help_of_a_command_ends_with_an_example(command: tuple[str, ...], capsys) -> None:
    assert main.run([*command, "--help"]) == 0
    usage, _, rest = capsys.readouterr().out.partition("\n")
    assert usage.startswith(f"Usage: assistax-zoo {' '.join(command)}")
    assert f"assistax-zoo {' '.join(command)}" in rest


def test_a_distribution_without_its_package_fails_its_own_commands_alone(
    fake: Callable, tmp_path: Path, monkeypatch, capsys
) -> None:
    about = tmp_path / "assistax_zoo_board-0.1.0.dist-info"  # stands before the installed one
    about.mkdir()
    (about / "METADATA").write_text("Name: assistax-zoo-board\nVersion: 0.1.0\n")
    (about / "entry_points.txt").write_text(
        "[assistax_zoo.commands]\nserve = absent_board.commands:serve\n"
        "[assistax_zoo.groups]\ntoken = absent_board.commands:TOKEN\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    # Every process reads the entry points once, and this one did.
    monkeypatch.setattr(extensions, "_read", extensions._read.__wrapped__)
    fake(lambda: print("done"))
    assert main.run(["fake"]) == 0
    assert capsys.readouterr() == ("done\n", "")
    for words in (["serve", "--help"], ["token", "list"]):
        assert main.run(words) == 1
        [line] = capsys.readouterr().err.splitlines()
        assert line.startswith(f"error: `{words[0]}` belongs to assistax-zoo-board, which is not ")
        assert line.endswith(installed.INSTALL["assistax-zoo-board"])


@pytest.mark.parametrize("name", ["evaluate", "plot.zsc", "plot"])
def test_a_package_cannot_replace_a_command(
    install_package: Callable[..., None], capsys, name: str
) -> None:
    group = extensions.HEADS if name in main.GROUPS else extensions.COMMANDS
    install_package(group, name, "textwrap:dedent")
    assert main.all_commands() == ALL_PATHS and main.all_groups()["plot"] == main.GROUPS["plot"]
    assert main.run(name.split(".")[:-1]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert f"'{name}' of the package outside 0.3 (textwrap:dedent): expected a name of" in printed
    assert main.run([*name.split("."), "--help"]) == 0


@pytest.mark.parametrize("name", ["plot.forces", "forces"])
def test_a_broken_command_names_its_package(
    install_package: Callable[..., None],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    name: str,
) -> None:
    (tmp_path / "outside_commands.py").write_text("import no_such_module\n")
    install_package(extensions.COMMANDS, name, "outside_commands:forces")
    words = name.split(".")
    for wanted in (words, [*words, "--help"]):
        assert main.run(wanted) == 1
        message = capsys.readouterr().err
        assert message.startswith(f"error: the command '{name}' of the package outside 0.3 ")
        assert "No module named 'no_such_module'" in message
    for wanted in (words[:-1], [*words[:-1], "--help"]):
        assert main.run(wanted) == 0
        printed = " ".join(capsys.readouterr().out.split())
        assert f"left out: the command '{name}' of the package outside 0.3 " in printed
        assert ("zsc" if "plot" in wanted else "evaluate") in printed
    for wanted in (["plot", "zsc", "--help"], ["--version"]):
        assert main.run(wanted) == 0


def test_a_broken_group_is_left_out(
    install_package: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    install_package(extensions.HEADS, "lab", "textwrap:no_such_text")
    assert main.run(["--help"]) == 0
    assert "the group of commands 'lab'" in " ".join(capsys.readouterr().out.split())
    assert main.run(["lab", "run"]) == 1
    assert "has no attribute 'no_such_text'" in capsys.readouterr().err


def test_a_package_adds_a_figure_command(
    install_package: Callable[..., None], capsys, tmp_path: Path
) -> None:
    (tmp_path / "outside_figures.py").write_text("def forces(): print('drawn')\n")
    install_package(extensions.COMMANDS, "plot.forces", "outside_figures:forces")
    assert main.run(["plot", "forces"]) == 0
    assert capsys.readouterr().out == "drawn\n"


def test_the_compilation_cache_is_set_but_never_overridden(fake: Callable, monkeypatch) -> None:
    fake(lambda: None)
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "/mine")
    main.run(["fake"])
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == "/mine"
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", "/caches")
    main.run(["fake"])
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == "/caches/assistax-zoo/xla"


def test_print_json_prints_one_document(capsys) -> None:
    value = {"ci": np.array([0, 1]), "none": float("nan"), "path": Path("a"), 1: ("é", {2, 1})}
    console.print_json({"mean": np.float32(1.5), **value})
    out = capsys.readouterr().out
    expected = {"ci": [0, 1], "none": None, "path": "a", "1": ["é", [1, 2]]}
    assert json.loads(out) == {"mean": 1.5, **expected}
    assert "NaN" not in out


def test_noise_goes_to_standard_error_while_stdout_is_data(capfd) -> None:
    with pytest.raises(ValueError, match="bad"), console.stdout_is_data():
        print("from Python")
        os.write(1, b"from a descriptor\n")
        ctypes.CDLL(None).puts(b"from C")
        raise ValueError("bad")
    os.write(1, b"the result\n")
    out, err = capfd.readouterr()
    assert out == "the result\n"
    assert {"from Python", "from a descriptor", "from C"} <= set(err.splitlines())


def test_the_time_left_does_not_count_compilation(capsys, monkeypatch) -> None:
    """Nor is it said of so little work that another compilation would count for hours of it."""
    monkeypatch.setattr(console, "SECONDS_BETWEEN_LINES", 0.0)
    clock = iter([0.0, 1.0, 60.0, 62.0, 64.0, 66.0])
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    now = [next(clock)]
    with console.progress("evaluate scratch", 1000) as advance:
        for count in (0, 1, 1, 98, 900):  # that it begins, then work
            now[0] = next(clock)
            advance(count)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "evaluate scratch: 0/1000, 1 s",
        "evaluate scratch: 1/1000, 60 s",
        "evaluate scratch: 2/1000, 62 s",
        "evaluate scratch: 100/1000, 64 s, 36 s left",
        "evaluate scratch: 1000/1000, 66 s, 0 s left",
    ]


def test_completion_is_installed_and_knows_the_commands(tmp_path: Path) -> None:
    """In bash: a word that has begun is completed to what there is."""
    words = ["--install-completion", "--shell", "bash"]
    variables = {**os.environ, "HOME": str(tmp_path), "SHELL": "/bin/bash"}
    program = [sys.executable, "-m", "assistax_zoo"]
    subprocess.run([*program, *words], capture_output=True, check=True, cwd=ROOT, env=variables)
    script = """
        source ~/.bashrc
        words() {
            COMP_WORDS=(assistax-zoo "$@"); COMP_CWORD=$#
            _assistax_zoo
            echo "${COMPREPLY[@]}"
        }
        words traj; words plot cr; words evaluate --tas
    """
    completions = subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, env={"HOME": str(tmp_path)}
    )
    expected = ["trajectories", "crossplay", "--task"]
    assert completions.stdout.splitlines()[:3] == expected, completions.stderr
