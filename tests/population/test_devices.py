"""Sharing of a run's members by devices. Processes make several devices of a CPU."""

import contextlib
import dataclasses
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
import safetensors.numpy

from assistax_envs import make
from assistax_envs.persons import PersonPlayer, persons
from assistax_envs.persons.rows import marked
from population.config import MIXED, Member, TrainConfig
from population.devices import DeviceShares
from population.hyperparameters import preset
from population.networks.spec import PolicySpec
from population.partners.drawn_persons import OnePersonEach
from population.runs import train as training
from population.runs.checkpoints import Checkpoints
from population.runs.train import initial_state, make_trainer, train
from tests.population.test_frozen_partners import frozen, stack
from tests.population.test_train import Killed
from tests.population.toy_env import ToyEnv, match

HOST_DEVICES = 4
# Shares of another size are another program to XLA, which may add in another order: about 1e-7
# here.
ROUNDING = 1e-5
TRAINERS = {
    "ippo": preset("ippo", num_envs=8, rollout_steps=10, hidden=(8, 8), minibatches=2, epochs=1),
    "ego": preset("ippo", num_envs=8, rollout_steps=10, torso="gru", hidden=(8,), minibatches=2,
    epochs=1),
    "isac": preset(
        "isac", num_envs=8, rollout_steps=10, replay_size=240, exploration_steps=80, batch_size=8,
        updates=2,
        policy_delay=1, hidden=(8,),
    ),
}  # fmt: skip


def population():
    """Return four partners: two recurrent with carries [partner, member x simulation], two not."""
    recurrent = PolicySpec("human", 3, 2, torso="gru", hidden=(8,))
    plain = PolicySpec("human", 3, 2, hidden=(4,))
    stacks = [stack(recurrent, ("a", "b")), stack(plain, ("c", "d"), seed=1)]
    return frozen(stacks, {"a": "d1", "b": "d3", "c": "d1", "d": "d3"})


def arguments(case, members=4):
    """Return the configuration and the partners of a case."""
    partners = population() if case == "ego" else None
    team = tuple(Member(seed, MIXED if partners else f"d{1 + seed % 9}") for seed in range(members))
    names = partners.ids if partners else ()
    options = {"checkpoint_every": 2, "self_play_episodes": 0, "partners": names}
    return TrainConfig("toy", case, team, 480, TRAINERS[case], **options), partners


def train_with_persons(folder, devices):
    """Train a robot with each of four persons, on so many devices."""
    rows = jax.numpy.asarray(marked(persons("gentle_scratch")[:4]))
    partners = OnePersonEach(PersonPlayer("gentle_scratch"), rows, "some")
    tiny = preset("ippo", num_envs=4, rollout_steps=8, hidden=(8,), minibatches=1, epochs=1)
    team = tuple(Member(seed, MIXED) for seed in range(len(rows)))
    config = TrainConfig(
        "gentle_scratch", "ego", team, 64, tiny, self_play_episodes=0, partners=partners.ids
    )
    env = make("gentle_scratch")
    train(config, env, folder, partners=partners, devices=jax.devices()[:devices])


def in_another_order(config, trainer, shares=None):
    """Return the initial state with a planted defect: simulations lie with another member."""
    state = initial_state(config, trainer, shares)
    moved = jax.tree.map(
        lambda leaf: jax.numpy.roll(leaf, trainer.config.num_envs, axis=0), state.simulations.env
    )
    return dataclasses.replace(state, simulations=dataclasses.replace(state.simulations, env=moved))


def train_each(case, runs):
    """Train one run after another: see `run` in the test for what is said of each."""
    config, partners = arguments(case)
    for options in runs:

        def progress(report, until=options["until"]):
            if report.update == until:
                raise Killed

        if options["copy_of"]:
            shutil.copytree(options["copy_of"], options["folder"])
        devices = jax.devices()[: options["devices"]]
        with contextlib.suppress(Killed), pytest.MonkeyPatch.context() as patch:
            if options["planted"]:
                patch.setattr(training, "initial_state", in_another_order)
            shared = {"partners": partners, "progress": progress, "devices": devices}
            train(config, ToyEnv(match), options["folder"], **shared)


def save_and_restore(case, folder):
    """Save a state of two devices, restore it for 1, 2 and 4, and print their shares."""
    config, partners = arguments(case)
    trainer = make_trainer(config, ToyEnv(match), partners)
    shares = {count: DeviceShares(4, jax.devices()[:count]) for count in (1, 2, 4)}
    states = {count: initial_state(config, trainer, of) for count, of in shares.items()}
    checkpoints = Checkpoints(Path(folder))
    checkpoints.save(1, states[2])
    rows = {}
    for count, like in states.items():
        latest = checkpoints.restore_latest(like)
        assert latest is not None and latest[0] == 1
        restored = latest[1]
        for path, leaf, begun, saved in zip(
            *leaves(restored), leaves(like)[1], leaves(states[2])[1], strict=True
        ):
            assert len(leaf.sharding.device_set) == count, path
            np.testing.assert_array_equal(leaf, saved, err_msg=path)
            np.testing.assert_allclose(begun, saved, rtol=ROUNDING, atol=ROUNDING, err_msg=path)
        rows[count] = [
            shard.data.shape[0] for shard in restored.simulations.first.addressable_shards
        ]
    checkpoints.close()
    print(json.dumps(rows))


