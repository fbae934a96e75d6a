"""The wheel, installed in an environment of its own, used in another folder with a remote."""

import functools
import http.server
import os
import subprocess
import sys
import sysconfig
import threading
import venv
from collections.abc import Iterator
from pathlib import Path

import pytest

from zoo.registry import load_registry

ROOT = Path(__file__).parents[2]
TEAM = "scratch/ippo-d1-s0-v1"
PARTNERS = "scratch/ippo-d1-s[01]-v1/human"
PLAY = ("--task", "scratch", "--episodes", "1", "--backend", "native")
SCRIPT = f"""
import numpy as np
import assistax_zoo as az

assert az.open_zoo().partner({TEAM!r}).act(np.zeros((2, 38), np.float32)).shape == (2, 3)
options = dict(task="scratch", episodes=1, backend="native", progress=False)
result = az.evaluate(lambda obs: np.zeros((len(obs), 7)), split="both", partners={PARTNERS!r},
                     references=False, **options)
assert result.episodes.height == 2
result.report("mine.html")
az.cross_play("{TEAM}/robot", "{TEAM}/human", **options).plot("xp.png")
print(az.__file__)
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a virtual environment with the wheel, and dependencies from the running one."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]
    options = ["--quiet", "--no-deps", "--no-index"]
    build = [*pip, "wheel", *options, "--no-build-isolation", "--wheel-dir", str(folder / "dist")]
    subprocess.run([*build, str(ROOT)], check=True, timeout=300)
    venv.create(folder / "venv")
    [packages] = (folder / "venv/lib").glob("python*/site-packages")
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib"))
    [wheel] = (folder / "dist").glob("*.whl")
    python = str(folder / "venv/bin/python")
    subprocess.run([*pip, "--python", python, "install", *options, str(wheel)], check=True)
    return folder / "venv/bin"


@pytest.fixture(scope="module")
def remote() -> Iterator[str]:
    """Serve the checkout, which has the layout of a remote."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(ROOT))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.mark.slow
def test_a_wheel_does_the_three_jobs_with_a_remote(
    environment: Path, remote: str, tmp_path: Path
) -> None:
    ours = ("PYTHONPATH", "ASSISTAX_", "XDG_")
    clean = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    clean |= {"HOME": str(tmp_path / "home"), "JAX_PLATFORMS": "cpu"}
    (tmp_path / "work").mkdir()

    def call(*words: str, code: int = 0) -> str:
        done = subprocess.run(
            [str(environment / words[0]), *words[1:]], cwd=tmp_path / "work", env=clean,
            capture_output=True, text=True, timeout=600,
        )  # fmt: skip
        assert done.returncode == code, done.stderr
        return done.stderr if code else done.stdout

    assert f"{len(load_registry().policies)} policies" in call("assistax-zoo", "list")
    evaluate = ("assistax-zoo", "evaluate", *PLAY, "--policy", f"{TEAM}/robot", "--split", "both")
    evaluate = (*evaluate, "--partners", PARTNERS, "--include-own", "--out", "results")
    told = call(*evaluate, code=1)
    assert "parameters of 4 of 4 policies" in told and "--fetch does so" in told
    assert "--from FOLDER" in call(*evaluate, "--fetch", code=1)
    assert call("assistax-zoo", "config", "remote", remote) == f"{remote}\n"
    assert "M_test" in call(*evaluate, "--fetch")
    teams = ("--egos", "scratch/ippo-d1-s[01]-v1", "--partners", PARTNERS)
    assert "cross-play" in call("assistax-zoo", "crossplay", *PLAY, *teams, "--out", "xp")
    call("assistax-zoo", "plot", "crossplay", "xp", "--out", "xp.pdf")
    call("assistax-zoo", "report", "results", "--out", "results.html")
    call("assistax-zoo", "show", TEAM, "--card", "card.md")
    assert call("python", "-c", SCRIPT).startswith(str(environment.parent))
    for name in ("xp.pdf", "results.html", "mine.html", "xp.png", "card.md"):
        assert (tmp_path / "work" / name).stat().st_size > 500
