"""Condense what GPU runs wrote into small tables that a repository can hold.

| folder of | becomes |
|---|---|
| `assistax-zoo crossplay --out` | `crossplay/TASK/`: a row a pair, order, strategies, summary |
| `assistax-zoo evaluate --split both --out` | `egos/TASK-METHOD/`: a row a pair, summary, run |
| `assistax-zoo train-ego --out` | `egos/TASK-METHOD/training.json`: steps, device and seconds |

Folders may have been received from anybody: what they say never decides where is written, beyond
the name of one of our tasks and of a method.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

import polars as pl
import polars.selectors as cs

from assistax_envs.versions import PAPER_TASKS
from evaluation.figures.saved_tables import pair_table
from evaluation.record import tables
from evaluation.record.columns import EGO_COLUMNS, PARTNER_COLUMNS
from evaluation.record.record import Record
from evaluation.record.verification import verify_folder

TRAINING_FILE = "training.json"
CROSSPLAY, EGOS = "crossplay", "egos"  # folders of the data
_METHOD = re.compile(r"[a-z][a-z0-9_]*")
EGO_FILE = re.compile(rf"(?P<method>{_METHOD.pattern})-s(?P<seed>[0-9]{{1,6}})\.safetensors")
_ABSOLUTE = re.compile(
    r"(?<![^\s'\"=:])~?/[^\s'\"]+"
)  # a path from the root, as a word of a command
_EGO_MEASURES = ("return", "return_sd", "success", "episodes", "nonfinite")
_TOLD_OF_TRAINING = ("steps", "device", "seconds", "backend", "date", "commit")


def collect(folder: Path, data: Path) -> Path:
    """Condense one finished folder into the data of a release; return the folder that was written.

    Raises:
        ValueError: the folder is none that can be condensed, or its run is unfinished.
    """
    if (folder / "policies").is_dir():
        return _collect_training(folder, data)
    if not (folder / tables.SUMMARY_FILE).is_file():
        raise ValueError(
            f"{folder} holds no {tables.SUMMARY_FILE} and no policies; give a finished folder of "
            "crossplay, of evaluate --split both, or of train-ego"
        )
    check_unchanged(folder)
    summary = tables.read_json(folder / tables.SUMMARY_FILE)
    if "self_play" in summary:
        return collect_crossplay(folder, summary, data)
    if "m_test" in summary:
        return _collect_evaluation(folder, summary, data)
    raise ValueError(
        f"{folder / tables.SUMMARY_FILE} is of neither crossplay nor evaluate; give a finished "
        "folder of one"
    )


def check_unchanged(folder: Path) -> None:
    """Refuse a folder that is not what its manifest says, before a release's data take it in.

    Raises:
        ValueError: A file was changed, damaged or lost, or the folder has no manifest.
    """
    if problems := verify_folder(folder).problems:
        raise ValueError(f"{problems[0]}; nothing was collected from {folder}")


def collect_crossplay(
    folder: Path, summary: dict[str, Any], data: Path, tasks: Sequence[str] = PAPER_TASKS
) -> Path:
    """Condense a finished cross-play of published teams of one of the tasks.

    Raises:
        ValueError: the task is another, or a policy is from outside the zoo.
    """
    out = data / CROSSPLAY / known_task(summary, folder, tasks)
    pairs = tables.read_parquet(folder / tables.PAIRS_FILE)
    if pairs["ego_team"].null_count() or pairs["partner_team"].null_count():
        raise ValueError(
            f"{folder} has policies from outside the zoo; give a cross-play of published teams"
        )
    tables.write_parquet(small(pairs), out / tables.PAIRS_FILE)
    for name in (tables.ORDER_FILE, tables.STRATEGIES_FILE):
        tables.write_json(tables.read_json(folder / name), out / name)
    tables.write_json(summary, out / tables.SUMMARY_FILE)
    tables.write_json(how_it_ran(folder, summary), out / tables.RUN_FILE)
    return out


def _collect_evaluation(folder: Path, summary: dict[str, Any], data: Path) -> Path:
    if not summary["m_test"] or not summary["m_train"]:
        raise ValueError(f"{folder} has only one side of the split; run evaluate with --split both")
    method, names = _egos(summary["egos"], folder)
    out = data / EGOS / f"{known_task(summary, folder)}-{method}"
    pairs = pair_table(Record.read(folder))
    pairs = pairs.select(*EGO_COLUMNS, *PARTNER_COLUMNS, *_EGO_MEASURES).with_columns(
        pl.col("ego").replace_strict({ego: name for ego, (name, _) in names.items()}),
        pl.lit(method).alias("ego_algorithm"),
        pl.col("ego")
        .replace_strict({ego: seed for ego, (_, seed) in names.items()})
        .alias("ego_seed"),
    )
    tables.write_parquet(
        small(pairs.sort("ego_seed", maintain_order=True)), out / tables.PAIRS_FILE
    )
    egos = [names[ego][0] for ego in summary["egos"]]
    tables.write_json({**summary, "egos": egos}, out / tables.SUMMARY_FILE)
    tables.write_json(how_it_ran(folder, summary), out / tables.RUN_FILE)
    return out


def _collect_training(folder: Path, data: Path) -> Path:
    first, content = read_training(folder)
    out = data / EGOS / f"{first['task']}-{first['algorithm']}"
    tables.write_json(content, out / TRAINING_FILE)
    return out


def read_training(
    folder: Path, tasks: Sequence[str] = PAPER_TASKS
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what the first ego of a train-ego run says of itself, and what is kept of the run.

    Raises:
        ValueError: no finished egos, another task, or an algorithm that is no plain name.
    """
    from zoo.parameters.storage import read_policy_file

    files = sorted((folder / "policies").glob("*.safetensors"))
    told = [read_policy_file(path).metadata for path in files]
    if not told or any({"task", "algorithm", "training"} - set(one) for one in told):
        raise ValueError(f"{folder}/policies holds no finished egos; let train-ego run to its end")
    first = told[0]
    method = first["algorithm"]
    if not (isinstance(method, str) and _METHOD.fullmatch(method)):
        raise ValueError(f"{folder} names the algorithm {method!r}; expected a name such as ppo")
    known_task(first, folder, tasks)
    training = {
        name: first["training"][name] for name in _TOLD_OF_TRAINING if name in first["training"]
    }
    command = _run_of(folder)["command"]
    return first, {"egos": len(told), "split": first.get("split"), **training, "command": command}


