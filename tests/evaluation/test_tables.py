import errno
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from assistax_base.files import atomic_path
from assistax_base.parquet import check_readable, write_parquet
from evaluation.figures.saved_tables import pair_table
from evaluation.record import tables
from evaluation.record.columns import BEHAVIOUR, CARE, GENTLE, SCHEMA, TOUCH, validate_episodes
from evaluation.record.record import Record, lay_out
from tests.evaluation.episode_tables import episode_table, recorded, teams

ROOT = Path(__file__).parents[2]


def small(k: int = 2) -> pl.DataFrame:
    return episode_table(np.arange(6.0 * k).reshape(2, 3, k), teams(2), teams(3))


def test_layout_ignores_order_of_rows():
    returns = np.random.default_rng(0).normal(size=(3, 4, 5))
    table = episode_table(returns, teams(3), teams(4))
    block = lay_out(table.sample(fraction=1.0, shuffle=True, seed=1))
    np.testing.assert_array_equal(block.values, returns)
    np.testing.assert_allclose(block.scores, returns.mean(axis=2))
    assert block.egos["ego_seed"].to_list() == [0, 1, 2]
    assert block.keys is not None
    assert block.keys.tolist() == [[100, 101, 102, 103, 104]] * 4
    assert block.common_starts


def test_seeds_sort_as_numbers():
    egos = ["mine", ("ippo", "d1", 10), ("ippo", "d1", 9)]
    block = lay_out(episode_table(np.zeros((3, 1, 1)), egos, teams(1)))
    names = [f"scratch/ippo-d1-s{seed}-v0/robot" for seed in (9, 10)]
    assert block.egos["ego"].to_list() == [*names, "mine"]


def test_own_and_common_starts_are_distinguished():
    own = small().with_columns(key=pl.col("key") + 10 * pl.col("partner_seed"))
    block = lay_out(own)
    assert block.keys is not None
    assert block.keys[:, 0].tolist() == [100, 110, 120]
    assert not block.common_starts
    assert lay_out(small()).common_starts
    alone = block.select_partners(np.array([True, False, False]))
    assert alone.keys is not None and alone.keys.shape[0] == 1
    assert not alone.common_starts
    of_pairs = pl.when(pl.col("ego_seed") == 1).then(7).otherwise("key")
    assert lay_out(small().with_columns(key=of_pairs)).keys is None


def test_missing_and_doubled_episodes_are_refused():
    with pytest.raises(ValueError, match=r"1 of 12 .*s1-v0/robot .* episode 1: found 0 times"):
        lay_out(small()[:-1])
    with pytest.raises(ValueError, match=r"s0-v0/human, episode 0: found 2 times"):
        lay_out(pl.concat([small(), small()[:1]]))


def test_two_descriptions_of_one_partner_are_refused():
    rows = (pl.col("ego_seed") == 1) & (pl.col("partner_seed") == 2)
    other = pl.when(rows).then(pl.lit("d9")).otherwise("partner_disability")
    table = small().with_columns(partner_disability=other)
    with pytest.raises(ValueError, match=r"d1-s2-v0/human has several values of partner_dis"):
        lay_out(table)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop("side", "key"), "lacks the columns side, key"),
        (lambda t: t.with_columns(colour=1), "unknown columns colour"),
        (lambda t: t[:0], "no rows"),
        (lambda t: t.cast({"return": pl.String}), "column return is String; expected Float32"),
        (lambda t: t.cast({"success": pl.Int8}), "column success is Int8; expected Boolean"),
        (lambda t: t.with_columns(side=pl.lit("left")), "side holds 'left'; allowed are 'train'"),
        (
            lambda t: t.with_columns(partner=pl.lit(None, pl.String)),
            "column partner has 12 empty values",
        ),
        (
            lambda t: t.with_columns(pl.col("return").replace(3, np.nan)),
            r"return has 1 values that are not finite, first nan for ego .*s0-v0/robot with "
            r".*s1-v0/human, episode 1",
        ),
        (lambda t: t.with_columns(pl.col("term_scratch") / 0), "column term_scratch has 12 values"),
    ],
)
def test_malformed_table_error_names_fault(change, message: str):
    with pytest.raises(ValueError, match=message):
        validate_episodes(change(small()))


