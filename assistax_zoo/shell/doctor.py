"""Lists the broken, missing and present parts of an installation, one line each."""

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from assistax_base.errors import ZooError, counted, printable, shorten
from assistax_base.extensions import FAMILIES, METHODS, METRICS, TASKS, usable_extensions
from assistax_envs import compiled
from assistax_envs.drawing.gl import CHOICE
from assistax_envs.persons.rows import FAMILIES as OUR_FAMILIES
from assistax_envs.registered import OURS
from assistax_zoo.shell.caches import KINDS, held
from assistax_zoo.shell.installed import all_errors
from assistax_zoo.shell.requirements import extras, missing_of, required_python, version_of
from population.method_presets import METHODS as OUR_METHODS
from zoo.history.merkle import root_problems
from zoo.locations import (
    CACHE_VARIABLE,
    DATA_VARIABLE,
    added_registries,
    added_remote,
    cache_root,
    data_root,
    default_remote,
    registry_path,
)
from zoo.partners.kinds import broken_kinds
from zoo.registry import Registry, load_registry
from zoo.transport.addresses import open_remote
from zoo.transport.remotes import TransientError

State = Literal["broken", "advice", "ok"]
STATES: tuple[State, ...] = ("broken", "advice", "ok")  # as they are listed
PROBE_SECONDS = 120.0  # for JAX to start: a driver may hang
REMOTE_SECONDS = 5.0
LITTLE_ROOM, NO_ROOM = 2_000_000_000, 100_000_000  # bytes of a disk
PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "warp-lang", "flax", "numpy", "polars")
# Extras that are not advised: for work on this project, and for a GPU, of which `jax` speaks.
NOT_ADVISED = ("dev", "docs", "cuda12", "cuda13")
_FATES = {
    "replaced": "no matter, since our programs run without it; robots from outside have it",
    "refused": "our programs do not run under it; unset it",
    "kept": "may change the last bits of a return; manifests name it",
}
_GPU = Path("/proc/driver/nvidia/version")


@dataclasses.dataclass(frozen=True)
class Finding:
    """One line about an installation."""

    topic: str
    state: State
    text: str
    details: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def examine() -> list[Finding]:
    """Return the findings, problems first. Nothing is changed, and no check ends another."""
    findings: list[Finding] = []
    for topic, check in CHECKS.items():
        try:
            findings += check()
        except (ZooError, ValueError, OSError) as error:
            findings.append(Finding(topic, "broken", printable(str(error))))
    return sorted(findings, key=lambda finding: STATES.index(finding.state))


def _python() -> Iterator[Finding]:
    allowed, version = required_python(), ".".join(map(str, sys.version_info[:3]))
    right = allowed is None or allowed.contains(version)
    state = "ok" if right else "broken"
    text = f"Python {version}" if right else f"Python {version}; allowed is {allowed}"
    yield Finding("python", state, f"{text}, {sys.executable}", {"version": version})


def _packages() -> Iterator[Finding]:
    for package in missing_of(""):
        text = f"{package.told}; install it with: pip install '{package.requirement}'"
        yield Finding("packages", "broken", text, {"package": package.name})
    names = ("assistax-zoo", *PACKAGES)
    versions = {name: installed for name in names if (installed := version_of(name))}
    pairs = {versions.get(name, "").rpartition(".")[0] for name in ("mujoco", "mujoco-mjx")}
    if len(pairs) > 1:
        text = f"mujoco {versions.get('mujoco')} and mujoco-mjx {versions.get('mujoco-mjx')}"
        yield Finding("packages", "broken", f"{text} must be of the same minor release")
    text = ", ".join(f"{name} {version}" for name, version in versions.items())
    yield Finding("packages", "ok", text, {"versions": versions})


def _extras() -> Iterator[Finding]:
    there = []
    for name in extras():
        missing = missing_of(name)
        if not missing:
            there.append(name)
        elif name not in NOT_ADVISED:
            text = f"{name} lacks {', '.join(package.told for package in missing)}; install it with"
            yield Finding(
                "extras",
                "advice",
                f"{text}: pip install 'assistax-zoo[{name}]'",
                {"extra": name, "packages": [package.name for package in missing]},
            )
    yield Finding("extras", "ok", f"installed: {', '.join(there) or 'none'}", {"installed": there})


