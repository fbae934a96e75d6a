"""Recorded episodes of a pair, step by step, for imitation and for studies."""

import dataclasses
import json
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from assistax_base.files import METADATA_KEY
from assistax_zoo.datasets import check_place, write_dataset
from assistax_zoo.zoos import Zoo, open_zoo

if TYPE_CHECKING:
    import polars as pl

    from evaluation.cast.seats import Seated
    from evaluation.film import Pair
    from evaluation.people.grouping import Placed
    from evaluation.people.steps import Recordings


def trajectories(
    robot: str,
    human: str,
    *,
    task: str,
    out: Path | str | None = None,
    episodes: int = 8,
    steps: int | None = None,
    seed: int = 0,
    disability: str | None = None,
    preference: str | None = None,
    backend: str = "auto",
    zoo: "str | Path | Zoo | None" = None,
    format: str = "parquet",
    on_step: Callable[[], None] | None = None,
) -> "pl.DataFrame":
    """Play a pair by its most likely actions; return a row of each step for both seats.

    Columns: `episode`, `step`, `ROLE_observation` and `ROLE_action` of both roles, `reward`,
    `term_NAME` of each, `force` (N), `terminated`, `truncated`, `nonfinite`. Of gentle tasks
    `word`, what the human says with its action, a code of `preferences.WORDS`. What players of
    the episode show: `pose` and `velocity` of all joints, `target_NAME` (m), `wish_NAME`, `speed`
    (m/s). A row has what was before a step and what the step gave, an episode's last row what was
    in the end alone.

    Args:
        robot: An id, a .safetensors or .onnx file, python:..., "zero" or "random".
        human: An id, a .safetensors file, "zero" or "random".
        task: Task, such as "scratch".
        out: File to write too, or a new folder where the format is another; either says who
            played what.
        episodes: How many; the first are those of an evaluation with this seed.
        steps: Steps of 20 ms of each; default the whole episode.
        seed: Seed of the episodes.
        disability: The human's setting, d1 to d9, instead of its own.
        preference: Preference of the human of a gentle task, p1 to p9; default drawn anew.
        backend: Physics, or "auto" for the fastest one here.
        zoo: Where ids are looked up, as in `open_zoo`.
        format: Of `out`: "parquet", "minari" or "lerobot", each an extra.
        on_step: Called after each step.

    Raises:
        ValueError: A policy does not fit its seat, or an argument is not allowed.
        ZooError: A policy is not there, or not what it says.
        ImportError: The format's package is not installed.

    Examples:
        >>> table = trajectories("zero", "random", task="scratch", episodes=2, steps=3)
        >>> table.height, table["robot_observation"].dtype.shape
        (8, (34,))
    """
    from assistax_base.parquet import write_parquet
    from assistax_envs import make
    from assistax_envs.interrupts import interruptible
    from evaluation.cast.seats import version_of
    from evaluation.film import Pair

    if episodes < 1:
        raise ValueError(f"episodes is {episodes}; give at least 1")
    if out is not None:
        check_place(Path(out), format)
    registry = open_zoo(zoo).registry
    version = version_of({"robot": robot, "human": human}, task, lambda: registry)
    env = make(task, backend, version=version)
    who = {"disability": disability, "preference": preference}
    pair = Pair(env, robot, human, lambda: registry, steps=steps, seed=seed, **who)
    table = interruptible(lambda check: _record_all(pair, episodes, check, on_step))
    if out is not None:
        facts = {"preference": preference, "episodes": episodes, "steps": pair.length, "seed": seed}
        about = _about(pair, facts)
        if format == "parquet":
            said = {METADATA_KEY: json.dumps(about)}
            write_parquet(table, Path(out), metadata=said, compression="zstd")
        else:
            write_dataset(table, Path(out), about, format)
    return table


def record_people(
    folder: Path, placed: Sequence["Placed"], out: Path, format: str, check: Callable[[], None]
) -> Path:
    """Write every step of the episodes of people of one result folder; return the place.

    Args:
        folder: The result folder, TASK/ROBOT.
        placed: Its episodes.
        out: Folder of the datasets.
        format: "parquet", "minari" or "lerobot".
        check: Called after each step; it may raise to stop.

    Raises:
        ValueError: The format is unknown, or the place is taken.
        ImportError: The format's package is not installed.
    """
    from assistax_base.parquet import write_parquet
    from evaluation.people.steps import Recordings

    name = f"{folder.parent.name}-{folder.name}"
    # Names of Minari's datasets end in a version.
    name = name if re.search(r"-v\d+$", name) else f"{name}-v0"
    place = out / (f"{name}.parquet" if format == "parquet" else name)
    check_place(place, format)
    recordings = Recordings(placed)
    table = _record_all(recordings, len(placed), check, None)
    place.parent.mkdir(parents=True, exist_ok=True)
    if format == "parquet":
        said = {METADATA_KEY: json.dumps(recordings.about)}
        write_parquet(table, place, metadata=said, compression="zstd")
    else:
        write_dataset(table, place, recordings.about, format)
    return place


