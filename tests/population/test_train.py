import contextlib
import dataclasses
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import jax
import numpy as np
import polars as pl
import pytest
import safetensors
import safetensors.numpy

from assistax_base.errors import FormatError
from assistax_envs.interrupts import StoppedError
from population.config import Member, TrainConfig, make_members
from population.hyperparameters import preset
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.stack import flatten, unflatten
from population.play.self_play import self_play
from population.runs.checkpoints import Checkpoints
from population.runs.folder import RunFolder
from population.runs.train import DivergedError, initial_state, make_trainer, train
from population.runs.trained import read_teams
from tests.population.toy_env import ToyEnv, match

PPO = preset("ippo", num_envs=8, rollout_steps=10, hidden=(8, 8), minibatches=2, epochs=1)
MEMBERS, OPTIONS = make_members([0, 3], ["d1", "d9"]), {"checkpoint_every": 2}
CONFIG = TrainConfig("toy", "ippo", MEMBERS, 480, PPO, **OPTIONS, self_play_episodes=3)


class Killed(Exception):
    """Stands for a killed process."""


def kill_after(update):
    def progress(report):
        if report.update == update:
            raise Killed

    return progress


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return train(CONFIG, ToyEnv(match), tmp_path_factory.mktemp("run") / "whole")


def test_a_run_holds_teams_and_their_stacked_parameters(finished):
    teams = json.loads((finished / "teams.json").read_text())
    names = [{"disability": member.disability, "seed": member.seed} for member in MEMBERS]
    known = {"task": "toy", "algorithm": "ippo"}
    assert [team["team"] for team in teams] == [{**known, **name} for name in names]
    assert teams[1]["training"] == teams[0]["training"]
    assert teams[0]["training"]["steps"] == 480
    assert teams[0]["training"]["hyperparameters"]["learning_rate"] == 1e-3
    assert teams[0]["self_play"]["n"] == 3
    for role, row in ((role, team["roles"][role]) for team in teams for role in ("robot", "human")):
        spec = PolicySpec(**row["spec"])
        with safetensors.safe_open(finished / row["file"], "np") as file:
            assert list(file.metadata()) == ["assistax"]
            metadata = json.loads(file.metadata()["assistax"])
        assert (spec.role, PolicySpec(**metadata["spec"])) == (role, spec)
        assert metadata["rows"] == [f"toy/ippo-{member.label}" for member in MEMBERS]
    leaves = safetensors.numpy.load_file(finished / "robot.safetensors")
    assert leaves["Dense_0/kernel"].shape == (4, 2, 8)
    assert set(leaves) >= {"log_std", "normaliser/mean", "normaliser/std"}


def test_exported_rows_are_distinct_and_act(finished):
    teams = json.loads((finished / "teams.json").read_text())
    policy = Policy(PolicySpec(**teams[0]["roles"]["human"]["spec"]))
    params = unflatten(safetensors.numpy.load_file(finished / "human.safetensors"))
    act = jax.vmap(policy.act, in_axes=(0, None, None, None))
    params = jax.tree.map(jax.numpy.asarray, params)
    _, action = act(params, (), jax.numpy.ones((1, 3)), jax.numpy.ones(1, bool))
    assert len(np.unique(np.asarray(action)[:, 0, 0])) == 4


@pytest.mark.slow
def test_half_precision_teams_are_evaluated_as_written(finished, tmp_path, monkeypatch):
    evaluated = {}

    def spied(env, policies, params, *rest):
        evaluated.update(params)
        return self_play(env, policies, params, *rest)

    monkeypatch.setattr("population.runs.train.self_play", spied)
    half = train(dataclasses.replace(CONFIG, precision="float16"), ToyEnv(match), tmp_path / "half")
    for role in ("robot", "human"):
        whole = safetensors.numpy.load_file(finished / f"{role}.safetensors")
        leaves = safetensors.numpy.load_file(half / f"{role}.safetensors")
        played = flatten(jax.device_get(evaluated[role]))
        for name, leaf in leaves.items():
            assert leaf.dtype == np.float16 and played[name].dtype == np.float32
            np.testing.assert_array_equal(leaf, whole[name].astype(np.float16))
            np.testing.assert_array_equal(leaf, played[name])
        assert any((leaf != whole[name]).any() for name, leaf in leaves.items())
    assert RunFolder(half).config().precision == "float16"
    assert "precision" not in (finished / "config.json").read_text()


