"""The cache by kind, its removal, and what a folder that cannot be written is called."""

import json
import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from assistax_base.locks import locked
from assistax_zoo.shell import main
from assistax_zoo.shell.caches import KINDS, clean, held

OURS = {  # by kind: a file of ours, and one that is not
    "shards": (f"{'a' * 64}.safetensors", "paper.safetensors"),
    "registries": ("lab-0123abcd/registry.json", "lab/registry.json"),
    "references": (f"{'b' * 20}/episodes.parquet", "thesis/references.bib"),
    "xla": ("jit_step-0a1b-cache", "notes.txt"),
    "fused": (f"{'c' * 32}-{'d' * 32}.o", "main.o"),
}


@pytest.fixture
def home(tmp_path: Path, monkeypatch) -> Path:
    """A cache that lies in a folder of the user's, with files of both, and a data folder."""
    monkeypatch.setenv("ASSISTAX_ZOO_CACHE", str(tmp_path / "mine"))
    monkeypatch.setenv("ASSISTAX_ZOO_DATA", str(tmp_path / "mine"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    for kind, names in OURS.items():
        for name in names:
            path = KINDS[kind].folder() / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(b"x" * 1000)
    for name in ("added/lab/registry.json", "config.json", "own/registry.json"):
        path = tmp_path / "mine" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("{}")
    return tmp_path


def files(home: Path) -> set[str]:
    return {str(path.relative_to(home)) for path in home.rglob("*") if path.is_file()}


def test_kinds_are_listed_with_place_and_size(home: Path, capsys) -> None:
    assert main.run(["cache", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert [kind["kind"] for kind in answer["kinds"]] == list(OURS)
    assert {(kind["files"], kind["bytes"]) for kind in answer["kinds"]} == {(1, 1000)}
    assert answer["bytes"] == 5000
    assert main.run(["cache"]) == 0
    assert str(home / "mine/xla") in capsys.readouterr().out


def test_clean_keeps_foreign_files_and_registries(home: Path, capsys) -> None:
    before = files(home)
    assert main.run(["cache", "clean", "--yes", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["removed"], answer["bytes"], answer["busy"]) == (True, 4000, [])
    gone = {
        str((KINDS[kind].folder() / names[0]).relative_to(home))
        for kind, names in OURS.items()
        if kind != "registries"
    }
    assert before - files(home) == gone
    assert main.run(["cache", "clean", "--what", "registries", "--yes"]) == 0
    assert before - files(home) == {*gone, "mine/registries/lab-0123abcd/registry.json"}


def test_clean_needs_yes_and_a_known_kind(home: Path, capsys) -> None:
    before = files(home)
    assert main.run(["cache", "clean"]) == 0
    assert "add --yes to remove" in capsys.readouterr().out
    assert main.run(["cache", "clean", "--what", "data", "--yes"]) == 1
    printed = capsys.readouterr().err
    assert all(kind in printed for kind in OURS) and "'data'" in printed
    assert files(home) == before
    assert main.run(["cache", "clean", "--what", "xla", "--yes"]) == 0
    assert before - files(home) == {"mine/xla/jit_step-0a1b-cache"}


def test_link_is_removed_without_its_target(home: Path) -> None:
    other = home / "precious"
    other.mkdir()
    (other / "episodes.parquet").write_bytes(b"x" * 5000)
    (KINDS["references"].folder() / ("e" * 20)).symlink_to(other)
    assert held("references").bytes < 5000
    clean("references")
    assert (other / "episodes.parquet").is_file()


def test_locked_references_stay(home: Path) -> None:
    folder = KINDS["references"].folder() / ("b" * 20)
    with locked(folder):
        removed, busy = clean("references")
    assert busy == [str(folder)] and removed.files == 0
    assert (folder / "episodes.parquet").is_file()
    assert clean("references")[1] == []
    assert not folder.exists()


@pytest.fixture
def read_only(tmp_path: Path) -> Iterator[Path]:
    """A folder that nobody can write to, root neither."""
    folder = tmp_path / "read-only"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(folder)]
    if os.getuid() != 0:
        folder.chmod(stat.S_IRUSR | stat.S_IXUSR)
        yield folder
        folder.chmod(stat.S_IRWXU)
        return
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("may not mount a file system")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_unwritable_cache_names_its_variable(read_only: Path) -> None:
    """Of the fused engine's programs, when they are compiled."""
    from assistax_envs import compiled

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(read_only))
        with pytest.raises(OSError, match=r"read-only/assistax-zoo/fused .*XDG_CACHE_HOME"):
            compiled.cached("k", ".o", lambda path: None)


def planted_command(cache: Path, tmp_path: Path) -> subprocess.CompletedProcess[str]:
    """Run a command that compiles three programs, with a cache."""
    (tmp_path / "planted.py").write_text(
        "import jax\n"
        "def planted():\n"
        "    for shift in range(3): jax.jit(lambda x: x + shift)(1.0)\n"
        "    print('done')\n"
    )
    script = "import sys; from assistax_zoo.shell import main; sys.argv[1:] = ['planted']\n"
    script += "from assistax_zoo.__main__ import start\n"
    script += "main.COMMANDS['planted'] = 'planted:planted'; sys.exit(start())"
    removed = ("JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS")
    environment = {name: value for name, value in os.environ.items() if name not in removed}
    environment |= {
        "ASSISTAX_ZOO_CACHE": str(cache),
        "PYTHONWARNINGS": "",  # as for users
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "PYTHONPATH": os.pathsep.join((str(tmp_path), os.getcwd())),
    }
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (0, "done\n"), done.stderr
    return done


def test_unwritable_program_cache_warns_once(read_only: Path, tmp_path: Path) -> None:
    """Of the command, however many programs JAX compiles; it goes on without."""
    done = planted_command(read_only / "zoo", tmp_path)
    [line] = done.stderr.splitlines()
    assert line.startswith(f"warning: compiled programs are not kept in {read_only}/zoo/xla (")
    assert line.endswith("choose another cache with $ASSISTAX_ZOO_CACHE")


def test_damaged_cached_program_is_compiled_again(tmp_path: Path) -> None:
    """As a full disk leaves it, or a writer that was killed; JAX itself never replaces it."""
    assert planted_command(tmp_path / "zoo", tmp_path).stderr == ""
    whole = {path: path.stat().st_size for path in (tmp_path / "zoo/xla").glob("jit_*-cache")}
    for path in whole:
        os.truncate(path, 100)
    assert whole and planted_command(tmp_path / "zoo", tmp_path).stderr == ""
    assert {path: path.stat().st_size for path in whole} == whole
