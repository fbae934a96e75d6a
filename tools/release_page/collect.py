"""Condense results of GPU runs into small tables that a repository can hold.

| folder of | becomes |
|---|---|
| `assistax-zoo crossplay --out` | `crossplay/TASK/`: pairs, order, strategies, summary, run |
| `assistax-zoo evaluate --split both --out` | `egos/TASK-METHOD/`: a row a pair, summary, run |
| `assistax-zoo train-ego --out` | `training.json` there: steps, device and seconds |
"""

from pathlib import Path
from typing import Any

from evaluation.record import tables
from tools.release_page.data import CROSSPLAY, EGOS, TRAINING_FILE
from tools.release_page.folders import check_unchanged, how_it_ran, known_task, read_training, small
from tools.release_page.paper.evaluations import collect_evaluation


def collect(folder: Path, data: Path) -> Path:
    """Condense one finished folder into the data of a release; return the folder that was written.

    Args:
        folder: Folder of evaluate, train-ego or crossplay.
        data: Folder of the release's data.

    Raises:
        ValueError: The folder is none that can be condensed, is unfinished or changed, or names no
            task of the paper.
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
        return _collect_crossplay(folder, summary, data)
    if "m_test" not in summary:
        raise ValueError(
            f"{folder / tables.SUMMARY_FILE} is of neither crossplay nor evaluate; give a finished "
            "folder of one"
        )
    known_task(summary, folder)
    return collect_evaluation(folder, summary, data)


def _collect_training(folder: Path, data: Path) -> Path:
    """Condense a finished training of egos; return the folder that was written."""
    first, content = read_training(folder)
    out = data / EGOS / f"{first['task']}-{first['algorithm']}"
    tables.write_json(content, out / TRAINING_FILE)
    return out


def _collect_crossplay(folder: Path, summary: dict[str, Any], data: Path) -> Path:
    """Condense a finished cross-play of published teams; return the folder that was written."""
    out = data / CROSSPLAY / known_task(summary, folder)
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
