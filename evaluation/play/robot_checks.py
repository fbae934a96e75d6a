"""Checks of robots from outside: unchanged files, and the dependence of their answers.

A robot of code may load more files as it plays. Its answers may depend on chance, on earlier calls
or on other episodes. All of that is allowed and recorded in the manifest under `robots`, from which
a summary's notes are made.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from assistax_base.errors import listing
from evaluation.cast.egos import EgoError
from evaluation.cast.onnx_robots.admission import read_program
from evaluation.cast.onnx_robots.program import OnnxProgram
from evaluation.cast.policy_process import PolicyError
from evaluation.cast.roster import HostEgo, Roster
from evaluation.record.manifest import file_sha256, read_manifest, write_manifest
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack, flatten
from population.networks.tensors import row_sha256

ROWS, STEPS = 4, 2  # size of the random observations
TOLERANCE = 1e-3  # for actions: rows of a batch are rounded differently
NOTES = {
    "calls": "answers the same observations differently after a reset, by chance or by what it saw "
    "before: another run gives other figures",
    "rows": "answers by other rows of observations or by a row's place, which are other episodes: "
    "figures depend on how many are played at once",
    "unknown": "fails on made-up observations, so it is not known whether its answers depend on "
    "chance, earlier calls or other episodes",
}


def check_distinct(egos: Roster) -> None:
    """Check that all robots differ, because seeds of a method are different robots.

    Raises:
        ValueError: Two ids are the same robot.
    """
    graphs = any(isinstance(stack.spec, OnnxProgram) for stack in egos.policies)
    seen: dict[Any, str] = {}
    for stack in egos.stacks:
        for row, name in enumerate(stack.ids):
            made_of = [stack.made_of] if isinstance(stack, HostEgo) else _network(stack, row)
            if graphs and isinstance(stack, PolicyStack) and isinstance(stack.spec, PolicySpec):
                made_of += _exported(stack.spec, stack.row(row))
            for content in made_of:
                if content is not None and seen.setdefault(content, name) != name:
                    raise ValueError(
                        f"{seen[content]} and {name} are the same robot, and seeds of one method "
                        "are different ones; give it once"
                    )


def _network(stack: PolicyStack, row: int) -> list[Any]:
    return [(stack.spec, row_sha256(flatten(stack.row(row))))]


def _exported(spec: PolicySpec, params: Mapping[str, Any]) -> list[Any]:
    """Return the key of a network's ONNX export (program, weights' sha256), or [] without export.

    A network and its exported file are the same robot.
    """
    # Imported here because it loads Flax.
    from population.networks.onnx_export import to_onnx

    try:
        program, weights = read_program(to_onnx(spec, params))
    except ValueError:
        return []
    return [(program, row_sha256(flatten(weights)))]


def check_files(egos: Roster) -> dict[str, dict[str, str]]:
    """Return the code files that robots loaded late, outside their digests: path to sha256, by id.

    Raises:
        EgoError: A robot's file changed after the robot was made.
    """
    loaded: dict[str, dict[str, str]] = {}
    for ego in egos.hosts:
        known = {path.resolve(): sha256 for path, sha256 in egos.members[ego.id].files}
        try:
            now = ego.loaded()
        except PolicyError as error:
            raise EgoError(f"{ego.id}: {error}") from None
        for path, sha256 in now.items():
            _check_same(ego.id, path, known.get(path, sha256), sha256)
        more = {str(path): sha256 for path, sha256 in now.items() if path not in known}
        loaded |= {ego.id: more} if more else {}
    for name in egos.ids:
        now = [*egos.members[name].files, *loaded.get(name, {}).items()]
        for path, sha256 in now:
            current = file_sha256(Path(path)) if Path(path).is_file() else "none"
            _check_same(name, Path(path), sha256, current)
    return loaded


def note_files(folder: Path, egos: Roster) -> None:
    """Check robots' files, and write the files that they loaded late into a manifest."""
    if not (loaded := check_files(egos)):
        return
    manifest = read_manifest(folder) or {}
    recorded = manifest.get("robots", {})
    updated = {**recorded, "loaded": {**recorded.get("loaded", {}), **loaded}}
    if updated != recorded:
        write_manifest(folder, {**manifest, "robots": updated})


