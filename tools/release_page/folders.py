"""Data taken from a finished folder, without paths.

Folders may come from anybody: a name that they contain becomes a folder name only if it is a task
of the paper, or fits a strict pattern.
"""

import re
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any

import polars as pl
import polars.selectors as cs

from assistax_envs.versions import PAPER_TASKS
from evaluation.record import tables
from evaluation.record.verification import verify_folder

_METHOD = re.compile(r"[a-z][a-z0-9_]*")
EGO_FILE = re.compile(rf"(?P<method>{_METHOD.pattern})-s(?P<seed>[0-9]{{1,6}})\.safetensors")
_ABSOLUTE = re.compile(
    r"(?<![^\s'\"=:])~?/[^\s'\"]+"
)  # a path from the root, as a word of a command
_KEPT_OF_TRAINING = ("steps", "device", "seconds", "backend", "date", "commit")


def check_unchanged(folder: Path) -> None:
    """Refuse a folder that differs from its manifest.

    Raises:
        ValueError: A file was changed, damaged or lost, or the folder has no manifest.
    """
    if problems := verify_folder(folder).problems:
        raise ValueError(f"{problems[0]}; nothing was collected from {folder}")


def read_training(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the first ego's metadata of a train-ego run, and the facts of the run.

    Raises:
        ValueError: no finished egos, another task, or an algorithm that is no plain name.
    """
    from zoo.parameters.storage import read_policy_file

    files = sorted((folder / "policies").glob("*.safetensors"))
    metadata = [read_policy_file(path).metadata for path in files]
    if not metadata or any({"task", "algorithm", "training"} - set(fields) for fields in metadata):
        raise ValueError(f"{folder}/policies holds no finished egos; let train-ego run to its end")
    first = metadata[0]
    method = first["algorithm"]
    if not (isinstance(method, str) and _METHOD.fullmatch(method)):
        raise ValueError(f"{folder} names the algorithm {method!r}; expected a name such as ppo")
    known_task(first, folder)
    training = {
        name: first["training"][name] for name in _KEPT_OF_TRAINING if name in first["training"]
    }
    command = _run_of(folder)["command"]
    return first, {
        "egos": len(metadata),
        "split": first.get("split"),
        **training,
        "command": command,
    }


def known_task(metadata: Mapping[str, Any], folder: Path) -> str:
    """Return the task that a received folder names; it must be one of the paper's."""
    if metadata.get("task") not in PAPER_TASKS:  # it may be no text
        raise ValueError(
            f"{folder} names the task {metadata.get('task')!r}; allowed are "
            f"{', '.join(PAPER_TASKS)}"
        )
    return metadata["task"]


def how_it_ran(folder: Path, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return the facts of a folder's run: without paths, with the seconds of simulation."""
    steps = int(tables.read_parquet(folder / tables.EPISODES_FILE)["steps"].sum())
    rate = summary["env_steps_per_second"]
    return {
        **_run_of(folder),
        "env_steps": steps,
        "seconds": steps / rate if rate else None,
    }


def _run_of(folder: Path) -> dict[str, Any]:
    """Return a folder's record of its run; its command has names in place of absolute paths."""
    path = folder / tables.RUN_FILE
    run = tables.read_json(path) if path.is_file() else {}
    command = _ABSOLUTE.sub(lambda match: PurePath(match[0]).name, str(run.get("command", "")))
    return {**run, "command": command}


def small(pairs: pl.DataFrame) -> pl.DataFrame:
    """Return a table with its numbers in 32 bits."""
    return pairs.with_columns(cs.float().cast(pl.Float32), cs.integer().cast(pl.Int32))
