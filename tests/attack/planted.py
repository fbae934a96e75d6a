"""Defects of one line that are planted in a copy of this project, and the test that catches each.

A guard that nobody would miss is no guard: with its line off, the test named beside it must fail.
"""

import dataclasses
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[2]
CODE = ("assistax_envs", "population", "zoo", "evaluation", "assistax_zoo", "tools", "tests")
LINKED = ("zoo/shards", "docs")  # too large to be copied, and not changed
COPIED = ("pyproject.toml", "registry.json", "README.md", "CHANGELOG.md")


@dataclasses.dataclass(frozen=True)
class Defect:
    """A guard that is off."""

    file: str
    line: str  # a regular expression; it stands in the file, or the table is out of date
    instead: str
    test: str  # which must fail with it


DEFECTS = {
    "the hash of a shard is not checked": Defect(
        "population/networks/tensors.py",
        r"if digest is not None and sha256\(data\) != digest:",
        "if False:",
        "tests/zoo/test_storage.py::test_a_flipped_byte_is_refused_with_both_hashes",
    ),
    "the hash of a policy is not checked": Defect(
        "zoo/parameters/storage.py",
        r"if digest != entry\.sha256:",
        "if False:",
        "tests/zoo/test_storage.py::test_a_row_that_is_not_the_registrys_is_refused",
    ),
    "roots are not checked": Defect(
        "zoo/history/merkle.py",
        r"if \(found := release_root\(data, name\)\) != release\.root",
        "if (found := release_root(data, name)) is None",
        "tests/zoo/test_merkle.py::test_a_changed_entry_no_longer_passes_verify",
    ),
    "what was published may change": Defect(
        "zoo/saving.py",
        r"if lost := lost_leaves\(old, new\):",
        "if lost := []:",
        "tests/zoo/test_merkle.py::test_what_was_published_cannot_be_saved_away",
    ),
    "the hashes of a folder's files are not checked": Defect(
        "evaluation/record/verification.py",
        r"elif leaf\.actual != leaf\.expected:",
        "elif False:",
        "tests/evaluation/test_manifest.py::test_one_bit_of_any_file_is_found",
    ),
    "a manifest's own hash is not checked": Defect(
        "evaluation/record/manifest.py",
        r'if manifest\.get\("sha256"\) != identity_digest\(bare\):',
        "if False:",
        "tests/evaluation/test_manifest.py::test_one_bit_of_any_file_is_found",
    ),
    "a folder's manifest is not read by what draws figures": Defect(
        "evaluation/figures/summary.py",
        r"    check_whole\(folder\)\n",
        "",
        "tests/evaluation/test_report.py::test_changed_file_is_refused",
    ),
    "another job is not refused": Defect(
        "evaluation/play/evaluator.py",
        r'elif manifest\.get\("job"\) != job\.digest\(\):',
        "elif False:",
        "tests/evaluation/test_evaluator.py::test_a_folder_of_another_job_is_refused",
    ),
    "the cache's clean takes what is not ours": Defect(
        "assistax_zoo/shell/caches.py",
        r" if kind\.names\.fullmatch\(path\.name\)",
        "",
        "tests/cli/test_cache_command.py::test_clean_keeps_foreign_files_and_registries",
    ),
    "a small table may claim gigabytes": Defect(
        "evaluation/record/tables.py",
        r"    parquet\.check_size\(path\)\n",
        "",
        "tests/evaluation/test_tables.py::test_a_small_file_that_claims_gigabytes_is_refused",
    ),
    "paths are patterns": Defect(
        "assistax_base/parquet.py",
        r"pl\.read_parquet\(_source\(path\), glob=False\)",
        "pl.read_parquet(path)",
        "tests/evaluation/test_folder_names.py::test_a_result_is_that_of_its_folder",
    ),
    "an official registry can be written": Defect(
        "zoo/history/official.py",
        r"_recorded_roots\(shipped_registry\(\)\)",
        "frozenset()",
        "tests/zoo/test_own.py::test_an_own_split_leaves_the_official_registry_and_its_root",
    ),
    "nobody reads what an ego was trained against": Defect(
        "zoo/met/published.py",
        r"against = robot\.trained_against",
        "against = None",
        "tests/evaluation/test_met_partners.py::test_m_test_omits_training_partners",
    ),
    "replay believes the figures of a folder": Defect(
        "evaluation/replay/rederive.py",
        r"    with tempfile\.TemporaryDirectory\(\) as name:\n",
        "    return []\n    with tempfile.TemporaryDirectory() as name:\n",
        "tests/evaluation/test_manifest.py::test_every_figure_is_drawn_again",
    ),
    "a replay compares no successes": Defect(
        "evaluation/replay/noise.py",
        r"\.to_numpy\(\) for name in kept\.columns\]",
        '.to_numpy() for name in kept.columns if name != "success"]',
        "tests/evaluation/test_replay_headline.py::test_each_column_of_an_episode_is_compared",
    ),
    "a replay elsewhere compares no flags": Defect(
        "evaluation/replay/noise.py",
        r"if \(kind\.is_numeric\(\) or kind == pl\.Boolean\)",
        "if kind.is_numeric()",
        "tests/evaluation/test_replay_noise.py::test_false_flags_are_found_elsewhere",
    ),
    "a folder chooses the tiles that a replay plays": Defect(
        "evaluation/replay/job.py",
        r"return MAX_ENVS\[backend\]",
        "return chunk",
        "tests/evaluation/test_replay_headline.py::test_folder_chooses_no_tiles_on_mjx",
    ),
    "starts that all partners share are not resampled": Defect(
        "evaluation/record/record.py",
        r"return self\.keys is not None and len\(self\.keys\) > 1",
        "return False",
        "tests/evaluation/test_summary.py::test_own_starts_are_inside_interval",
    ),
    "the method with more seeds decides whether a contrast is the named one": Defect(
        "evaluation/figures/contrasts.py",
        r"min\(len\(a\), len\(b\)\) >= contrast\.seeds",
        "max(len(a), len(b)) >= contrast.seeds",
        "tests/evaluation/test_contrasts.py::test_the_method_with_fewer_seeds_decides",
    ),
    "partners met in training count on the validation side": Defect(
        "evaluation/cast/met_partners.py",
        r'name in self\.frozen and side != "train"',
        'name in self.frozen and side == "test"',
        "tests/evaluation/test_met_partners.py::test_met_partners_count_on_the_training_side_alone",
    ),
    "a league of two releases": Defect(
        "evaluation/figures/comparable.py",
        r' "release",',
        "",
        "tests/evaluation/test_league.py::test_a_league_of_two_releases_is_refused",
    ),
    "each method leaves out its own partners": Defect(
        "evaluation/figures/comparable.py",
        r"    common\.difference_update\(met\.left_out\)\n",
        "",
        "tests/evaluation/test_comparable.py::test_all_readers_show_the_same_means",
    ),
    "folders of other conditions are compared": Defect(
        "evaluation/record/alike.py",
        r"if expected != found:",
        "if False:",
        "tests/evaluation/test_comparable.py::test_folders_played_otherwise_are_refused",
    ),
}


