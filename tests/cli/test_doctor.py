"""`doctor` finds what is broken and names what mends it, and says so by its exit code."""

import json
import os
import re
import shutil
import sys
import tomllib
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import pytest

from assistax_base.extensions import COMMANDS, HEADS, METHODS, PARTNERS, TASKS
from assistax_envs import compiled
from assistax_zoo.shell import doctor, main, requirements
from tests.zoo.conftest import put, trained_teams

ROOT = Path(__file__).parents[2]
PROBE = doctor._probe  # the real one, which is replaced for most tests
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
WELL = {
    "jax": {"found": {"platform": "cpu", "devices": ["cpu"]}},
    "settings": {"found": {}},
    "backend": {"found": "fused"},
    "fused": {"found": None},
    "clang": {"found": 0.1},
    "nvrtc": {"found": None},
}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch) -> Path:
    """A registry of eight teams and empty folders, on a machine whose JAX runs."""
    put(trained_teams(), tmp_path / "registry.json")
    for variable in ("CACHE", "DATA"):
        monkeypatch.setenv(f"ASSISTAX_ZOO_{variable}", str(tmp_path / variable.lower()))
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(tmp_path / "registry.json"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.delenv("ASSISTAX_ZOO_REMOTE", raising=False)
    # The probe is a process of some seconds; its answer is what differs here.
    monkeypatch.setattr(doctor, "_probe", lambda: WELL)
    return tmp_path


def examined(capsys, code: int = 0) -> dict[str, list[dict[str, Any]]]:
    """Run `doctor --json`; return its findings by topic."""
    try:
        status = main.run(["doctor", "--json"])
    except SystemExit as ended:
        status = ended.code
    answer = json.loads(capsys.readouterr().out)
    assert (status, answer["ok"]) == (code, code == 0), answer["findings"][:3]
    topics: dict[str, list[dict[str, Any]]] = {}
    for finding in answer["findings"]:
        assert "\n" not in finding["text"]
        topics.setdefault(finding["topic"], []).append(finding)
    return topics


def test_a_sound_installation_has_nothing_broken(here: Path, capsys) -> None:
    before = {path: path.stat().st_mtime_ns for path in here.rglob("*")}
    topics = examined(capsys)
    assert {path: path.stat().st_mtime_ns for path in here.rglob("*")} == before
    expected = "python packages extras jax backend compilers cache disk registry added remote"
    assert topics.keys() >= {*expected.split(), "additions"}
    assert topics["backend"][0]["details"] == {"auto": "fused"}
    registry = topics["registry"][0]["details"]
    assert (registry["roots"], registry["absent_shards"]) == (True, 0)
    assert registry["releases"] == ["v0"]
    kinds = [finding["details"]["kind"] for finding in topics["cache"] if finding["details"]]
    assert kinds == ["shards", "registries", "references", "xla", "fused"]


@pytest.mark.parametrize(
    ("group", "name"),
    [(COMMANDS, "forces"), (HEADS, "plot"), (PARTNERS, "test"), (METHODS, "gru"), (TASKS, "The")],
)
def test_broken_additions_of_packages_are_named(
    group: str,
    name: str,
    install_package: Callable[..., None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    install_package(group, name, "textwrap:nothing")
    [finding] = examined(capsys, 1)["additions"]
    assert f"{name!r} of the package outside 0.3 (textwrap:nothing)" in finding["text"]


def test_problems_come_first_and_end_with_1(here: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(doctor, "_probe", lambda: {"jax": {"error": "no devices"}})
    with pytest.raises(SystemExit) as ended:
        main.run(["doctor"])
    lines = capsys.readouterr().out.splitlines()
    assert ended.value.code == 1
    assert re.fullmatch(r"broken +jax +no devices.*", lines[0])
    assert lines[-1] == "1 broken"
    states = [line.split()[0] for line in lines[:-1]]
    assert states == sorted(states, key=doctor.STATES.index)


@pytest.mark.slow_for(
    "cuda", "docs", "lerobot", "sb3", "wandb", "sign", "ray", "minari", "tensorboard"
)
@pytest.mark.parametrize("name", sorted(PROJECT["optional-dependencies"]))
def test_missing_extra_names_its_installation(name: str, monkeypatch, capsys) -> None:
    package = re.match(r"[\w-]+", PROJECT["optional-dependencies"][name][-1])
    assert package is not None
    lacks, version_of = package[0].lower(), requirements.version_of

    def found(name: str) -> str | None:
        return None if name.lower() == lacks else version_of(name)

    monkeypatch.setattr(requirements, "ELSEWHERE", ())  # the board always needs some of them
    monkeypatch.setattr(requirements, "version_of", found)
    advice = [f for f in examined(capsys)["extras"] if f["state"] == "advice"]
    missing = {finding["details"]["extra"]: finding["text"] for finding in advice}
    if name in doctor.NOT_ADVISED:
        assert name not in missing
    else:
        assert missing[name].endswith(f"pip install 'assistax-zoo[{name}]'")
        assert lacks in missing[name].lower()


def test_a_package_that_is_too_old_is_broken(monkeypatch, capsys) -> None:
    version_of = requirements.version_of
    old = {"polars": "1.0.0", "mujoco-mjx": "3.16.0", "uvicorn": "0.1"}
    for module in (requirements, doctor):
        monkeypatch.setattr(module, "version_of", lambda name: old.get(name) or version_of(name))
    findings = examined(capsys, 1)["packages"]
    broken = [finding["text"] for finding in findings if finding["state"] == "broken"]
    assert "mujoco-mjx 3.16.0; install it with: pip install 'mujoco-mjx>=3.17'" in broken
    assert "polars 1.0.0; install it with: pip install 'polars>=2'" in broken
    assert any(text.startswith("uvicorn 0.1; install it with: pip install ") for text in broken)
    assert broken[-1].endswith("mujoco-mjx 3.16.0 must be of the same minor release")
    assert len(broken) == 4


def test_uninstalled_checkout_is_named(monkeypatch, capsys) -> None:
    def unknown(name: str) -> None:
        raise PackageNotFoundError(name)

    for name in ("metadata", "requires"):
        monkeypatch.setattr(requirements, name, unknown)
    assert "pip install -e ." in examined(capsys, 1)["packages"][0]["text"]


def test_changed_registry_is_broken(here: Path, capsys) -> None:
    path = here / "registry.json"
    path.write_text(path.read_text().replace("950.5", "951.5", 1))
    assert "expected root" in examined(capsys, 1)["registry"][0]["text"]


@pytest.mark.slow
def test_changed_added_zoo_is_broken(here: Path, capsys) -> None:
    shutil.copytree(here / "zoo", here / "lab/zoo")
    shutil.copy(here / "registry.json", here / "lab/registry.json")
    assert main.run(["add", str(here / "lab"), "--as", "lab"]) == 0
    capsys.readouterr()
    assert examined(capsys)["added"][0]["details"]["policies"] == 16
    path = here / "data/added/lab/registry.json"
    path.write_text(path.read_text().replace("950.5", "951.5", 1))
    assert "expected root" in examined(capsys, 1)["added"][0]["text"]
    path.write_text("{")
    assert "assistax-zoo remove lab" in examined(capsys, 1)["added"][0]["text"]


@pytest.mark.slow
def test_a_remote_matters_where_shards_are_missing(here: Path, monkeypatch, capsys) -> None:
    assert examined(capsys)["remote"][0]["state"] == "ok"
    shutil.move(here / "zoo", here / "elsewhere")
    remote = examined(capsys, 1)["remote"][0]
    assert "assistax-zoo config remote" in remote["text"]
    monkeypatch.setenv("ASSISTAX_ZOO_REMOTE", str(here / "nothing"))
    assert examined(capsys, 1)["remote"][0]["details"]["answers"] is False
    monkeypatch.setenv("ASSISTAX_ZOO_REMOTE", str(here))
    assert examined(capsys)["remote"][0]["details"]["answers"] is True


def test_a_remote_that_hangs_is_left(monkeypatch, capsys) -> None:
    import socket

    monkeypatch.setattr(doctor, "REMOTE_SECONDS", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"http://127.0.0.1:{silent.getsockname()[1]}"
        monkeypatch.setenv("ASSISTAX_ZOO_REMOTE", address)
        [remote] = examined(capsys)["remote"]
    assert remote["state"] == "advice" and "no answer within" in remote["text"]


def test_unwritable_folder_names_its_variable(here: Path, monkeypatch, capsys) -> None:
    (here / "cache").write_text("a file in the place of a folder")
    [broken] = [finding for finding in examined(capsys, 1)["disk"] if finding["state"] == "broken"]
    assert "$ASSISTAX_ZOO_CACHE" in broken["text"]


@pytest.mark.parametrize(("free", "state", "code"), [(10**9, "advice", 0), (10**7, "broken", 1)])
def test_a_disk_with_little_room_is_named(
    free: int, state: str, code: int, monkeypatch, capsys
) -> None:
    usage = type("Usage", (), {"free": free})
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda path: usage)
    assert {finding["state"] for finding in examined(capsys, code)["disk"]} == {state}


def test_programs_that_others_may_write_are_broken(here: Path, capsys) -> None:
    compiled.folder().mkdir(parents=True)
    compiled.folder().chmod(0o777)
    assert "XDG_CACHE_HOME" in examined(capsys, 1)["compilers"][0]["text"]


@pytest.mark.parametrize(
    ("variable", "value"), [("JAX_PLATFORMS", "nothing"), ("XLA_FLAGS", "--xla_of_no_kind=1")]
)
def test_a_jax_that_does_not_start_is_one_line(variable: str, value: str, monkeypatch) -> None:
    """XLA ends the process: not this one."""
    monkeypatch.undo()
    monkeypatch.setenv(variable, value)
    # The machine's part alone, whose process is a real one here.
    [finding] = doctor._machine()
    assert (finding.topic, finding.state) == ("jax", "broken")
    assert value.strip("-=1") in finding.text


def test_a_driver_that_hangs_is_left(monkeypatch) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(doctor, "PROBE_SECONDS", 0.01)
    [finding] = doctor._machine()
    assert finding.state == "broken" and finding.text.startswith("JAX did not start within 0 s")


def test_compilers_really_compile(monkeypatch) -> None:
    """Planted: a compiler whose program gives another number."""
    from assistax_envs.physics.fused.runtime import toolchain
    from assistax_zoo.shell.probe import PARTS

    assert PARTS["clang"]() < 60
    compile_cpp = toolchain.compile_cpp
    monkeypatch.setattr(
        toolchain, "compile_cpp", lambda text, *rest: compile_cpp(text.replace("42", "41"), *rest)
    )
    with pytest.raises(RuntimeError, match="another number"):
        PARTS["clang"]()


def test_a_gpu_that_jax_does_not_use_is_named(monkeypatch, capsys) -> None:
    # The device's file of a GPU that this machine lacks.
    monkeypatch.setattr(doctor, "_GPU", Path("/proc/self/status"))
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    [finding] = examined(capsys)["jax"]
    assert finding["state"] == "advice" and "assistax-zoo[cuda12]" in finding["text"]


def test_no_secret_is_printed(monkeypatch, capsys) -> None:
    for name in ("ASSISTAX_ZOO_TOKEN", "HF_TOKEN"):
        monkeypatch.setenv(name, "azt_secret")
    examined(capsys)
    main.run(["doctor"])
    assert "azt_secret" not in capsys.readouterr().out
    assert os.environ["HF_TOKEN"] == "azt_secret"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("variable", "value", "topic", "text"),
    [
        ("MUJOCO_GL", "nonsense", "backend", r"MUJOCO_GL is 'nonsense'.*; set it to egl or osmesa"),
        ("JAX_PLATFORMS", "nonsense", "jax", r"no device of JAX_PLATFORMS=nonsense.*; unset"),
        ("JAX_HIGH_DYNAMIC_RANGE_GUMBEL", "1", "settings", r"do not run under it; unset it"),
    ],
)
def test_a_wrong_variable_is_one_clear_line(
    variable: str, value: str, topic: str, text: str, monkeypatch, capsys
) -> None:
    monkeypatch.setattr(doctor, "_probe", PROBE)
    monkeypatch.setenv(variable, value)
    topics = examined(capsys, 1)
    broken = [f["text"] for found in topics.values() for f in found if f["state"] == "broken"]
    assert len(broken) == 1 and broken[0] == topics[topic][0]["text"]
    assert re.search(text, broken[0]) and "Error" not in broken[0]


@pytest.mark.slow
def test_settings_are_named_with_what_they_matter(monkeypatch, capsys) -> None:
    monkeypatch.setattr(doctor, "_probe", PROBE)
    monkeypatch.setenv("JAX_ENABLE_X64", "1")
    monkeypatch.setenv("JAX_OPTIMIZATION_LEVEL", "O1")
    found = {f["details"]["name"]: f for f in examined(capsys)["settings"]}
    assert "our programs run without it" in found["jax_enable_x64"]["text"]
    assert "manifests name it" in found["jax_optimization_level"]["text"]
    assert {f["state"] for f in found.values()} == {"ok"}


@pytest.mark.parametrize("remote", ["https://127.0.0.1:9/zoo", "hf://org/name"])
def test_a_proxy_of_another_protocol_names_its_package(remote: str, monkeypatch, capsys) -> None:
    from huggingface_hub.utils import close_session

    monkeypatch.setitem(sys.modules, "socksio", None)
    monkeypatch.setenv("ALL_PROXY", "socks5://127.0.0.1:9")
    monkeypatch.setenv("ASSISTAX_ZOO_REMOTE", remote)
    close_session()  # which keeps the proxies of its beginning
    [finding] = examined(capsys)["remote"]
    close_session()
    assert finding["state"] == "advice" and "pip install socksio, or unset" in finding["text"]
    main.run(["fetch", "--from", remote])
    said = capsys.readouterr().err
    assert "pip install socksio" in said and "unexpected" not in said