def test_metrics_have_rows_by_update_and_member(finished):
    metrics = pl.read_parquet(finished / "metrics.parquet")
    assert metrics.shape[0] == 6 * 4
    assert metrics["update"].to_list() == [update for update in range(1, 7) for _ in range(4)]
    assert metrics["steps"].max() == 480
    complete = metrics.filter(pl.col("episodes") > 0)
    assert complete.height > 0 and complete["return"].null_count() == 0
    terms = complete.select(pl.sum_horizontal("term_robot", "term_human")).to_series()
    np.testing.assert_allclose(terms, complete["return"], rtol=1e-4)
    assert metrics.filter(pl.col("episodes") == 0)["return"].null_count() > 0
    assert metrics.filter(pl.col("episodes") == 0)["success"].null_count() > 0
    assert complete["success"].is_between(0.0, 1.0).all() and complete["success"].n_unique() > 2


def until_killed(folder, update):
    """Train until a run is killed after an update; return the updates that this process made."""
    made = []

    def progress(report):
        made.append(report.update)
        kill_after(update)(report)

    with pytest.raises(Killed):
        train(CONFIG, ToyEnv(match), folder, progress=progress)
    return made


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A run killed three times: before it has a checkpoint, and after those of updates 2 and 4."""
    folder = tmp_path_factory.mktemp("killed") / "run"
    made = [until_killed(folder, update) for update in (1, 3, 5)]
    assert made == [[1], [1, 2, 3], [3, 4, 5]]
    return folder


@pytest.fixture
def copy_of_killed(killed, tmp_path):
    return Path(shutil.copytree(killed, tmp_path / "run"))


def assert_same_policies(folder, other):
    for name in ("robot.safetensors", "human.safetensors"):
        assert (folder / name).read_bytes() == (other / name).read_bytes()


@pytest.mark.slow
def test_killed_run_resumes_exactly(finished, copy_of_killed):
    folder, updates = copy_of_killed, []
    assert not (folder / "teams.json").exists()
    train(CONFIG, ToyEnv(match), folder, progress=lambda report: updates.append(report.update))
    assert updates == [5, 6]
    assert_same_policies(folder, finished)
    kept, whole = (pl.read_parquet(path / "metrics.parquet") for path in (folder, finished))
    assert kept.drop("seconds").equals(whole.drop("seconds"))


@pytest.mark.slow
def test_run_resumes_after_ctrl_c(finished, tmp_path):
    folder, updates = tmp_path / "run", []

    def stop(report):
        if report.update == 3:
            raise StoppedError  # as after Ctrl-C

    with pytest.raises(StoppedError):
        train(CONFIG, ToyEnv(match), folder, progress=stop)
    train(CONFIG, ToyEnv(match), folder, progress=lambda report: updates.append(report.update))
    assert updates == [4, 5, 6]
    assert_same_policies(folder, finished)
    assert pl.read_parquet(folder / "metrics.parquet").height == 6 * len(CONFIG.members)


def flip_a_bit(folder):
    """Flip a bit in the middle of the largest file."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    file = max(files, key=lambda path: path.stat().st_size)
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def cut_off(folder):
    """Truncate every file, as a disk that lost its cache does."""
    for file in folder.rglob("*"):
        if file.is_file():
            file.write_bytes(file.read_bytes()[:10])


@pytest.mark.slow_for("cut_off")
@pytest.mark.parametrize("damage", [flip_a_bit, cut_off])
def test_damaged_checkpoint_falls_back_with_a_warning(finished, copy_of_killed, damage):
    folder, updates = copy_of_killed, []
    damage(folder / "checkpoints" / "4")
    with pytest.warns(UserWarning, match="the checkpoint of update 4 .* is damaged .* update 2"):
        train(CONFIG, ToyEnv(match), folder, progress=lambda report: updates.append(report.update))
    assert updates == [3, 4, 5, 6]
    assert_same_policies(folder, finished)