def copy_project(target: Path) -> Path:
    """Copy the code; link what is large."""

    def skip(folder: str, names: list[str]) -> set[str]:
        inner = Path(folder).relative_to(ROOT).as_posix()
        return {name for name in names if f"{inner}/{name}" in LINKED or name == "__pycache__"}

    for name in CODE:
        shutil.copytree(ROOT / name, target / name, ignore=skip)
    for name in COPIED:
        shutil.copy(ROOT / name, target / name)
    for name in LINKED:
        (target / name).symlink_to(ROOT / name)
    return target


def plant(defect: Defect, copy: Path) -> str:
    """Plant a defect in a copy; return the file's text before.

    Raises:
        AssertionError: The line is not there.
    """
    path = copy / defect.file
    text = path.read_text(encoding="utf-8")
    changed, count = re.subn(defect.line, lambda _: defect.instead, text)
    assert count, f"{defect.file} has no line like {defect.line!r}: correct the table"
    path.write_text(changed, encoding="utf-8")
    return text


def run_tests(tests: Iterable[str], copy: Path) -> tuple[int, str]:
    """Run tests of a copy; return pytest's exit code, and the end of what it prints."""
    options = ["-q", "-x", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestWarning"]
    done = subprocess.run(
        [sys.executable, "-B", "-m", "pytest", *options, *sorted(tests)],
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
        timeout=1800,
    )
    return done.returncode, done.stdout[-2000:]