def leaves(state):
    """Return paths and leaves, keys as their data."""
    paths, values = zip(*jax.tree_util.tree_leaves_with_path(state), strict=True)
    keys = [jax.numpy.issubdtype(value.dtype, jax.dtypes.prng_key) for value in values]
    return [jax.tree_util.keystr(path) for path in paths], [
        jax.random.key_data(value) if key else value
        for key, value in zip(keys, values, strict=True)
    ]


def count_shares(cases):
    shares = [DeviceShares(members, jax.devices()[:devices]) for members, devices in cases]
    print(json.dumps(list(map(len, shares))))


def on_several_devices(function, *args):
    """Call a function of this module where the CPU is several devices; return what it printed."""
    flags = (
        f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={HOST_DEVICES}"
    )
    # Programs this small take longer to compile than to run.
    flags += " --xla_backend_optimization_level=0"
    code = "import json, sys; from tests.population import test_devices as tests; "
    code += f"tests.{function.__name__}(*json.loads(sys.argv[1]))"
    process = subprocess.run(
        [sys.executable, "-c", code, json.dumps(args)],
        env={**os.environ, "XLA_FLAGS": flags.strip()}, capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr[-4000:]
    return json.loads(process.stdout) if process.stdout else None


def parameters(folder):
    return {
        f"{file.stem}/{name}": leaf
        for file in sorted(folder.glob("*.safetensors"))
        for name, leaf in safetensors.numpy.load_file(file).items()
    }


def difference(left, right):
    """Return the largest difference of two runs' parameters."""
    left, right = parameters(left), parameters(right)
    assert left.keys() == right.keys() and left
    return max(float(np.abs(left[name] - right[name]).max()) for name in left)


def devices_of(folder):
    return json.loads((folder / "teams.json").read_text())[0]["training"]["devices"]


@pytest.mark.slow
@pytest.mark.parametrize("case", TRAINERS)
def test_members_end_on_several_devices_as_on_one(case, tmp_path):
    """A resumed run has the same bits on as many devices, else the same but for rounding."""

    def run(name, devices, *, until=None, copy_of=None, planted=False):
        source = str(tmp_path / copy_of) if copy_of else None
        more = {"until": until, "copy_of": source, "planted": planted}
        return {"folder": str(tmp_path / name), "devices": devices, **more}

    runs = [run("one", 1), run("two", 2), run("four", 4), run("planted", 2, planted=True)]
    runs += [run("killed", 2, until=3)]
    runs += [run("resumed", 2, copy_of="killed"), run("moved", 1, copy_of="killed")]
    on_several_devices(train_each, case, runs)
    expected = {"one": 1, "two": 2, "four": 4, "resumed": 2, "moved": 1}
    assert {name: devices_of(tmp_path / name) for name in expected} == expected
    first, two = (tmp_path / name for name in ("one", "two"))
    assert difference(tmp_path / "resumed", two) == 0.0
    assert max(difference(tmp_path / name, first) for name in ("two", "four", "moved")) < ROUNDING
    assert difference(tmp_path / "planted", first) > 100 * ROUNDING


@pytest.mark.slow
def test_persons_are_split_with_their_simulations(tmp_path):
    for devices in (1, 2):
        on_several_devices(train_with_persons, str(tmp_path / str(devices)), devices)
    assert devices_of(tmp_path / "2") == 2
    assert difference(tmp_path / "2", tmp_path / "1") < ROUNDING


@pytest.mark.slow
@pytest.mark.parametrize("case", TRAINERS)
def test_checkpoint_of_two_devices_loads_on_any_number(case, tmp_path):
    restored = on_several_devices(save_and_restore, case, str(tmp_path / "state"))
    assert restored == {"1": [32], "2": [16, 16], "4": [8, 8, 8, 8]}


@pytest.mark.slow
def test_devices_in_use_divide_the_members():
    cases = {(8, 4): 4, (6, 4): 3, (7, 4): 1, (5, 3): 1, (2, 4): 2, (1, 4): 1, (4, 1): 1}
    assert on_several_devices(count_shares, list(cases)) == list(cases.values())


@pytest.mark.parametrize("devices", [[], jax.devices()[:1] * 2])
def test_devices_are_given_once_each(devices):
    with pytest.raises(ValueError, match="give at least one, and each once"):
        DeviceShares(4, devices)
