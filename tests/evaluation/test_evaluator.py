import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal

from evaluation.cast.egos import EgoError
from evaluation.cast.roster import Member, joined
from evaluation.play import tiles
from evaluation.play.evaluator import check_folder, clear_results, plan_of, run_job
from evaluation.play.jobs import Job
from evaluation.play.parts import PARTS_FOLDER
from evaluation.play.shares import run_share
from evaluation.play.tiles import plan, tile_shape
from evaluation.record import tables
from evaluation.record.columns import validate_episodes
from evaluation.record.manifest import MANIFEST_FILE
from tests.base.test_files import Disk
from tests.evaluation.matrix_game import (
    HUMAN,
    PAYOFF,
    ROBOT,
    MatrixGame,
    constant_params,
    host,
    humans,
    random_roster,
    robots,
    roster,
)


def make_job(egos: Any = None, partners: Any = None, **changes: Any) -> Job:
    egos = egos or robots(-0.5, 0.5)
    partners = partners or humans(-0.5, 0.5, -0.5, disabilities=("d1", "d2", "d3"))
    # On "native", which test_invariance.py tests, `max_envs` does not cut jobs as small as these.
    options: dict[str, Any] = {"backend": "mjx", "episodes": 3, **changes}
    return Job("matrix", 1, egos=egos, partners=partners, **options)


def mixed_job(**changes: Any) -> Job:
    """Egos of two specs, so that there are two pairs of groups."""
    deep = random_roster(dataclasses.replace(ROBOT, hidden=(4, 4)), 2, 2, "deep")
    return make_job(joined(random_roster(ROBOT, 3, 1), deep), random_roster(HUMAN, 5, 3), **changes)


def test_crossplay_of_matrix_game_equals_payoffs(tmp_path: Path):
    job = make_job(sides={"matrix/hand-d1-s0-v0/human": "train"})
    table = run_job(MatrixGame(), job, tmp_path).table
    validate_episodes(table)
    strength = {"d1": 1.0, "d2": 0.7, "d3": 0.4}
    for row in table.iter_rows(named=True):
        payoff = PAYOFF[row["ego_seed"], row["partner_seed"] % 2]
        payoff *= strength[row["partner_disability"]]
        assert row["term_payoff"] == pytest.approx(4 * payoff)
        assert row["return"] == pytest.approx(row["term_payoff"] + row["term_luck"])
        assert row["side"] == ("train" if row["partner_seed"] == 0 else None)
    assert table.height == 2 * 3 * 3
    assert table["ego"].to_list() == sorted(table["ego"].to_list())
    assert table["episode"].to_list() == [0, 1, 2] * 6
    assert table.group_by("episode").agg(pl.col("key").n_unique())["key"].to_list() == [1, 1, 1]


@pytest.mark.slow_for("two")
@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize(
    "job", [mixed_job(), make_job(stochastic=True)], ids=["two specs", "stochastic"]
)
def test_chunk_size_does_not_change_a_value(tmp_path: Path, job: Job):
    whole = run_job(MatrixGame(), job, tmp_path / "whole", max_envs=1000).table
    assert len(set(whole["force_mean"].to_list())) > 2
    for max_envs in (1, 7):
        cut = run_job(MatrixGame(), job, tmp_path / str(max_envs), max_envs=max_envs)
        assert cut.table.equals(whole)


@pytest.mark.slow
def test_only_small_jobs_mix_networks_in_tiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    recurrent = dataclasses.replace(HUMAN, torso="gru", hidden=(4, 4))
    partners = joined(random_roster(HUMAN, 3, 3), random_roster(recurrent, 1, 4, "recurrent"))
    job = make_job(mixed_job().egos, partners, backend="native")
    [whole] = plan(job, 2048)
    assert [(tile.shape, tile.rows) for tile in whole.tiles] == [((5, 4, 3), job.rows)]
    table = run_job(MatrixGame(), job, tmp_path / "one").table
    assert table["return"].n_unique() > 10
    monkeypatch.setattr(tiles, "SMALL_JOB", job.rows - 1)
    [chunk] = plan(job, 2048)
    assert {tile.shape for tile in chunk.tiles} == {(3, 3, 3), (3, 1, 3), (2, 3, 3), (2, 1, 3)}
    cut = run_job(MatrixGame(), job, tmp_path / "cut").table
    assert_frame_equal(cut, table, rel_tol=1e-5, abs_tol=1e-6)


