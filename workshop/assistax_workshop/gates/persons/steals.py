"""Attempts to earn without care: programs that see nothing, idle humans, and a search with them."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs import Env, make
from assistax_workshop.gates.persons.play import (
    EPISODES,
    STRANGERS,
    Plan,
    play_persons,
    rollout_with_persons,
    strangers,
    training_persons,
)
from assistax_workshop.gates.persons.search import search_script
from assistax_workshop.gates.persons.swapped import players

EVERY = 50  # steps from one knot of a program to the next; actions are linear in between
ROUNDS = 4
KEPT = 4  # one program in this many is a model of the next round
SHAKEN = 0.3  # of a model's knots, as a share of the round's spread
SIDE = "validation"


class OpenLoop:
    """Policy that plays a program of actions and sees nothing."""

    def initial_carry(self, batch_shape: tuple[int, ...]) -> jax.Array:
        """Return the steps done."""
        return jnp.zeros(batch_shape, jnp.int32)

    def act(
        self, params: Any, carry: jax.Array, obs: jax.Array, first: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Return actions [..., 7] at this step of the program's "knots" [K, 7]."""
        knots, time = params["knots"], jnp.where(first, 0, carry)
        place = jnp.minimum(time // EVERY, len(knots) - 2)
        share = (time / EVERY - place)[..., None]
        action = (1.0 - share) * knots[place] + share * knots[place + 1]
        return time + 1, jnp.clip(action, -1.0, 1.0)


def play_steals(plan: Plan, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Return what programs, robots with idle humans and a search with them earn."""
    env = make(plan.task, plan.backend)
    found = {"programs": _programs(plan, env)}
    for name, its_env, policy, params in players(plan):
        rollout = rollout_with_persons(plan, its_env, policy, idle=True)
        found[f"{name}, idle human"] = play_persons(
            rollout, plan.task, params, strangers(SIDE), EPISODES
        )
    searched = search_script(plan, progress, idle=True)
    found["search, idle human"] = searched["sides"][SIDE]
    earned = {
        name: {what: np.mean(figures[what], axis=(1, 2)).tolist() for what in ("return", "success")}
        for name, figures in found.items()
    }
    for name, figures in earned.items():
        most = max(figures["return"])
        progress(f"{name}: return {most:.1f}, caring success {max(figures['success']):.1%}")
    return {"about": {"task": plan.task, "programs": plan.programs}, "earned": earned}


def _programs(plan: Plan, env: Env) -> dict[str, Any]:
    """Return the results with strangers of the best program: a few rounds, about the best ones."""
    rng, rollout = np.random.default_rng(0), rollout_with_persons(plan, env, OpenLoop())
    knots = (plan.horizon or env.episode_length) // EVERY + 2
    shape = plan.programs // ROUNDS, knots, env.action_size["robot"]
    size = np.exp(rng.uniform(np.log(0.02), 0.0, (shape[0], 1, 1)))
    tried, drawn = [], size * rng.normal(size=shape)
    for _ in range(ROUNDS):
        met = training_persons(plan.models)
        stack = {"knots": jnp.asarray(drawn, jnp.float32)}
        returns = np.mean(play_persons(rollout, plan.task, stack, met, 1)["return"], axis=(1, 2))
        tried += list(zip(returns.tolist(), drawn, strict=True))
        tried = sorted(tried, key=lambda one: -one[0])[: max(shape[0] // KEPT, 1)]
        models = np.array([tried[i % len(tried)][1] for i in range(shape[0])])
        drawn = models + SHAKEN * models.std() * rng.normal(size=shape)
    best = {"knots": jnp.asarray(tried[0][1][None], jnp.float32)}
    assert SIDE in STRANGERS
    return play_persons(rollout, plan.task, best, strangers(SIDE), EPISODES)
