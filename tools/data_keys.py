"""Keys of the tables under docs/data: their files, and the jobs that made them.

    python -m tools.data_keys          # compare the tables with docs/data/keys.json
    python -m tools.data_keys write    # after tables were made anew

A folder's key has the digest of its files. If there is a summary, it also has the task,
the release, the split, and the digest of the published policies' parameters, so that
no table can stand for other partners of the same ids. Exit code 1 if a table has no key or another.
"""

import sys
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.digest import json_sha256
from assistax_base.errors import listing
from assistax_base.files import write_json
from evaluation.record import tables
from evaluation.record.manifest import file_sha256
from zoo.registry import Registry, load_registry

DATA = Path(__file__).parents[1] / "docs" / "data"
FILE = "keys.json"
_OF_THE_JOB = ("task", "env_version", "backend", "release", "split", "episodes", "lock")


def keys_of(data: Path, registry: Registry) -> dict[str, Any]:
    """Return the key of every folder of tables below `data`, by its path there."""
    folders = sorted({path.parent for path in data.rglob("*") if _is_table(path)})
    return {
        folder.relative_to(data).as_posix(): _key(folder, registry)
        for folder in folders
        if folder != data
    }


def check_keys(data: Path, registry: Registry) -> list[str]:
    """Return messages for the folders whose tables differ from `keys.json`, with their fields."""
    known, found = tables.read_json(data / FILE), keys_of(data, registry)
    problems = []
    for name in sorted(known | found):
        old, new = known.get(name, {}), found.get(name, {})
        if differing := [field for field in sorted(old | new) if old.get(field) != new.get(field)]:
            problems.append(f"docs/data/{name}: another {listing(differing)} than its key")
    return problems


def _is_table(path: Path) -> bool:
    """Return whether a path is a generated file; Markdown is written by hand."""
    return path.is_file() and path.suffix != ".md"  # written by hand


def _key(folder: Path, registry: Registry) -> dict[str, Any]:
    """Return the key of one folder."""
    files = {path.name: file_sha256(path) for path in sorted(folder.iterdir()) if _is_table(path)}
    key: dict[str, Any] = {"files": json_sha256(files)}
    if tables.SUMMARY_FILE not in files or tables.PAIRS_FILE not in files:
        return key
    summary = tables.read_json(folder / tables.SUMMARY_FILE)
    pairs = tables.read_parquet(folder / tables.PAIRS_FILE)
    names = _policies(pairs)
    published = registry.known(sorted(names))
    key |= {name: summary[name] for name in _OF_THE_JOB if name in summary}
    return key | {
        "policies": json_sha256({entry.id: entry.sha256 for entry in published}),
        "unpublished": len(names) - len(published),
    }


def _policies(pairs: pl.DataFrame) -> set[str]:
    """Return the ids of a table's policies, which older tables name by their teams."""
    names: set[str] = set()
    for seat, role in (("ego", "robot"), ("partner", "human")):
        if seat in pairs.columns:
            names |= set(pairs[seat])
        elif f"{seat}_team" in pairs.columns:
            names |= {f"{team}/{role}" for team in pairs[f"{seat}_team"].drop_nulls()}
    return names


def main(arguments: list[str]) -> int:
    """Write the keys, or print the differences and return the exit code."""
    registry = load_registry()
    if arguments == ["write"]:
        write_json(DATA / FILE, keys_of(DATA, registry))
        return 0
    problems = check_keys(DATA, registry)
    print("\n".join(problems) or f"every table of {DATA.name} has its key")
    return bool(problems)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
