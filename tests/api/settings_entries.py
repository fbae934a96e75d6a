"""Digests of this package's results in a process with settings of its own.

Run it to print the digests as JSON: `python -m tests.api.settings_entries BACKEND LENGTH NAMES...`.
"""

import hashlib
import json
import sys
import tempfile
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import assistax_zoo as az
from assistax_envs import disability_params, env, make
from assistax_envs.adapters.gymnasium import AssistaxEnv
from assistax_envs.adapters.jaxmarl import AssistaxMarlEnv
from assistax_envs.adapters.pettingzoo import AssistaxParallelEnv
from zoo.parameters.storage import read_policy_file

TASK, TEAM, EGO = "scratch", "scratch/ippo-d1-s1-v1", "scratch/ppo-ego-s0-v1/robot"
TEAMS = "scratch/ippo-d1-s[01]-v1"
KEYS: Any = np.array([[0, 0], [0, 1]], np.uint32)  # raw words, as JaxMARL's users have them


def evaluation(backend: str) -> str:
    how: dict[str, Any] = {"episodes": 1, "references": False, "progress": False}
    result = az.evaluate(EGO, task=TASK, partners=TEAMS, backend=backend, **how)
    return digest((result.folder / "episodes.parquet").read_bytes())


def crossplay(backend: str) -> str:
    result = az.cross_play(TEAMS, task=TASK, episodes=1, backend=backend, progress=False)
    return digest((result.folder / "episodes.parquet").read_bytes())


def training(backend: str) -> str:
    sizes = {"num_envs": 20, "rollout_steps": 3, "minibatches": 2, "hidden": (8, 8)}
    how: dict[str, Any] = {"steps": 120, "hyperparameters": sizes, "progress": False}
    split = {"split": "small-5"}
    with tempfile.TemporaryDirectory() as folder:
        trained = az.train_ego(TASK, folder=folder, backend=backend, **how, **split)
        [file] = trained.files
        return digest(jax.tree.leaves(read_policy_file(file).params))


def vector_form(backend: str) -> str:
    vector = az.vector_env(TASK, 2, partners=TEAM, backend=backend)
    obs, _ = vector.reset(seed=0)
    seen = [obs]
    for _ in range(env.EPISODE_LENGTH + 1):
        seen += vector.step(np.full((2, 7), 0.3, np.float32))[:3]
    return digest(seen)


def single_forms(backend: str) -> str:
    partner = az.open_zoo().partner(TEAM)
    single = AssistaxEnv(TASK, partner, backend=backend)
    seen = [single.reset(seed=0)[0], single.step(np.full(7, 0.3))[0]]
    both = AssistaxParallelEnv(TASK, backend=backend)
    seen += both.reset(seed=1)[0].values()
    seen += both.step({"robot": np.ones(7), "human": np.zeros(3)})[0].values()
    return digest(seen)


def functional_form(backend: str) -> str:
    marl = AssistaxMarlEnv(TASK, backend=backend)
    obs, state = jax.vmap(marl.reset)(KEYS)
    action = {"robot": jnp.ones((2, 7)), "human": jnp.zeros((2, 3))}
    after, *_ = jax.vmap(marl.step)(KEYS, state, action)
    return digest([*obs.values(), *after.values()])


def own_program(backend: str) -> str:
    """A user's own program around ours, compiled under the user's settings."""
    scene = make(TASK, backend)
    params = disability_params(["d1", "d9"])

    def play(keys: jax.Array) -> Any:
        def step(state: Any, _: Any) -> Any:
            action = {"robot": jnp.full((2, 7), 0.3), "human": jnp.zeros((2, 3))}
            state = scene.step(state, action)
            return state, state.reward

        return jax.lax.scan(step, scene.reset(keys, params), None, length=3)

    keys = jax.random.wrap_key_data(KEYS, impl="threefry2x32")
    state, rewards = jax.jit(play)(keys)
    return digest([rewards, *state.obs.values()])


def recording(backend: str) -> str:
    options: dict[str, Any] = {"episodes": 1, "steps": 2, "backend": backend}
    table = az.trajectories(EGO, TEAM, task=TASK, **options)
    return digest([table["robot_observation"].to_numpy(), table["human_action"][:2].to_numpy()])


ENTRIES: dict[str, Callable[[str], str]] = {
    function.__name__: function
    for function in (
        *(evaluation, crossplay, training, vector_form, single_forms, recording),
        *(functional_form, own_program),
    )
}


def outcome(name: str, backend: str) -> str:
    """Return an entry's digest, or the error that it ends in."""
    try:
        return ENTRIES[name](backend)
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def digest(parts: Any) -> str:
    """Return a digest of bytes, or of arrays."""
    if not isinstance(parts, bytes):
        with jax.transfer_guard("allow"):
            arrays = [np.asarray(part) for part in parts]
        parts = b"".join(f"{a.dtype}{a.shape}".encode() + a.tobytes() for a in arrays)
    return hashlib.sha256(parts).hexdigest()[:16]


def main() -> None:
    backend, length, *names = sys.argv[1:]
    vars(env)["EPISODE_LENGTH"] = int(length)
    print(json.dumps({name: outcome(name, backend) for name in names}))


if __name__ == "__main__":
    main()
