"""Compiled parts of a rollout: the start of a block, and some steps of it.

Values depend on the compiled program. The row of a simulation changes nothing, but XLA's CPU
compiler may fuse a program for a block of another shape differently, which rounds differently in
the last bit, and contacts amplify the difference. So the networks and the environment stand in
loops of their own, into which nothing is fused: a block's shape then hardly shows. If it must not
show at all, callers keep to one shape.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key

from population.environment import Environment, EnvState
from population.networks.seat import Carry, Params
from population.play.layout import Layout
from population.play.seats import act_all, initial_carries, noise_keys, said, widths
from population.play.tally import Column, Tally, accumulate, begin, begin_window


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Block:
    """Policies, humans and episodes of a block: all pairs, or each robot with its own human."""

    robots: tuple[Params, ...]  # stacks, leaves [its E, ...]
    humans: tuple[Params, ...]  # stacks, leaves [its P, ...]
    env_params: Any  # `EnvParams` of the humans, leaves [P] or [P, K]
    keys: Key[Array, "*P K"]  # keys that start the episodes
    trips: jax.Array | np.ndarray | None  # see `trip_count`


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Loop:
    """Carry of a rollout."""

    state: EnvState  # leaves [N, ...]
    robot: tuple[Carry, ...]  # each stack of robots' recurrent state, leaves [its E, P * K, ...]
    human: tuple[Carry, ...]  # each stack of humans' recurrent state, leaves [its P, E * K, ...]
    tally: Tally
    window: Float[Array, "S N"] | None  # forces of the last second, if touches are measured
    time: Int[Array, ""]  # step of the episode


@dataclasses.dataclass(frozen=True, eq=False)
class Programs:
    """Pure functions of a rollout, with their static settings."""

    env: Environment
    robots: Sequence[Any]  # a policy for each stack; empty for a robot from outside
    humans: Sequence[Any]
    steps: int  # of one call of `advance`
    paired: bool
    stochastic: bool
    forgets: bool  # whether robots reset their memory when an episode begins
    # Columns that installed packages add to the tally, by name.
    columns: Mapping[str, Column] = dataclasses.field(default_factory=dict)

    def layout(self, block: Block) -> Layout:
        """Return the layout of a block on the flat axis."""
        episodes = block.keys.shape[-1]
        return Layout(widths(block.robots), widths(block.humans), episodes, self.paired)

    def episodes(self, block: Block) -> tuple[Key[Array, "*M"], Any]:
        """Return the keys and `EnvParams` [P * K] of a block's episodes, for the reset of each.

        All robots meet a human in the same episodes, so a reset knows no robots.
        """
        _, p, k = self.layout(block).block

        def flat(leaf: jax.Array) -> jax.Array:
            return jnp.broadcast_to(leaf, (p, k)).reshape(-1)

        return flat(block.keys), jax.tree.map(
            lambda leaf: flat(leaf.reshape(p, -1)), block.env_params
        )

    def start(self, block: Block, state: EnvState) -> Loop:
        """Return the loop state at a block's start, from the states [P * K] of `episodes`."""
        layout = self.layout(block)
        e, p, k = layout.block
        state = jax.tree.map(layout.for_robots, state)
        return Loop(
            state=state,
            robot=initial_carries(self.robots, layout.egos, k if self.paired else p * k),
            human=initial_carries(self.humans, layout.partners, e * k),
            tally=begin(state, self.env.joint_positions(state), self.columns),
            window=begin_window(state),
            time=jnp.zeros((), jnp.int32),
        )

    def advance(self, loop: Loop, block: Block, action: Float[Array, "N A"] | None) -> Loop:
        """Return the loop state after `steps` steps; `action` is that of a robot from outside."""
        layout = self.layout(block)

        def body(loop: Loop, _: None) -> tuple[Loop, None]:
            return self._step(loop, block, layout, action), None

        return jax.lax.scan(body, loop, None, length=self.steps)[0]

    def _step(
        self, loop: Loop, block: Block, layout: Layout, action: Float[Array, "N A"] | None
    ) -> Loop:
        noise = None, None
        if self.stochastic:
            noise = noise_keys(block.keys, loop.time, layout)
        robot_action, robot_carry = action, loop.robot
        if self.robots:
            obs = layout.to_robots(loop.state.obs["robot"])
            first = loop.time == 0 if self.forgets else False
            robot_carry, acted = act_all(
                self.robots, block.robots, loop.robot, obs, first, noise[0]
            )
            robot_action = layout.from_robots(acted)
        obs = layout.to_humans(loop.state.obs["human"])
        human_carry, acted = act_all(
            self.humans, block.humans, loop.human, obs, loop.time == 0, noise[1]
        )
        actions = {"robot": robot_action, "human": layout.from_humans(acted)}
        words = said(self.humans, block.humans, human_carry, obs.shape[1])
        if words is not None:
            actions["word"] = layout.from_humans(words[..., None])[:, 0]
        state = step_alone(self.env, loop.state, actions, block.trips)
        before, after = map(self.env.joint_positions, (loop.state, state))
        travel = {role: jnp.sum(jnp.abs(after[role] - before[role]), axis=-1) for role in after}
        window = loop.window
        if window is not None:
            window = window.at[loop.time % len(window)].set(state.measures.force)
        played = loop.tally, loop.state, state, travel, window, loop.time
        tally = accumulate(*played, self.columns)
        return Loop(state, robot_carry, human_carry, tally, window, loop.time + 1)


def trip_count() -> np.ndarray | None:
    """Return the trip count 1 of the loop around one environment step, or None on an accelerator.

    It is an argument of the compiled program. If it were a constant, XLA would unroll the loop of
    one trip and fuse the physics with the networks around it; the fusion depends on the block's
    shape, and so would the last bit of every value. On an accelerator the host would wait for the
    loop at every step.
    """
    return np.asarray(1, np.int32) if jax.default_backend() == "cpu" else None


def step_alone(env: Environment, state: EnvState, actions: dict[str, Any], trips: Any) -> EnvState:
    """Return the state after a step in a loop of its own, into which nothing around it is fused."""
    if trips is None:
        return env.step(state, actions)
    return jax.lax.fori_loop(0, trips, lambda _, state: env.step(state, actions), state)