def _additions() -> Iterator[Finding]:
    """Yield a finding for each addition of an installed package that cannot be used.

    Commands and kinds of partners are imported, since every command reads them.
    """
    from assistax_zoo.shell.main import COMMANDS, GROUPS

    errors = [*all_errors(COMMANDS, GROUPS), *broken_kinds()]
    for group, taken in (
        (TASKS, OURS),
        (METHODS, OUR_METHODS),
        (METRICS, ()),
        (FAMILIES, OUR_FAMILIES),
    ):
        errors += usable_extensions(group, taken)[1].values()
    for error in errors:
        yield Finding("additions", "broken", printable(str(error)))
    if not errors:
        yield Finding("additions", "ok", "commands and partner kinds of other packages load")


def _machine() -> Iterator[Finding]:
    probed = _probe()
    yield _jax(probed["jax"])
    if "error" in probed["jax"]:
        return
    yield from _settings(probed["settings"].get("found", {}))
    if error := probed["backend"].get("error"):
        yield Finding("backend", "broken", f"auto: {error}")
        if CHOICE in error:
            return  # MuJoCo is not imported under it, which is said once
    else:
        auto = probed["backend"]["found"]
        yield Finding("backend", "ok", f"auto is {auto}", {"auto": auto})
    yield from _compilers(probed)


def _settings(found: Mapping[str, Sequence[Any]]) -> Iterator[Finding]:
    """Yield a finding for each setting of the process that changes JAX."""
    for name, (value, fate) in found.items():
        details = {"name": name, "value": value, "fate": fate}
        text = f"{name} is {shorten(str(value))}: {_FATES[fate]}"
        yield Finding("settings", "broken" if fate == "refused" else "ok", text, details)
    if not found:
        yield Finding("settings", "ok", "none of the environment changes what JAX computes")


def _compilers(probed: Mapping[str, Any]) -> Iterator[Finding]:
    if reason := probed["fused"].get("found") or probed["fused"].get("error"):
        yield Finding("compilers", "advice", f"the fused engine cannot run here: {reason}")
        return
    for name in ("clang", "nvrtc"):
        if error := probed[name].get("error"):
            yield Finding("compilers", "broken", f"{name} of warp-lang: {error}")
        elif (seconds := probed[name]["found"]) is not None:
            text = f"{name} of warp-lang compiled a small program in {seconds:.1f} s"
            yield Finding("compilers", "ok", text, {"compiler": name, "seconds": seconds})


def _jax(probed: Mapping[str, Any]) -> Finding:
    chosen = os.environ.get("JAX_PLATFORMS", "")
    setting = f" (JAX_PLATFORMS is {shorten(chosen)})" if chosen else ""
    if "error" in probed:
        named = "JAX_PLATFORMS" in probed["error"]
        return Finding("jax", "broken", f"{probed['error']}{'' if named else setting}")
    platform, devices = probed["found"]["platform"], probed["found"]["devices"]
    text = f"{len(devices)} {platform} device{'s' * (len(devices) > 1)}: {devices[0]}{setting}"
    if platform == "cpu" and _GPU.exists() and not chosen:
        text += "; this machine has an NVIDIA GPU, use it with: pip install 'assistax-zoo[cuda12]'"
        return Finding("jax", "advice", text, probed["found"])
    return Finding("jax", "ok", text, probed["found"])


def _probe() -> dict[str, Any]:
    """Return the findings of `assistax_zoo.shell.probe`. A process that fails is JAX's error."""
    root = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(part for part in (root, os.environ.get("PYTHONPATH")) if part)
    command = [sys.executable, "-P", "-m", "assistax_zoo.shell.probe"]
    environment = {**os.environ, "PYTHONPATH": path}
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=PROBE_SECONDS
        )
        return json.loads(done.stdout)
    except subprocess.TimeoutExpired:
        reason = f"JAX did not start within {PROBE_SECONDS:.0f} s"
    except ValueError:
        lines = done.stderr.strip().splitlines() or ["nothing"]
        reason = f"a process with JAX ended with code {done.returncode}: {lines[-1][:300]}"
    return {"jax": {"error": printable(reason)}}


def _cache() -> Iterator[Finding]:
    for kind in KINDS:
        content = held(kind)
        size = f"{counted(content.files, 'file')}, {content.bytes / 1e6:.1f} MB in {content.folder}"
        yield Finding("cache", "ok", f"{kind}: {size}", vars(content))
    own, chosen = str(cache_root() / "xla"), os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if chosen and chosen != own:
        text = f"programs that JAX compiles are kept in {shorten(chosen)}, not in {own}"
        yield Finding("cache", "ok", f"{text}: JAX_COMPILATION_CACHE_DIR says so")