@pytest.mark.parametrize(
    "error", [MemoryError("too large"), RuntimeError("RESOURCE_EXHAUSTED: Out of memory")]
)
def test_too_little_memory_removes_no_checkpoint(error, tmp_path, monkeypatch):
    checkpoints, state = Checkpoints(tmp_path / "checkpoints"), {"x": jax.numpy.ones(3)}
    for update in (1, 2):
        checkpoints.save(update, state)

    def fail(*_):
        raise error

    with monkeypatch.context() as patch, pytest.raises(type(error)):
        patch.setattr("orbax.checkpoint.args.StandardRestore", fail)
        checkpoints.restore_latest(state)
    found = checkpoints.restore_latest(state)
    assert found is not None and found[0] == 2
    checkpoints.close()


@pytest.mark.skipif(sys.platform != "linux", reason="names of bytes are Linux's")
def test_folder_name_must_be_utf8(tmp_path):
    with pytest.raises(ValueError, match="not UTF-8, under which no checkpoint can be written"):
        Checkpoints(tmp_path / os.fsdecode(b"run \xff"))


def test_run_with_all_checkpoints_damaged_is_refused(copy_of_killed):
    cut_off(copy_of_killed / "checkpoints")
    message = r"cannot read the checkpoint of update 4 .* another folder"
    with pytest.raises(ValueError, match=message):
        train(CONFIG, ToyEnv(match), copy_of_killed)


def test_no_thread_outlives_a_run_that_is_stopped(tmp_path):
    before = set(threading.enumerate())
    with pytest.raises(Killed):
        train(CONFIG, ToyEnv(match), tmp_path / "run", progress=kill_after(2))
    left = {thread.name for thread in set(threading.enumerate()) - before}
    assert not {name for name in left if name.startswith(("device", "Thread"))}


@pytest.mark.slow
def test_killed_sac_run_resumes_exactly(tmp_path):
    """The replay is part of the checkpoint, so the same transitions are drawn."""
    small = {"num_envs": 4, "rollout_steps": 5, "hidden": (8, 8), "batch_size": 8, "updates": 2}
    small |= {"replay_size": 60, "exploration_steps": 30, "policy_delay": 1}
    members, options = make_members([0, 3], ["d1"]), {**OPTIONS, "self_play_episodes": 0}
    config = TrainConfig("toy", "masac", members, 160, preset("masac", **small), **options)
    whole = train(config, ToyEnv(match), tmp_path / "whole")
    with pytest.raises(Killed):
        train(config, ToyEnv(match), tmp_path / "killed", progress=kill_after(5))
    updates = []
    killed = tmp_path / "killed"
    train(config, ToyEnv(match), killed, progress=lambda report: updates.append(report.update))
    assert updates == [5, 6, 7, 8]
    assert_same_policies(killed, whole)
    # Only PPO's runs can be extended.
    assert not any((folder / "checkpoints").exists() for folder in (whole, killed))
    train(config, ToyEnv(match), whole, progress=kill_after(1))  # finished: left alone
    assert RunFolder(whole).config() == config


@pytest.mark.slow
def test_finished_run_stays_and_can_be_extended(finished, tmp_path):
    before = (finished / "teams.json").stat().st_mtime_ns
    train(CONFIG, ToyEnv(match), finished, progress=kill_after(1))
    assert (finished / "teams.json").stat().st_mtime_ns == before
    shorter = dataclasses.replace(CONFIG, steps=160)
    folder = train(shorter, ToyEnv(match), tmp_path / "run")
    train(CONFIG, ToyEnv(match), folder)
    assert_same_policies(folder, finished)
    with pytest.raises(ValueError, match="has already trained 480 steps"):
        train(shorter, ToyEnv(match), folder)


def test_another_configuration_is_refused_by_name(finished):
    trainer = dataclasses.replace(PPO, gamma=0.5)
    other = dataclasses.replace(CONFIG, trainer=trainer, checkpoint_every=20)
    message = r"another configuration: trainer\.gamma is 0\.99 there and 0\.5 here"
    with pytest.raises(ValueError, match=message):
        train(other, ToyEnv(match), finished)
    with pytest.raises(ValueError, match="already holds a run; resume it, or choose a new folder"):
        train(CONFIG, ToyEnv(match), finished, resume=False)
    assert RunFolder(finished).config() == CONFIG


