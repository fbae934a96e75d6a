"""Recorded episodes of both seats in the formats of Minari and of LeRobot."""

import json
import os
import re
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from assistax_base.extras import optional
from assistax_base.files import METADATA_KEY

if TYPE_CHECKING:
    import polars as pl

FORMATS = ("parquet", "minari", "lerobot")
RATE = 50  # steps a second
ROLES = ("robot", "human")
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_NEEDED = {"minari": ("minari", "h5py"), "lerobot": ("pyarrow",)}
_CHUNK = {"chunk_index": 0, "file_index": 0}
_FILE = "chunk-000/file-000.parquet"


def check_place(path: Path, format: str) -> None:
    """Refuse a place or format that a recording cannot be written to.

    Raises:
        ValueError: The format is unknown, its package is missing, or the place is taken or has a
            name that Minari refuses.
    """
    if format not in FORMATS:
        raise ValueError(f"format is {format!r}; allowed are {', '.join(FORMATS)}")
    if format == "parquet":
        return
    if path.exists():
        raise ValueError(f"{path} exists; a {format} dataset is a new folder, give another name")
    for module in _NEEDED[format]:
        optional(module, f"the format {format}", extra=format)
    if format == "minari" and not re.fullmatch(r"[\w-]+-v\d+", path.name):
        raise ValueError(
            f"{path.name!r} is no name of a Minari dataset; use letters, digits and hyphens, and "
            "end in a version, such as scratch-v0"
        )


def write_dataset(table: "pl.DataFrame", path: Path, about: Mapping[str, Any], format: str) -> None:
    """Write recorded trajectories as a folder of that format, whole or not at all."""
    write = {"minari": write_minari, "lerobot": write_lerobot}[format]
    path.parent.mkdir(parents=True, exist_ok=True)
    # Absolute: Minari takes a relative folder for one beside its own files.
    with tempfile.TemporaryDirectory(
        prefix=f".{path.name}.", dir=path.parent.absolute()
    ) as temporary:
        write(table, Path(temporary) / path.name, path.name, about)
        os.replace(Path(temporary) / path.name, path)


def write_minari(table: "pl.DataFrame", folder: Path, name: str, about: Mapping[str, Any]) -> None:
    """Write a Minari dataset, by Minari itself.

    Observations and actions are dictionaries of both roles. What a step measured, such as `force`,
    stands in `infos` beside the observation that it led to; the first one has NaN, False or 0. So
    does `word`, what the human said with the action before.
    """
    from gymnasium.spaces import Box, Dict
    from minari import __version__
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    def space(kind: str, bound: float) -> Dict:
        sizes = {role: table[f"{role}_{kind}"].dtype.shape for role in ROLES}  # ty: ignore[missing-attribute]
        return Dict({role: Box(-bound, bound, size, np.float32) for role, size in sizes.items()})

    (folder / "data").mkdir(parents=True)
    storage = MinariStorage.new(folder / "data", space("observation", np.inf), space("action", 1.0))
    storage.update_metadata(
        {
            "dataset_id": name,
            "minari_version": __version__,
            "algorithm_name": about["robot"]["policy"],
            "description": f"{about['task']}: {about['robot']['policy']} helps "
            f"{about['human']['policy']}",
            METADATA_KEY: json.dumps(about),
        }
    )
    storage.update_episodes(
        EpisodeBuffer(id=number, seed=about["seed"], **_minari_episode(rows))
        for number, rows in enumerate(table.partition_by("episode"))
    )


def _minari_episode(rows: "pl.DataFrame") -> dict[str, Any]:
    """Return an episode as the arguments of Minari's buffer."""
    steps = rows.drop_nulls("reward")
    seen = {f"{role}_{kind}" for role in ROLES for kind in ("observation", "action")}
    infos = {}
    for column in rows.drop("episode", "step", "reward", "terminated", "truncated", *seen):
        values = column.to_numpy()
        if column.null_count():  # measured by the step before
            none = np.nan if column.dtype.is_float() else 0  # False, or silence
            after = steps[column.name].to_numpy()
            values = np.concatenate([np.array([none], after.dtype), after])
        infos[column.name] = values
    return {
        "observations": {role: rows[f"{role}_observation"].to_numpy() for role in ROLES},
        "actions": {role: steps[f"{role}_action"].to_numpy() for role in ROLES},
        "rewards": steps["reward"].to_numpy(),
        "terminations": steps["terminated"].to_numpy(),
        "truncations": steps["truncated"].to_numpy(),
        "infos": infos,
    }