def _record_all(
    pair: "Pair | Recordings",
    episodes: int,
    check: Callable[[], None],
    on_step: Callable[[], None] | None,
) -> "pl.DataFrame":
    """Play all episodes, and return their rows."""
    import polars as pl

    from assistax_envs.own_settings import own_settings

    record = own_settings()(_record)
    return pl.concat([record(pair, number, check, on_step) for number in range(episodes)])


def _record(
    pair: "Pair | Recordings",
    number: int,
    check: Callable[[], None],
    on_step: Callable[[], None] | None,
) -> "pl.DataFrame":
    """Play one episode, and return its rows."""
    import polars as pl

    actions: dict[str, list[np.ndarray]] = {role: [] for role in pair.references}

    def heard(role: str, act: Callable[[np.ndarray], np.ndarray]) -> Any:
        def acting(obs: np.ndarray) -> np.ndarray:
            actions[role].append(np.asarray(act(obs), np.float32))
            return actions[role][-1]

        return acting

    states = list(pair.play(check, on_step, number, heard))
    count = len(states)

    def with_end(values: list[Any]) -> "pl.Series":
        """Return a column's values, with a missing value for the last state."""
        series = pl.Series(np.asarray(values))
        return pl.concat([series, pl.Series([None], dtype=series.dtype)])

    columns: dict[str, Any] = {
        "episode": np.full(count, number, np.int32),
        "step": np.arange(count, dtype=np.int32),
    }
    for role in actions:
        seen = np.stack([np.asarray(state.obs[role][0], np.float32) for state in states])
        columns[f"{role}_observation"] = pl.Series(seen)
    columns |= {name: pl.Series(values) for name, values in pair.env.shown(states).items()}
    columns |= {f"{role}_action": with_end(acted) for role, acted in actions.items()}
    for name, leaf in _gains(pair.env, states[0]).items():
        columns[name] = with_end([np.asarray(leaf(state))[0] for state in states[1:]])
    return pl.DataFrame(columns)


def _gains(env: Any, first: Any) -> dict[str, Callable[[Any], Any]]:
    """Return functions that read a step's results from the state after it, by column."""
    speed = {} if first.measures.speed is None else {"speed": lambda state: state.measures.speed}
    said = {} if first.word is None else {"word": _said}
    terms = {f"term_{name}": lambda state, name=name: state.terms[name] for name in env.term_names}
    return {
        "reward": lambda state: state.reward,
        **terms,
        "force": lambda state: state.measures.force,
        **speed,
        **said,
        **{flag: operator.attrgetter(flag) for flag in ("terminated", "truncated", "nonfinite")},
    }


def _said(state: Any) -> np.ndarray:
    """Return the words [N] that were said with the actions that led to a state; 0 for silence."""
    from assistax_envs.preferences import HEARD

    return np.where(np.asarray(state.heard) == HEARD, np.asarray(state.word), 0).astype(np.int32)


def _who(name: str, seat: "Seated") -> dict[str, Any]:
    """Return the name given for a seat, and the sha256 of its policy."""
    from evaluation.record.manifest import file_sha256

    path = Path(name)
    sha256 = seat.card.sha256 if seat.card else file_sha256(path) if path.is_file() else None
    return {"policy": path.name if path.is_file() else name, "sha256": sha256}


def _about(pair: "Pair", facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the metadata of a recording: policies, task and machine."""
    from assistax_envs.disability import Disability
    from assistax_envs.models.build import scene_sha256
    from evaluation.record.manifest import describe_machine

    env, setting = pair.env, pair.setting
    if pair.seats["human"].humans is not None:  # a person has a body of its own
        setting = None
    return {
        "task": env.task,
        "environment_version": env.version,
        "backend": env.backend,
        "engine": env.engine,
        "scene": scene_sha256(env.task),
        "disability": dataclasses.asdict(setting) if isinstance(setting, Disability) else setting,
        **facts,
        **{role: _who(name, pair.seats[role]) for role, name in pair.references.items()},
        "machine": describe_machine(),
    }