def changed_file(folder: Path) -> tuple[str, str] | None:
    """Return the first robot and late-loaded file that changed since; None if all are the same."""
    loaded = (read_manifest(folder) or {}).get("robots", {}).get("loaded", {})
    for robot, files in loaded.items():
        for path, sha256 in files.items():
            if not Path(path).is_file() or file_sha256(Path(path)) != sha256:
                return robot, path
    return None


def describe_robots(folder: Path, egos: Roster, observation_size: int) -> dict[str, Any]:
    """Return the manifest's field `robots`: late-loaded files and answers that vary, if any.

    Raises:
        EgoError: A robot's file changed.
    """
    recorded = (read_manifest(folder) or {}).get("robots", {})
    findings = {
        "loaded": {**recorded.get("loaded", {}), **check_files(egos)},
        "varies": varying(egos, observation_size),
    }
    return {name: value for name, value in findings.items() if value}


def varying(egos: Roster, observation_size: int) -> dict[str, str]:
    """Return a key of `NOTES` for each robot whose answers depend on more than their episode.

    The test runs between two resets, so it leaves the robots' memory empty.
    """
    found = {ego.id: _varies(ego, observation_size) for ego in egos.hosts}
    return {name: reason for name, reason in found.items() if reason}


def robot_notes(about: Any, egos: Roster) -> list[str]:
    """Return a summary's notes on robots; `about` is the manifest's untrusted field `robots`."""
    parts = [about.get(name) if isinstance(about, dict) else None for name in ("varies", "loaded")]
    varies, loaded = (part if isinstance(part, dict) else {} for part in parts)
    notes = [f"{name} {NOTES[what]}" for name in egos.ids if (what := varies.get(name)) in NOTES]
    for name in egos.ids:
        if isinstance(files := loaded.get(name), dict):
            names = listing(sorted(Path(path).name for path in files), 3)
            notes.append(
                f"{name} loaded {names} only while it played, which its digest does not cover: "
                "import it together with its module, or name it in DEPENDS"
            )
    return notes


def _varies(ego: HostEgo, observation_size: int) -> str | None:
    """Return the key of `NOTES` that holds for a robot's answers, or None if they do not vary.

    The robot plays random rows twice, and again beside other rows at other places of the batch.
    """
    rng = np.random.default_rng(0)
    shape = (2, STEPS, ROWS, observation_size)
    obs, company = rng.normal(size=shape).astype(np.float32)
    company[:, [3, 2]] = obs[:, [0, 1]]

    def play(observations: np.ndarray) -> np.ndarray:
        ego.act.reset(ROWS)
        return np.stack([ego.act(rows.copy()) for rows in observations]).astype(np.float64)

    try:
        with ego.act.playing():
            first, beside, again = play(obs), play(company), play(obs)
            ego.act.reset(ROWS)
        if not _same(first, again):
            return "calls"
        return None if _same(first[:, [0, 1]], beside[:, [3, 2]]) else "rows"
    # A robot's code must not end a run.
    except (Exception, SystemExit, GeneratorExit):
        return "unknown"


def _same(one: np.ndarray, other: np.ndarray) -> bool:
    return np.allclose(one, other, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True)


def _check_same(robot: str, path: Path, before: str, now: str) -> None:
    if before != now:
        raise EgoError(
            f"{path}, a file of {robot}, changed while the robot played: its sha256 was "
            f"{before[:12]}, it is {now[:12]}; nothing was sealed, and finished parts are kept: "
            "put the file back and repeat to go on, or play the new one into another folder"
        )