def test_another_folder_or_environment_is_refused(tmp_path):
    config = TrainConfig("scratch", "ippo", CONFIG.members, 480, PPO)
    with pytest.raises(ValueError, match="the environment's task is 'toy', the run's is 'scratch'"):
        train(config, ToyEnv(match), tmp_path)
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(ValueError, match="exists and is not the folder of a run"):
        train(CONFIG, ToyEnv(match), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_nonfinite_loss_stops_at_the_last_checkpoint(tmp_path):
    members = (Member(0, "d1"), Member(1, "d1", {"learning_rate": 1e38}))
    config = TrainConfig("toy", "ippo", members, 480, PPO, checkpoint_every=1)
    message = r"training diverged: \w+ of member d1-s1 is (nan|inf|-inf) by update"
    with pytest.raises(DivergedError, match=message) as e:
        train(config, ToyEnv(match), tmp_path / "run")
    assert "start a new run with a learning_rate below 1e+38" in str(e.value)
    last = Checkpoints(tmp_path / "run" / "checkpoints").latest()
    assert last is None or f"the last good checkpoint is of update {last} in" in str(e.value)
    assert not (tmp_path / "run" / "teams.json").exists()


@pytest.mark.slow
def test_full_disk_stops_and_run_resumes_later(finished, tmp_path, monkeypatch):
    save = Checkpoints.save

    def full(self, update, state):
        if update == 4:
            monkeypatch.setattr(self._manager, "save", no_space)
        save(self, update, state)

    def no_space(*args, **kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Checkpoints, "save", full)
    message = r"cannot write the checkpoint of update 4 .* last good one is of update 2; free"
    with pytest.raises(OSError, match=message):
        train(CONFIG, ToyEnv(match), tmp_path / "run")
    monkeypatch.undo()
    assert_same_policies(train(CONFIG, ToyEnv(match), tmp_path / "run"), finished)


@pytest.mark.slow
def test_sigkilled_process_resumes_exactly(finished, tmp_path):
    script = textwrap.dedent(
        f"""
        import time
        from tests.population.test_train import CONFIG, ToyEnv, match, train
        def report(progress):
            print(progress.update, flush=True)
            time.sleep(60 * (progress.update == 6))  # the last: it never ends by itself
        train(CONFIG, ToyEnv(match), {str(tmp_path / "run")!r}, progress=report)
        """
    )
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if line.strip() == "3":
            process.send_signal(signal.SIGKILL)
            break
    process.stdout.close()
    assert process.wait() == -signal.SIGKILL
    assert_same_policies(train(CONFIG, ToyEnv(match), tmp_path / "run"), finished)


@pytest.mark.parametrize("part", ["checkpoints", "metrics.parquet", "robot.safetensors"])
def test_parts_of_another_run_are_refused(finished, tmp_path, part):
    """Its seed is another, and all shapes are the same."""
    mine = tmp_path / "mine"
    shutil.copytree(finished, mine)
    other = RunFolder(tmp_path / "other")
    config = RunFolder(mine).config()
    members = tuple(dataclasses.replace(m, seed=m.seed + 10) for m in config.members)
    facts = json.loads((mine / "config.json").read_text())["environment"]
    other.open(dataclasses.replace(config, members=members), facts, resume=True)
    assert other.key != RunFolder(mine).key
    shutil.copy(other.folder / "config.json", mine / "config.json")
    if part == "checkpoints":
        like = initial_state(config, make_trainer(config, ToyEnv(match)))
        with (
            contextlib.closing(Checkpoints(mine / part, other.key)) as checkpoints,
            pytest.raises(ValueError, match="is of another run"),
        ):
            checkpoints.restore_latest(like)
        with contextlib.closing(Checkpoints(mine / part, RunFolder(finished).key)) as checkpoints:
            assert checkpoints.restore_latest(like) is not None  # nothing was removed
    elif part == "metrics.parquet":
        with pytest.raises(ValueError, match=r"metrics\.parquet is of another run"):
            RunFolder(mine).read_metrics(99)
    else:
        items = json.loads((mine / "teams.json").read_text())
        text = json.dumps([{**item, "run": other.key} for item in items])
        (mine / "teams.json").write_text(text)
        with pytest.raises(FormatError, match=r"another run's in robot\.safetensors"):
            read_teams(mine)