def _disks() -> Iterator[Finding]:
    folders = {"cache": (cache_root(), CACHE_VARIABLE), "data": (data_root(), DATA_VARIABLE)}
    programs = compiled.folder()
    folders["fused engine's cache"] = (programs, compiled.VARIABLE)
    if programs.is_dir() and (reason := compiled.refused(programs)):
        yield Finding("compilers", "broken", reason, {"folder": str(programs)})
    for name, (folder, variable) in folders.items():
        here = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        free = shutil.disk_usage(here).free
        details = {"folder": str(folder), "free_bytes": free}
        text = f"{name} {folder}: {free / 1e9:.1f} GB free"
        if not here.is_dir() or not os.access(here, os.W_OK | os.X_OK):
            text = f"{name} {folder} cannot be written; choose another folder with ${variable}"
            yield Finding("disk", "broken", text, details)
        elif free < LITTLE_ROOM:
            state = "broken" if free < NO_ROOM else "advice"
            text += f"; make room, or choose another folder with ${variable}"
            yield Finding("disk", state, text, details)
        else:
            yield Finding("disk", "ok", text, details)


def _registry() -> Iterator[Finding]:
    registry = load_registry(registry_path())
    yield from _roots("registry", str(registry.path), registry)


def _added() -> Iterator[Finding]:
    for namespace, path in added_registries().items():
        try:
            source = printable(added_remote(namespace) or "no recorded address")
            yield from _roots("added", f"{namespace} of {source}", load_registry(path))
        except (ZooError, OSError, ValueError) as error:
            text = f"{namespace}: {printable(str(error))}; add it again, or: assistax-zoo remove"
            yield Finding("added", "broken", f"{text} {namespace}", {"name": namespace})
    if not added_registries():
        yield Finding("added", "ok", "no zoo of others was added")


def _roots(topic: str, name: str, registry: Registry) -> Iterator[Finding]:
    """Yield findings about a registry: releases that differ from their roots, and the contents."""
    problems = root_problems(registry.data)
    for problem in problems:
        yield Finding(topic, "broken", f"{name}: {printable(problem)}")
    absent = _absent(registry)
    shards = len(registry.data.shards)
    details = {
        "path": str(registry.path),
        "releases": list(registry.data.releases),
        "policies": len(registry.policies),
        "shards": shards,
        "absent_shards": absent,
        "roots": not problems,
    }
    if not problems:
        here = f"{shards - absent} of {counted(shards, 'shard')} here"
        text = f"{counted(len(registry.policies), 'policy')}, {here}, releases"
        text = f"{name}: {text} {', '.join(registry.data.releases)}, roots hold"
        yield Finding(topic, "ok", text, details)


def _absent(registry: Registry) -> int:
    return sum(not registry.shard_path(shard).is_file() for shard in registry.data.shards)


def _absent_by_default() -> int:
    try:
        return _absent(load_registry(registry_path()))
    except ZooError:  # told of the registry itself
        return 0


def _remote() -> Iterator[Finding]:
    name, absent = default_remote(), _absent_by_default()
    if name is None:
        text = (
            f"none is named, and not here: {counted(absent, 'shard')}; name one with: "
            "assistax-zoo config remote hf://org/name"
            if absent
            else "none is named, and none is needed: all shards are here"
        )
        yield Finding("remote", "broken" if absent else "ok", text, {"name": None})
        return
    problem = _unreachable(name)
    state = "ok" if problem is None else "broken" if absent else "advice"
    answer = problem or "it answers"
    yield Finding(
        "remote", state, printable(f"{name}: {answer}"), {"name": name, "answers": not problem}
    )


def _unreachable(name: str) -> str | None:
    """Return the reason why a remote's registry is unreadable; None if it can be read."""
    answers: list[str | None] = []

    def ask() -> None:
        try:
            with open_remote(name).open("registry.json") as (_, chunks):
                next(chunks, b"")
            answers.append(None)
        except (ZooError, TransientError, OSError, ValueError) as error:
            answers.append(str(error))

    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    asking.join(REMOTE_SECONDS)
    return answers[0] if answers else f"no answer within {REMOTE_SECONDS:.0f} s"


CHECKS: dict[str, Callable[[], Iterator[Finding]]] = {
    "python": _python,
    "packages": _packages,
    "extras": _extras,
    "additions": _additions,
    "jax": _machine,
    "cache": _cache,
    "disk": _disks,
    "registry": _registry,
    "added": _added,
    "remote": _remote,
}
