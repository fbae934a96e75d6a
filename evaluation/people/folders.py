"""Episodes of people as result folders, one for each task and robot, like those of `evaluate`."""

import importlib.metadata
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.digest import json_sha256
from assistax_envs.models.build import scene_sha256
from evaluation.cast.met_partners import MetPartners
from evaluation.figures.saved_tables import save_evaluation
from evaluation.figures.summary import Context, EvaluationSummary
from evaluation.people.grouping import PEOPLE, Placed, persons_of
from evaluation.people.playing import environment
from evaluation.people.robots import SeatRobot
from evaluation.play.jobs import EVALUATOR_VERSION
from evaluation.play.rows import with_columns
from evaluation.record import manifest, tables
from evaluation.record.record import Record
from zoo.partners.person_ids import OWN
from zoo.registry import Registry

DESCRIBED = ("team", "algorithm", "disability", "seed")  # of a robot, beside its id
SIDE = "test"  # no robot met a visitor in training
NO_PROOF = "people of logs: each log fits its episode, and no log proves that a person played"


def robot_folder(out: Path, task: str, robot: SeatRobot) -> Path:
    """Return the folder of a robot's episodes below `out`."""
    return out / task / (robot.member.team or robot.member.id).split("/")[-1]


def save_people(
    out: Path,
    placed: Sequence[Placed],
    registry: Registry,
    also: Callable[[Path, Sequence[Placed]], Any] | None = None,
) -> dict[Path, EvaluationSummary]:
    """Write a result folder for each task and robot of some episodes, and return the summaries.

    Args:
        out: A folder; what it holds of the same task and robot is replaced.
        placed: The episodes.
        registry: The registry of the robots.
        also: Called with each result folder and its episodes, in the order of its table.
    """
    by_robot: dict[tuple[str, str], list[Placed]] = {}
    for one in placed:
        key = one.replayed.recorded.log.task, one.replayed.robot.member.id
        by_robot.setdefault(key, []).append(one)
    summaries = {}
    for (task, _), mine in sorted(by_robot.items()):
        folder = robot_folder(out, task, mine[0].replayed.robot)
        mine.sort(key=lambda one: (one.partner, one.episode))
        summaries[folder] = _save(folder, task, mine, registry)
        if also is not None:
            also(folder, mine)
    return summaries


def episode_table(placed: Iterable[Placed]) -> pl.DataFrame:
    """Return the episodes of people as a table, one row each."""
    placed = sorted(placed, key=lambda one: (one.partner, one.episode))
    logs = [one.replayed for one in placed]
    seat = {"ego": "id"} | {f"ego_{name}": name for name in DESCRIBED}
    columns = {name: [getattr(one.robot.member, of) for one in logs] for name, of in seat.items()}
    columns |= {
        "partner": [one.partner for one in placed],
        "partner_team": [f"{PEOPLE}/{one.person}" for one in placed],
        "partner_algorithm": [PEOPLE] * len(placed),
        "partner_disability": [OWN] * len(placed),
        "partner_seed": [None] * len(placed),
        "side": [SIDE] * len(placed),
        "episode": [one.episode for one in placed],
        "key": [one.recorded.log.start for one in logs],
    }
    columns |= {name: [one.figures[name] for one in logs] for name in logs[0].figures}
    first = pl.DataFrame({"ego": columns["ego"]})
    return with_columns(first, columns)


def _save(folder: Path, task: str, placed: list[Placed], registry: Registry) -> EvaluationSummary:
    """Write the result folder of one robot."""
    env, robot = environment(task), placed[0].replayed.robot
    table = episode_table(placed)
    _check_free(folder)
    for name in tables.FILES:
        (folder / name).unlink(missing_ok=True)
    identity = _identity(env, robot, placed)
    folder.mkdir(parents=True, exist_ok=True)
    logs = {one.replayed.recorded.sha256: one.partner for one in placed}
    about = {"job": manifest.identity_digest(identity), "identity": identity, "logs": logs}
    manifest.write_manifest(folder, about)
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    context = Context(task=task, env_version=env.version, backend=env.backend, engine=env.engine)
    record = Record(tables.read_episodes(folder / tables.EPISODES_FILE), folder)
    met, notes = MetPartners(("registry",)), [NO_PROOF, *_wish_notes(placed)]
    summary = save_evaluation(record, context, met=met, notes=notes)
    entries = [robot.card] if robot.card else []
    files = [one.replayed.recorded.path for one in placed]
    sources = manifest.describe_sources(registry, entries, None, files)
    manifest.seal(folder, sources=sources, made_with=manifest.describe_machine())
    return summary


def _check_free(folder: Path) -> None:
    """Refuse a folder that holds results of other partners than people."""
    held = (folder / tables.EPISODES_FILE).exists()
    if held and not ((manifest.read_manifest(folder) or {}).get("identity") or {}).get(PEOPLE):
        raise ValueError(f"{folder} holds results that are not of people; choose another folder")


def _identity(env: Any, robot: SeatRobot, placed: Sequence[Placed]) -> dict[str, Any]:
    """Return the identity of a table of people, in the form of `jobs.Job.identity`."""
    wishes = {one.partner: one.replayed.recorded.log.wish for one in placed}
    episodes = {one.episode for one in placed}
    return {
        "evaluator_version": EVALUATOR_VERSION,
        "task": env.task,
        "env_version": env.version,
        "backend": env.backend,
        "engine": env.engine,
        "scene": scene_sha256(env.task),
        "episodes": len(episodes),
        "paired": False,
        PEOPLE: True,
        "egos": [[robot.member.id, robot.member.digest]],
        "partners": [
            [partner, OWN, SIDE, json_sha256([partner, wish]), None]
            for partner, wish in sorted(wishes.items())
        ],
        "software": {name: importlib.metadata.version(name) for name in ("jax", "mujoco")},
    }


def _wish_notes(placed: Sequence[Placed]) -> list[str]:
    """Return a note if intervals take one person with several wishes for several persons."""
    persons, partners = len([*persons_of(placed)]), len({one.partner for one in placed})
    if persons == partners:
        return []
    return [
        f"{partners} partners are {persons} people, some with several wishes: intervals take each "
        "for a person of its own, and are too narrow"
    ]