def write_lerobot(table: "pl.DataFrame", folder: Path, name: str, about: Mapping[str, Any]) -> None:
    """Write LeRobot's format v3.0; LeRobot itself wants huggingface-hub below 2, we want 2.

    `observation.state` and `action` are the robot's; the human's are `observation.human_state`,
    `human_action` and `human_word`. What a step gave is `next.reward`, `next.done` and the like.
    """
    import polars as pl

    from assistax_base.parquet import write_parquet

    frames = _lerobot_frames(table)
    counted = frames.group_by("episode_index", maintain_order=True).len("length")
    ends = counted["length"].cum_sum()
    words = f"{about['task'].replace('_', ' ')}, with the human {about['human']['policy']}"
    parts = [_statistics(rows) for rows in frames.partition_by("episode_index")]
    episodes = counted.with_columns(
        tasks=pl.Series([[words]] * counted.height),
        dataset_from_index=ends - counted["length"],
        dataset_to_index=ends,
        **{
            f"{part}/{key}": pl.lit(n)
            for part in ("data", "meta/episodes")
            for key, n in _CHUNK.items()
        },
        **{
            f"stats/{feature}/{key}": pl.Series([part[feature][key] for part in parts])
            for feature in parts[0]
            for key in parts[0][feature]
        },
    )
    for place, rows in (("data/" + _FILE, frames), ("meta/episodes/" + _FILE, episodes)):
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        write_parquet(rows, folder / place)
    _write_tasks([words], folder / "meta/tasks.parquet")
    info = {
        "codebase_version": "v3.0",
        "robot_type": "Franka Panda, simulated",
        "total_episodes": counted.height,
        "total_frames": frames.height,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": RATE,
        "splits": {"train": f"0:{counted.height}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": {column.name: _feature(column) for column in frames},
        METADATA_KEY: about,
    }
    for place, content in (("info", info), ("stats", _statistics(frames))):
        (folder / "meta" / f"{place}.json").write_text(json.dumps(content, indent=1), "utf-8")


def _write_tasks(words: list[str], path: Path) -> None:
    """Write the table of tasks, whose index is their words: pandas reads that from its schema."""
    import pyarrow as pa
    from pyarrow import parquet

    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {"name": key, "field_name": key, "pandas_type": kind, "numpy_type": held, "metadata": None}
        for key, (kind, held) in kinds.items()
    ]
    index = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    tasks = pa.table({"task_index": range(len(words)), "task": words})
    parquet.write_table(tasks.replace_schema_metadata({"pandas": json.dumps(index)}), path)


def _lerobot_frames(table: "pl.DataFrame") -> "pl.DataFrame":
    """Return the steps, under LeRobot's names."""
    import polars as pl

    names = {
        "robot_observation": "observation.state",
        "human_observation": "observation.human_state",
        "robot_action": "action",
        "human_action": "human_action",
        "word": "human_word",
        "episode": "episode_index",
        "step": "frame_index",
    }
    gains = {column.name for column in table if column.null_count()} - {*names}
    for name in {*table.columns} - {*names}:
        names[name] = f"next.{name}" if name in gains else f"observation.{name}"
    here = {name: new for name, new in names.items() if name in table.columns}
    steps = table.drop_nulls("reward").rename(here)
    return steps.with_columns(
        pl.col("episode_index", "frame_index").cast(pl.Int64),
        (pl.col("frame_index") / RATE).cast(pl.Float32).alias("timestamp"),
        pl.int_range(pl.len(), dtype=pl.Int64).alias("index"),
        pl.lit(0, pl.Int64).alias("task_index"),
        (pl.col("next.terminated") | pl.col("next.truncated")).alias("next.done"),
    )


def _feature(column: "pl.Series") -> dict[str, Any]:
    values = column.to_numpy()
    return {"dtype": str(values.dtype), "shape": list(values.shape[1:] or (1,)), "names": None}


def _statistics(frames: "pl.DataFrame") -> dict[str, dict[str, list[Any]]]:
    """Return LeRobot's statistics of each feature."""
    return {column.name: dict(_measured(column.to_numpy())) for column in frames}


def _measured(values: np.ndarray) -> Iterator[tuple[str, list[Any]]]:
    rows = values.reshape(len(values), -1).astype(np.float64)
    for name in ("min", "max", "mean", "std"):
        yield name, getattr(rows, name)(0).tolist()
    yield "count", [len(rows)]
    for name, share in _QUANTILES.items():
        yield name, np.quantile(rows, share, axis=0).tolist()