def test_folder_continues_with_its_tiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Another machine has larger tiles, as one with a GPU has on `fused`."""
    job = mixed_job(backend="native")
    monkeypatch.setitem(tiles.TILE_ENVS, "native", 6)
    whole = run_job(MatrixGame(), job, tmp_path / "whole")
    run_share(MatrixGame(), job, tmp_path / "moved", (1, 2), max_envs=1)
    monkeypatch.setitem(tiles.TILE_ENVS, "native", 2048)
    assert len(plan(job, 1)) == 1
    moved = run_job(MatrixGame(), job, tmp_path / "moved", max_envs=1)
    assert json.loads((tmp_path / "moved" / MANIFEST_FILE).read_text())["tile_envs"] == 6
    assert moved.table.equals(whole.table)


@pytest.mark.parametrize("name", ["max_envs", "tile_envs"])
def test_a_plan_of_nothing_at_once_is_refused(name: str):
    with pytest.raises(ValueError, match=f"{name} is 0; allowed is 1 or more"):
        plan_of(mixed_job(), {"max_envs": 9, "tile_envs": 9, name: 0})


def test_gpus_have_larger_tiles(monkeypatch: pytest.MonkeyPatch):
    assert tiles.tile_envs("fused", 7) == tiles.TILE_ENVS["fused"]
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert tiles.tile_envs("fused", 7) == 98304
    assert (tiles.tile_envs("native", 7), tiles.tile_envs("mjx-warp", 7)) == (512, 7)


def test_a_robot_from_outside_shares_no_tile():
    job = make_job(joined(host(lambda obs: np.zeros((len(obs), 2))), robots(-0.5)))
    assert [len(tile.egos) for chunk in plan(job, 2048) for tile in chunk.tiles] == [1, 1]


@pytest.mark.parametrize("sizes", [(1, 99, 8), (198, 198, 16), (3, 5, 2), (7, 1, 40), (1, 1, 1)])
@pytest.mark.parametrize("max_envs", [1, 30, 2048])
def test_plan_covers_every_episode_once(sizes: tuple[int, int, int], max_envs: int):
    e, p, k = shape = tile_shape(*sizes, max_envs)
    assert e * p * k <= max_envs
    assert all(1 <= width <= size for width, size in zip(shape, sizes, strict=True))
    if k < sizes[2]:
        assert e == p == 1


def test_a_plan_wastes_little():
    assert tile_shape(1, 99, 8, 2048) == (1, 99, 8)
    assert tile_shape(32, 32, 2, 2048) == (32, 32, 2)
    e, p, k = tile_shape(198, 198, 16, 16384)
    chunks = math.ceil(198 / e) * math.ceil(198 / p)
    assert chunks * e * p * k < 1.05 * 198 * 198 * 16
    assert e * p * k > 0.8 * 16384


def unfinished(folder: Path) -> list[Path]:
    """Leave the parts of a run that was stopped before they were merged, and return them."""
    for i in (1, 2):
        run_share(MatrixGame(), mixed_job(), folder, (i, 2), max_envs=7)
    return sorted((folder / PARTS_FOLDER).glob("part-*"))


@pytest.mark.slow_for("column", "bit", "swapped")
@pytest.mark.parametrize("damage", ["torn", "bit", "column", "swapped", "emptied"])
def test_a_damaged_part_is_simulated_again(tmp_path: Path, damage: str):
    whole = run_job(MatrixGame(), mixed_job(), tmp_path / "whole", max_envs=7)
    parts = unfinished(tmp_path / "torn")
    data = bytearray(parts[2].read_bytes())
    if damage == "bit":
        data[len(data) // 3] ^= 1
    elif damage == "column":
        changed = pl.read_parquet(parts[2]).with_columns(pl.col("return") / 2)
        data = bytearray(tables.parquet_bytes(changed))
    elif damage == "swapped":
        data = bytearray(parts[3].read_bytes())
    else:
        data = bytearray(b"PAR1 torn" if damage == "torn" else b"")
    parts[2].write_bytes(bytes(data))
    again = run_job(MatrixGame(), mixed_job(), tmp_path / "torn")
    assert again.table.equals(whole.table)
    assert again.env_steps_per_second is not None  # that part alone was simulated


def test_files_are_synced_at_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    disk = Disk(monkeypatch)
    unfinished(tmp_path)
    parts = list((tmp_path / PARTS_FOLDER).glob("part-*"))
    parts[0].with_name(f".{parts[0].name}").write_bytes(b"half")  # a writer was killed
    whole = run_job(MatrixGame(), mixed_job(), tmp_path)
    assert whole.env_steps_per_second is None  # nothing was simulated again
    assert len(parts) > 1 and disk.unsafe == [] and str(tmp_path) in disk.flushed
    left = [path.name for path in tmp_path.iterdir() if not path.name.endswith(".lock")]
    assert sorted(left) == [tables.EPISODES_FILE, MANIFEST_FILE]


def test_only_damaged_tables_are_simulated_again(tmp_path: Path):
    first = run_job(MatrixGame(), make_job(), tmp_path)
    path = tmp_path / tables.EPISODES_FILE
    found = run_job(MatrixGame(), make_job(), tmp_path)
    assert found.env_steps_per_second is None and found.table.equals(first.table)
    path.write_bytes(tables.parquet_bytes(first.table.with_columns(pl.col("return") / 2)))
    again = run_job(MatrixGame(), make_job(), tmp_path)
    assert again.table.equals(first.table) and again.env_steps_per_second is not None


def test_changed_and_missing_manifests_are_refused(tmp_path: Path):
    run_job(MatrixGame(), make_job(), tmp_path)
    path = tmp_path / MANIFEST_FILE
    path.write_text(path.read_text().replace('"seed": 0', '"seed": 1'))
    with pytest.raises(ValueError, match="changed after it was written"):
        run_job(MatrixGame(), make_job(seed=1), tmp_path)
    path.unlink()
    with pytest.raises(ValueError, match="without manifest"):
        run_job(MatrixGame(), make_job(seed=5), tmp_path)


def test_undeclared_code_neither_answers_nor_replaces(tmp_path: Path):
    """The weights that the code reads may change. A cache plays such code again."""
    weights = -0.5

    def act(obs: np.ndarray) -> np.ndarray:
        return np.full((len(obs), 2), weights)

    job, cache = make_job(host(act, reusable=False)), tmp_path / "cache"
    first = run_job(MatrixGame(), job, tmp_path)
    cached = run_job(MatrixGame(), job, cache, kept=True)
    weights = 0.5
    assert not run_job(MatrixGame(), job, cache, kept=True).table.equals(cached.table)
    with pytest.raises(ValueError, match=r"python:mine:robot.*reuse them, replace them"):
        run_job(MatrixGame(), job, tmp_path)
    assert run_job(MatrixGame(), job, tmp_path, reuse=True).table.equals(first.table)
    for reuse in (False, True):
        with pytest.raises(ValueError, match=r"holds another job \(episodes 3 there, 1 here\)"):
            other = make_job(host(act, reusable=False), episodes=1)
            run_job(MatrixGame(), other, tmp_path, reuse=reuse)
    assert tables.read_episodes(tmp_path / tables.EPISODES_FILE).equals(first.table)
    clear_results(MatrixGame(), job, tmp_path)
    second = run_job(MatrixGame(), job, tmp_path)
    assert not second.table["return"].equals(first.table["return"])


def test_undeclared_code_joins_no_other_parts(tmp_path: Path):
    def breaks(obs: np.ndarray) -> np.ndarray:
        raise RuntimeError("boom")

    egos = joined(robots(-0.5), host(breaks, reusable=False))
    with pytest.raises(EgoError):
        run_job(MatrixGame(), make_job(egos), tmp_path, max_envs=3)
    assert any((tmp_path / PARTS_FOLDER).glob("part-*"))  # of the other robot
    with pytest.raises(ValueError, match="whether that is still the same robot"):
        run_job(MatrixGame(), make_job(egos), tmp_path, max_envs=3)


def test_cleared_results_include_derived_files(tmp_path: Path):
    run_job(MatrixGame(), make_job(), tmp_path)
    for name in (*tables.DERIVED_FILES, tables.RUN_FILE, "mine.html"):
        (tmp_path / name).write_text("{}")
    # A mistake loses no files.
    with pytest.raises(ValueError, match="plays the human, not the robot"):
        clear_results(MatrixGame(), make_job(humans(0.5)), tmp_path)
    assert tables.read_episodes(tmp_path / tables.EPISODES_FILE).height == make_job().rows
    clear_results(MatrixGame(), make_job(seed=1), tmp_path)
    assert [path.name for path in tmp_path.iterdir() if path.name[0] != "."] == ["mine.html"]
    assert run_job(MatrixGame(), make_job(seed=1), tmp_path).table.height == make_job().rows


def test_new_episodes_stand_beside_no_table_of_others(tmp_path: Path):
    """A new manifest must not list tables of a folder that lost its manifest."""
    (tmp_path / tables.BOUNDS_FILE).write_text("another's")
    run_job(MatrixGame(), make_job(), tmp_path)
    manifest = json.loads((tmp_path / MANIFEST_FILE).read_text())
    assert list(manifest["files"]) == [tables.EPISODES_FILE]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"episodes": 4}, "episodes 3 there, 4 here"),
        ({"seed": 1}, "seed 0 there, 1 here"),
        ({"egos": robots(-0.5, 0.25)}, "other egos"),
        ({"partners": humans(0.5, disabilities=("d4",))}, "other partners"),
    ],
)
def test_a_folder_of_another_job_is_refused(tmp_path: Path, changes: dict[str, Any], message: str):
    run_job(MatrixGame(), make_job(), tmp_path)
    with pytest.raises(ValueError, match=f"holds another job.*{message}.*another folder"):
        run_job(MatrixGame(), make_job(**changes), tmp_path)


def test_unwritable_folder_is_found_before_run(tmp_path: Path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OSError, match=r"cannot write to .*file/out.*another folder"):
        check_folder(tmp_path / "file" / "out")
    for device in ("/dev/null", "/dev/full"):
        with pytest.raises(OSError, match=r"cannot write to .*it is not a folder.*another folder"):
            check_folder(Path(device))
        assert Path(device).is_char_device()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"egos": joined(robots(0.5), robots(0.5))}, "given 2 times"),
        (
            {"partners": roster(HUMAN, (Member("x", "y"),), constant_params(HUMAN, [0.5]))},
            "no disability setting",
        ),
        (
            {"egos": random_roster(dataclasses.replace(ROBOT, observation_size=47), 1, 0)},
            "47 numbers; .* task matrix has 3: .*another task",
        ),
        ({"egos": humans(0.5)}, "plays the human, not the robot"),
    ],
)
def test_a_job_of_unfit_policies_is_refused(tmp_path: Path, changes: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=message):
        run_job(MatrixGame(), make_job(**changes), tmp_path)


class Counting:
    """A stateful ego: row 0 until it has seen two observations of the episode, then row 1."""

    def __init__(self) -> None:
        self.batches: list[int] = []

    def reset(self, batch: int) -> None:
        self.batches.append(batch)
        self.seen = 0

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        assert obs.dtype == np.float32 and obs.flags.writeable
        self.seen += 1
        return np.full((len(obs), 2), 0.5 if self.seen > 2 else -0.5)


def test_stateful_host_ego_is_reset(tmp_path: Path):
    ego = Counting()
    job = make_job(joined(host(ego), robots(-0.5)))
    table = run_job(MatrixGame(), job, tmp_path, max_envs=6).table
    assert ego.batches == [6, 6]
    mine = table.filter(pl.col("ego") == "python:mine:robot")
    assert mine["ego_team"].null_count() == mine.height == 9
    first = mine.filter(pl.col("partner_seed") == 0)
    assert first["term_payoff"].to_list() == pytest.approx([2 * (PAYOFF[0, 0] + PAYOFF[1, 0])] * 3)


def test_actions_beyond_the_range_are_counted_by_episode(tmp_path: Path):
    def beyond(obs: np.ndarray) -> np.ndarray:
        actions = np.full((len(obs), 2), [1.0, -1.0])
        actions[4, 0], actions[8] = 1.5, [-2.0, 2.0]  # the fifth and the ninth of the nine episodes
        return actions

    job = make_job(joined(host(beyond), robots(-0.5)))
    table = run_job(MatrixGame(), job, tmp_path).table
    mine = table.filter(pl.col("ego") == "python:mine:robot")
    assert mine["clipped"].to_list() == [0, 0, 0, 0, 0.5, 0, 0, 0, 1]
    assert table["clipped"].null_count() == 9  # the other robot is a policy of the zoo
    assert "clipped" not in run_job(MatrixGame(), make_job(), tmp_path / "own").table.columns


def test_host_ego_error_names_partner_and_step(tmp_path: Path):
    calls = 0

    def breaks(obs: np.ndarray) -> np.ndarray:
        nonlocal calls
        calls += 1
        if calls > 4 + 2:  # the second chunk's third step
            raise RuntimeError("boom")
        return np.zeros((len(obs), 2))

    with pytest.raises(EgoError, match=r"mine:robot with .*s1-v0/human, step 2: .*: boom"):
        run_job(MatrixGame(), make_job(host(breaks)), tmp_path, max_envs=3)
    assert len(list((tmp_path / PARTS_FOLDER).glob("part-*"))) == 1
    mended = make_job(host(lambda obs: np.zeros((len(obs), 2))))
    assert run_job(MatrixGame(), mended, tmp_path, max_envs=3).table.height == 9


def test_memory_error_advises_smaller_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def exhausted(*args: Any, **options: Any) -> None:
        raise jax.errors.JaxRuntimeError("RESOURCE_EXHAUSTED: out of memory allocating")

    with monkeypatch.context() as patch:
        patch.setattr("population.play.rollout.Rollout.run", exhausted)
        with pytest.raises(ValueError, match="18 simulations; give 9 or less as max_envs"):
            run_job(MatrixGame(), make_job(), tmp_path)
    run_job(MatrixGame(), make_job(), tmp_path, max_envs=9)
    assert json.loads((tmp_path / MANIFEST_FILE).read_text())["max_envs"] == 9