def test_parquet_gives_the_table_back(tmp_path: Path):
    path = tmp_path / "run" / tables.EPISODES_FILE
    tables.write_episodes(small(), path)
    episodes = tables.read_episodes(path)
    absent = (
        *GENTLE,
        *TOUCH,
        *CARE,
        "place",
        "clipped",
    )  # of gentle tasks, series, robots from outside
    written = {name: dtype for name, dtype in SCHEMA.items() if name not in absent}
    assert {name: dtype for name, dtype in episodes.schema.items() if name in SCHEMA} == written
    np.testing.assert_array_equal(lay_out(episodes).values, lay_out(small()).values)
    assert [file.name for file in path.parent.iterdir()] == [tables.EPISODES_FILE]


def test_table_without_behaviour_is_read(tmp_path: Path):
    old = small().drop(BEHAVIOUR)
    tables.write_episodes(old, tmp_path / tables.EPISODES_FILE)
    assert pair_table(Record.read(tmp_path)).height > 0


def test_failed_write_keeps_old_file(tmp_path: Path):
    path = tmp_path / "file.json"
    tables.write_json({"a": 1}, path)
    with pytest.raises(ValueError, match="JSON compliant"):
        tables.write_json({"a": float("nan")}, path)
    with pytest.raises(RuntimeError), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert tables.read_json(path) == {"a": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_missing_and_damaged_files_are_named(tmp_path: Path):
    with pytest.raises(FileNotFoundError, match=r"gone\.parquet does not exist; run"):
        tables.read_parquet(tmp_path / "gone.parquet")
    with pytest.raises(FileNotFoundError, match=r"gone\.json does not exist; run"):
        tables.read_json(tmp_path / "gone.json")
    for name, read in (("bad.parquet", tables.read_parquet), ("bad.json", tables.read_json)):
        (tmp_path / name).write_text("garbage that is neither")
        with pytest.raises(ValueError, match=rf"{name} is not (a )?readable .*; delete it and run"):
            read(tmp_path / name)


def test_pair_table_averages_the_episodes_of_a_pair():
    returns = np.random.default_rng(0).normal(size=(2, 3, 4))
    pairs = pair_table(recorded(episode_table(returns, teams(2), teams(3))))
    np.testing.assert_allclose(pairs["return"].to_numpy().reshape(2, 3), returns.mean(axis=2))
    np.testing.assert_allclose(
        pairs["return_sd"].to_numpy().reshape(2, 3), returns.std(axis=2, ddof=1)
    )
    assert pairs["episodes"].unique().to_list() == [4]
    assert pairs["ego_seed"].to_list() == [0, 0, 0, 1, 1, 1]


def test_full_disk_error_keeps_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / tables.EPISODES_FILE
    tables.write_episodes(small(), path)

    def full(target: Path, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(target))

    monkeypatch.setattr(tables, "atomic_write", full)
    with pytest.raises(OSError, match=r"the disk is full: .*episodes.parquet needs \d+ bytes"):
        tables.write_episodes(small(), path)
    assert tables.read_episodes(path).height == small().height


def test_tables_are_readable_with_many_cores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Polars would start a thread a core, each with addresses of its own, beyond the limit."""
    monkeypatch.setenv("POLARS_MAX_THREADS", "512")
    write_parquet(pl.DataFrame({"a": range(1000)}), tmp_path / "t.parquet")
    check_readable([tmp_path / "t.parquet"])


READ = """
import sys
from pathlib import Path
from assistax_base.parquet import check_readable, read_parquet
import polars
path, whole = Path(sys.argv[1]), Path(sys.argv[1]).read_bytes()
for place in map(int, sys.argv[3:]):
    path.write_bytes(whole[:place] + bytes([25]) + whole[place + 1 :])
    try:
        check_readable([path])
        told = "readable"
    except ValueError as error:
        assert "t.parquet is not a readable Parquet file" in str(error)
        told = "refused"
    print(told, flush=True)
    try:
        polars.read_parquet(path) if sys.argv[2] == "raw" else read_parquet(path)
        print("read", flush=True)
    except BaseException as error:
        print(type(error).__name__, flush=True)
"""


def outcomes(path: Path, reader: str, places: Sequence[int]) -> tuple[int, list[str]]:
    """Flip a bit at each place in turn and read; return the exit code and the printed lines."""
    words = [sys.executable, "-c", READ, str(path), reader, *map(str, places)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT)
    return done.returncode, done.stdout.splitlines()


@pytest.mark.slow
def test_reader_panic_is_a_damaged_file(tmp_path: Path):
    """Bit flips in the headers of a page cause panics and aborts of Polars' Rust code.

    Python cannot catch an abort, and a panic is not an Exception.
    """
    path = tmp_path / "t.parquet"
    tables.write_parquet(small(), path)
    whole = path.read_bytes()
    places = [place for place, byte in enumerate(whole) if byte == 24][:8]
    ends = {}
    for place in places:
        path.write_bytes(whole)
        code, output = outcomes(path, "raw", [place])
        ends[place] = output[1] if code == 0 else code
        assert (output[0] == "readable") == (ends[place] == "read"), (place, output)
    assert {"PanicException", -signal.SIGABRT} <= set(ends.values()), ends
    path.write_bytes(whole)
    panics = [place for place, end in ends.items() if end == "PanicException"]
    assert outcomes(path, "ours", panics[:1]) == (0, ["refused", "ValueError"])


def test_json_that_is_deep_or_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "summary.json"
    path.write_text('{"a":' * 100_000 + "1" + "}" * 100_000)
    with pytest.raises(ValueError, match=r"summary\.json is not readable JSON"):
        tables.read_json(path)
    monkeypatch.setattr(tables, "LARGEST_JSON", 100)
    path.write_text(" " * 99 + "{}")
    with pytest.raises(ValueError, match="101 bytes; at most 100 are read"):
        tables.read_json(path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('{"mean": 1.0, "mean": 2.0}', "key 'mean' stands twice"),
        ('{"sides": {"test": {"mean": 1.0, "mean": 2.0}}}', "key 'mean' stands twice"),
        ('{"mean": NaN}', "NaN, which is not a JSON number"),
    ],
)
def test_json_of_two_readings_is_refused(text: str, problem: str, tmp_path: Path):
    (path := tmp_path / "summary.json").write_text(text)
    with pytest.raises(ValueError, match=rf"summary\.json is not readable JSON \({problem}"):
        tables.read_json(path)


def test_a_small_file_that_claims_gigabytes_is_refused(tmp_path: Path):
    """A run of one value is some kilobytes, and 400 MB once it is read."""
    path = tmp_path / "t.parquet"
    tables.write_parquet(pl.select(pl.repeat(1.0, 50_000_000).alias("return")), path)
    assert path.stat().st_size < 250_000
    with pytest.raises(ValueError, match=r"50000000 rows of 1 columns in \d+ bytes"):
        tables.read_parquet(path)
    large = pl.DataFrame({f"c{n}": np.zeros(200_000, np.float32) for n in range(40)})
    tables.write_parquet(large, path)  # nothing but zeros, as a robot that does nothing may earn
    assert tables.read_parquet(path).shape == (200_000, 40)


def test_interrupted_reader_is_no_damaged_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def read(path: Path, *, glob: bool) -> None:
        raise KeyboardInterrupt

    tables.write_parquet(small(), tmp_path / "t.parquet")
    monkeypatch.setattr(tables.pl, "read_parquet", read)
    with pytest.raises(KeyboardInterrupt):
        tables.read_parquet(tmp_path / "t.parquet")
