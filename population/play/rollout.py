"""Roll out a block: every ego of some stacks with every partner of others, [E, P, K] at once.

The environment sees one flat axis N = E * P * K, of which `Layout` has a drawing. The robots'
network maps over the stacked egos, the humans' over the partners: no simulation has parameters of
its own. If egos or partners are of several networks, each has its share of E or P.
"""

import collections
import dataclasses
import functools
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.own_settings import key_of, own_settings
from population.environment import Environment
from population.networks.seat import Params
from population.play.programs import Block, Loop, Programs, trip_count
from population.play.tally import Column, Tally

# Most environment steps in one call. Progress is reported and Ctrl-C handled between calls.
SEGMENT = 100

# Seeds of K episodes, [K], or [P, K] if each partner has its own; or keys of those shapes.
Seeds = Sequence[int] | np.ndarray | jax.Array


class Rollout:
    """Rollouts of blocks of the same specs; compiles once for each shape and device.

    Threads may run blocks on a device each while others prepare them. `compile_seconds` are the
    seconds by device for which runs waited for compilation.
    """

    def __init__(
        self,
        env: Environment,
        robots: Sequence[Any],
        humans: Sequence[Any],
        *,
        stochastic: bool = False,
        paired: bool = False,
        length: int | None = None,
        series: int = 1,
        columns: Mapping[str, Column] | None = None,
    ) -> None:
        """Set the policies and rules of the blocks.

        Args:
            env: the environment.
            robots: a `population.networks.policy.Policy` for each stack of robots; empty for a
                robot from outside.
            humans: a `population.networks.policy.Policy` for each stack of humans.
            stochastic: whether actions are drawn.
            paired: robot i plays with human i only: robot stacks are as long as human ones, and E
                is 1.
            length: steps to play, if fewer than the episode's: for measuring speed.
            series: consecutive episodes that a robot plays with a partner before its recurrent
                state is reset; the human's is reset in each.
            columns: columns that installed packages add to the tally, by name.
        """
        self.compile_seconds: dict[jax.Device, float] = collections.defaultdict(float)
        self._series, self._length = series, length or env.episode_length
        steps = segment_length(self._length) if robots else 1
        forgets, columns = series == 1, columns or {}
        played = env, robots, humans, steps, paired, stochastic, forgets, columns
        self._programs = Programs(*played)
        self._reset: Any = _reset_of(env)  # ty: ignore[invalid-argument-type]
        self._start = jax.jit(self._programs.start)
        self._advance = jax.jit(self._programs.advance)
        self._compiled: dict[Any, tuple[Callable[..., Loop], ...]] = {}
        self._compiling: dict[Any, threading.Lock] = {}
        self._lookup = threading.Lock()
        # Held while tracing, so that the second device finds the program traced.
        self._tracing = threading.Lock()

    def run(
        self,
        robot_params: Sequence[Params],
        human_params: Sequence[Params],
        env_params: Any,
        seeds: Seeds,
        *,
        act: Callable[[np.ndarray, int], np.ndarray] | None = None,
        on_steps: Callable[[int], None] | None = None,
        device: jax.Device | None = None,
    ) -> Tally:
        """Return the tally of K episodes of every pair, played to their end.

        Args:
            robot_params: stacks, leaves [its E, ...]; empty if `act` plays the robot (E is 1).
            human_params: stacks, leaves [its P, ...].
            env_params: the partners' own `EnvParams`, leaves [P], or [P, K] if a partner differs
                between episodes.
            seeds: K integers; `key_of(seeds[k])` starts episode k of every pair (common
                random numbers). [P, K] integers give each partner its own episodes or order. The
                episodes of a series are adjacent. Keys are used unchanged.
            act: (observations [N, O] float32, step of the series) -> actions [N, A], for a robot
                from outside.
            on_steps: called with the number of steps just done, of every simulation.
            device: where to run; the first one if not given.

        Returns:
            The tally with NumPy leaves [E, P, K].
        """
        device = device or jax.local_devices()[0]
        tallies, memory, steps = [], None, self._programs.steps
        for place in range(self._series):
            block = self._block(robot_params, human_params, env_params, seeds, device, place)
            loop, advance = self._begin(block, device)
            if place:
                loop = dataclasses.replace(loop, robot=memory)
            for step in range(0, self._length, steps):
                action = None
                if act is not None:
                    # A robot from outside acts under the JAX settings of its process.
                    action = act(_observed(loop), place * self._length + step)
                loop = advance(loop, block, action)
                if on_steps is not None:
                    on_steps(steps)
            memory = loop.robot
            tallies.append(_counted(loop))
        e, p, _ = self._programs.layout(block).block
        return jax.tree.map(lambda *leaves: np.stack(leaves, axis=-1).reshape(e, p, -1), *tallies)

    def prepare(
        self,
        robot_params: Sequence[Params],
        human_params: Sequence[Params],
        env_params: Any,
        seeds: Seeds,
        device: jax.Device,
    ) -> None:
        """Compile the programs that `run` needs for these arguments; `run` waits for them."""
        self._compile(self._block(robot_params, human_params, env_params, seeds, device), device)

    @own_settings()
    def _block(
        self,
        robot_params: Sequence[Params],
        human_params: Sequence[Params],
        env_params: Any,
        seeds: Seeds,
        device: jax.Device,
        place: int = 0,
    ) -> Block:
        """Return the block of the episodes at one place of every series, on a device."""
        keys = episode_keys(seeds)[..., place :: self._series]
        env_params = jax.tree.map(
            lambda leaf: leaf if leaf.ndim == 1 else leaf[:, place :: self._series], env_params
        )
        block = Block(tuple(robot_params), tuple(human_params), env_params, keys, trip_count())
        return jax.device_put(block, device)

    @own_settings()
    def _begin(self, block: Block, device: jax.Device) -> tuple[Loop, Callable[..., Loop]]:
        """Return a block's loop state at its start, and the function that advances it."""
        began = time.perf_counter()
        reset, start, advance = self._compile(block, device)
        self.compile_seconds[device] += time.perf_counter() - began
        loop = start(block, reset(*self._programs.episodes(block)))
        return loop, own_settings()(lambda *args: jax.block_until_ready(advance(*args)))

    @own_settings()
    def _compile(self, block: Block, device: jax.Device) -> tuple[Callable[..., Loop], ...]:
        """Return the programs compiled for a shape and device; timed runs hold no compilation."""
        program = self._programs.layout(block), device
        with self._lookup:
            compiling = self._compiling.setdefault(program, threading.Lock())
        with compiling:
            if program not in self._compiled:
                with self._tracing:
                    lowered = self._lower(block, device)
                self._compiled[program] = tuple(part.compile() for part in lowered)
            return self._compiled[program]

    def _lower(self, block: Block, device: jax.Device) -> tuple[Any, Any, Any]:
        """Return the traced programs that reset, start and advance a block."""

        def there(leaf: Any) -> jax.ShapeDtypeStruct:
            # Said, since a start reads the states alone, and the block's device is not seen.
            place = jax.sharding.SingleDeviceSharding(device)
            return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=place)

        episodes, action = self._programs.episodes(block), None
        state = jax.tree.map(there, jax.eval_shape(self._reset, *episodes))
        loop = jax.eval_shape(self._start, block, state)
        if not block.robots:
            layout, env = self._programs.layout(block), self._programs.env
            size = math.prod(layout.block), env.action_size["robot"]
            action = jax.ShapeDtypeStruct(size, jnp.float32)
        start = self._start.lower(block, state)
        return self._reset.lower(*episodes), start, self._advance.lower(loop, block, action)


@functools.lru_cache(maxsize=4)
def _reset_of(env: Any) -> Any:
    """Return the reset of an environment, which compiles once for all rollouts of it."""
    return jax.jit(lambda keys, params: env.reset(keys, params))


def episode_keys(seeds: Seeds) -> jax.Array:
    """Return a key for each seed; keys are returned unchanged."""
    if isinstance(seeds, jax.Array) and jnp.issubdtype(seeds.dtype, jax.dtypes.prng_key):
        return seeds
    return key_of(np.asarray(seeds, np.uint32))


@own_settings()
def _observed(loop: Loop) -> np.ndarray:
    """Return the robot's observations [N, O] as a NumPy array."""
    return np.array(loop.state.obs["robot"])


@own_settings()
def _counted(loop: Loop) -> Tally:
    """Return the loop's tally with NumPy leaves."""
    return jax.tree.map(np.asarray, loop.tally)


def segment_length(episode_length: int) -> int:
    """Return the largest divisor of the episode's length that is at most `SEGMENT`."""
    return next(
        steps for steps in range(min(SEGMENT, episode_length), 0, -1) if episode_length % steps == 0
    )