def known_task(told: Mapping[str, Any], folder: Path, tasks: Sequence[str] = PAPER_TASKS) -> str:
    """Return the task that a received folder names: one of ours, since a folder is named so."""
    if told.get("task") not in tasks:
        raise ValueError(
            f"{folder} names the task {told.get('task')!r}; allowed are {', '.join(tasks)}"
        )
    return told["task"]


def _egos(references: list[str], folder: Path) -> tuple[str, dict[str, tuple[str, int]]]:
    """Return the one method of the egos, and each one's file name and seed."""
    found = {reference: EGO_FILE.fullmatch(PurePath(reference).name) for reference in references}
    methods = {match["method"] for match in found.values() if match}
    if None in found.values() or len(methods) != 1:
        raise ValueError(
            f"{folder} evaluated {', '.join(references[:3])}; expected the policies of one "
            "train-ego run, such as runs/scratch-ppo/policies/ppo-s0.safetensors"
        )
    return methods.pop(), {
        name: (match[0], int(match["seed"])) for name, match in found.items() if match
    }


def how_it_ran(
    folder: Path, summary: Mapping[str, Any], steps: int | None = None
) -> dict[str, Any]:
    """Return how the folder came about: without paths, with the seconds of simulation.

    `steps` are those of the simulation; without them, those of its episodes.
    """
    if steps is None:
        steps = int(tables.read_parquet(folder / tables.EPISODES_FILE)["steps"].sum())
    rate = summary["env_steps_per_second"]
    return {
        **_run_of(folder),
        "env_steps": steps,
        "seconds": steps / rate if rate else None,
    }


def _run_of(folder: Path) -> dict[str, Any]:
    """Return what a folder says of its run, its command with names in place of absolute paths."""
    path = folder / tables.RUN_FILE
    run = tables.read_json(path) if path.is_file() else {}
    command = _ABSOLUTE.sub(lambda found: PurePath(found[0]).name, str(run.get("command", "")))
    return {**run, "command": command}


def small(pairs: pl.DataFrame) -> pl.DataFrame:
    """Return a table with its numbers in 32 bits."""
    return pairs.with_columns(cs.float().cast(pl.Float32), cs.integer().cast(pl.Int32))
