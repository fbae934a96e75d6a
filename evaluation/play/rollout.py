"""Roll out a block: every ego of some stacks with every partner of others, [E, P, K] at once.

The environment sees one flat axis N = E * P * K. The robots' network maps over the stacked egos
with observations [E, P * K, O], the humans' over the partners with [P, E * K, O]: no simulation has
parameters of its own. Where egos or partners are of several networks, each has its share of E or P.

Values are those of the compiled program. Which simulation stands in which row of it changes
nothing, but XLA's CPU compiler rounds the arithmetic of another program, for a block of another
shape, differently in the last bit where it fuses it differently; contacts amplify that. So the
networks and the environment stand in loops of their own there, into which nothing is fused: a
block's shape then hardly shows. Where it must not show at all, callers keep to one shape.
"""

import collections
import dataclasses
import functools
import itertools
import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from population.networks.members import member_map

GAMMA = 0.99  # of the discounted return
# Most environment steps in one call: between calls there is progress, and a key press is heard.
SEGMENT = 100

# Folded into an episode's key for action noise: the environment draws from the key itself.
_ACTION_STREAM = 2**31 - 1


@dataclasses.dataclass(frozen=True)
class Shape:
    """How large a block is."""

    egos: tuple[int, ...]  # of each stack of robots; none for a robot that acts from outside
    partners: tuple[int, ...]  # of each stack of humans
    episodes: int
    paired: bool = False

    @property
    def block(self) -> tuple[int, int, int]:
        """Return [E, P, K]."""
        e = 1 if self.paired or not self.egos else sum(self.egos)
        return e, sum(self.partners), self.episodes


class Environment(Protocol):
    """What a rollout needs of an environment: batch first, never mapped over."""

    @property
    def episode_length(self) -> int: ...
    @property
    def action_size(self) -> dict[str, int]: ...
    def reset(self, keys: jax.Array, params: Any, /) -> Any: ...
    def step(self, state: Any, actions: dict[str, Any], /) -> Any: ...
    def joint_positions(self, state: Any, /) -> dict[str, jax.Array]: ...


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Tally:
    """What each episode has earned so far; leaves [N], and [E, P, K] once a block is done."""

    running: jax.Array  # bool, the episode has not ended
    steps: jax.Array  # int32
    returns: jax.Array  # sum of rewards
    discounted: jax.Array  # sum of GAMMA**t * reward
    terms: dict[str, jax.Array]  # sum of each weighted reward term
    force_sum: jax.Array  # N, summed over steps
    force_peak: jax.Array  # N
    first_contact: jax.Array  # int32, the first step with a force; 0 before it
    distance_sum: jax.Array  # m, summed over steps
    travel: dict[str, jax.Array]  # rad by role: angles that all joints went through together
    success: jax.Array  # bool, at any step
    nonfinite: jax.Array  # bool, the physics became non-finite
    contact_peak: jax.Array | None = None  # N, the largest single contact, where the task feels it
    violated: jax.Array | None = None  # bool, a contact was above the hard limit, likewise


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Loop:
    """Carry of a rollout."""

    state: Any  # the environment's, leaves [N, ...]
    robot: tuple[Any, ...]  # each stack of robots' recurrent state, leaves [its E, P * K, ...]
    human: tuple[Any, ...]  # of humans, leaves [its P, E * K, ...]
    tally: Tally
    time: jax.Array  # step of the episode


class Rollout:
    """Blocks of the same specs; compiles once for each shape and device.

    Threads may run blocks on a device each, others prepare them. `compile_seconds` are those for
    which runs have waited.
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
    ) -> None:
        """Prepare blocks.

        Args:
            env: the environment.
            robots: a `population.networks.policy.Policy` for each stack of robots; none for a
                robot that acts from outside.
            humans: a `population.networks.policy.Policy` for each stack of humans.
            stochastic: whether actions are drawn.
            paired: robot i plays with human i only: robot stacks are as long as human ones, and E
                is 1.
            length: steps to play, if fewer than the episode's: for measuring speed.
            series: episodes that a robot plays with a partner, one after the other, before it
                forgets: its recurrent state is kept, the human's is not.
        """
        self.env = env
        self.compile_seconds: dict[jax.Device, float] = collections.defaultdict(float)
        self._paired, self._series = paired, series
        self._length = length or env.episode_length
        steps = segment_length(self._length) if robots else 1
        self._start = jax.jit(
            functools.partial(_start, env, robots, humans), static_argnames="shape"
        )
        self._advance = jax.jit(
            functools.partial(
                _advance, env, robots, humans, steps, stochastic, forgets=series == 1
            ),
            static_argnames="shape",
        )
        self._steps = steps
        self._compiled: dict[Any, tuple[Callable[..., Loop], ...]] = {}
        self._compiling: dict[Any, threading.Lock] = {}
        self._looking = threading.Lock()
        self._tracing = threading.Lock()  # the second device then finds the program traced

    def run(
        self,
        robot_params: Sequence[Any],
        human_params: Sequence[Any],
        env_params: Any,
        seeds: Sequence[int] | np.ndarray,
        *,
        act: Callable[[np.ndarray, int], np.ndarray] | None = None,
        on_steps: Callable[[int], None] | None = None,
        device: jax.Device | None = None,
    ) -> Tally:
        """Play K episodes of every pair to their end.

        Args:
            robot_params: stacks, leaves [its E, ...]; none where `act` plays the robot (E is 1).
            human_params: stacks, leaves [its P, ...].
            env_params: the partners' own `EnvParams`, leaves [P], or [P, K] where a partner is
                another in each episode.
            seeds: K integers; `jax.random.key(seeds[k])` starts episode k of every pair (common
                random numbers). Or [P, K], where each partner has episodes or an order of its own.
                Those of a series stand next to each other.
            act: (observations [N, O] float32, step of the series) -> actions [N, A], for a robot
                from outside.
            on_steps: called with the number of steps just done, of every simulation.
            device: where to run; the first one if not given.

        Returns:
            The tally with NumPy leaves [E, P, K].
        """
        device = device or jax.local_devices()[0]
        tallies, memory = [], None
        for place in range(self._series):
            shape, given = self._place(robot_params, human_params, env_params, seeds, device, place)
            began = time.perf_counter()
            start, advance = self._programs(device, shape, given)
            self.compile_seconds[device] += time.perf_counter() - began
            robots, humans, settings, keys, once = given
            loop = start(settings, keys)
            if place:
                loop = dataclasses.replace(loop, robot=memory)
            for step in range(0, self._length, self._steps):
                action = None
                if act is not None:
                    obs = np.array(loop.state.obs["robot"])
                    action = act(obs, place * self._length + step)
                loop = jax.block_until_ready(advance(loop, robots, humans, keys, action, once))
                if on_steps is not None:
                    on_steps(self._steps)
            memory = loop.robot
            tallies.append(
                jax.tree.map(lambda leaf, to=shape.block: np.asarray(leaf).reshape(to), loop.tally)
            )
        return jax.tree.map(
            lambda *leaves: np.stack(leaves, axis=-1).reshape(*shape.block[:2], -1), *tallies
        )

    def prepare(
        self,
        robot_params: Sequence[Any],
        human_params: Sequence[Any],
        env_params: Any,
        seeds: Sequence[int] | np.ndarray,
        device: jax.Device,
    ) -> None:
        """Compile what `run` needs for these arguments; it then waits for what is not yet done."""
        shape, given = self._place(robot_params, human_params, env_params, seeds, device)
        self._programs(device, shape, given)

    def _place(
        self,
        robot_params: Sequence[Any],
        human_params: Sequence[Any],
        env_params: Any,
        seeds: Sequence[int] | np.ndarray,
        device: jax.Device,
        place: int = 0,
    ) -> tuple[Shape, tuple[Any, ...]]:
        """Return a block's shape, and on its device what the programs are given.

        A block is of the episodes at one place of every series.
        """
        seeds = np.asarray(seeds, np.uint32)[..., place :: self._series]
        env_params = jax.tree.map(
            lambda leaf: leaf if leaf.ndim == 1 else leaf[:, place :: self._series], env_params
        )
        shape = Shape(_widths(robot_params), _widths(human_params), seeds.shape[-1], self._paired)
        keys = jax.vmap(jax.random.key)(seeds.ravel()).reshape(seeds.shape)
        given = robot_params, human_params, env_params, keys, _once()
        return shape, jax.device_put(given, device)

    def _programs(
        self, device: jax.Device, shape: Shape, given: tuple[Any, ...]
    ) -> tuple[Callable[..., Loop], ...]:
        """Compile for a shape and device, or find it compiled: timed runs hold no compilation."""
        with self._looking:
            compiling = self._compiling.setdefault((shape, device), threading.Lock())
        with compiling:
            if (shape, device) not in self._compiled:
                with self._tracing:
                    lowered = self._lower(shape, *given)
                self._compiled[shape, device] = tuple(program.compile() for program in lowered)
            return self._compiled[shape, device]

    def _lower(
        self,
        shape: Shape,
        robot_params: Sequence[Any],
        human_params: Sequence[Any],
        env_params: Any,
        *rest: Any,
    ) -> tuple[Any, Any]:
        """Trace the programs that start and advance a block."""
        keys, once = rest
        start = self._start.lower(env_params, keys, shape=shape)
        loop = jax.eval_shape(functools.partial(self._start, shape=shape), env_params, keys)
        action = None
        if not robot_params:
            size = math.prod(shape.block), self.env.action_size["robot"]
            action = jax.ShapeDtypeStruct(size, jnp.float32)
        args = loop, robot_params, human_params, keys, action, once
        return start, self._advance.lower(*args, shape=shape)


def segment_length(episode_length: int) -> int:
    """Return the largest divisor of the episode's length that is at most `SEGMENT`."""
    return next(
        steps for steps in range(min(SEGMENT, episode_length), 0, -1) if episode_length % steps == 0
    )


def _start(
    env: Environment,
    robots: Sequence[Any],
    humans: Sequence[Any],
    env_params: Any,
    keys: Any,
    *,
    shape: Shape,
) -> Loop:
    """Reset a block: episode k starts from key k, under the partner's own parameters."""
    block = e, p, k = shape.block
    flat = functools.partial(jnp.reshape, shape=(e * p * k,))
    params = jax.tree.map(
        lambda leaf: flat(jnp.broadcast_to(leaf.reshape(1, p, -1), block)), env_params
    )
    state = env.reset(flat(jnp.broadcast_to(keys, block)), params)
    zero = jnp.zeros(e * p * k)
    false = jnp.zeros(e * p * k, bool)
    tally = Tally(
        running=~false,
        steps=jnp.zeros(e * p * k, jnp.int32),
        returns=zero,
        discounted=zero,
        terms=dict.fromkeys(state.terms, zero),
        force_sum=zero,
        force_peak=zero,
        first_contact=jnp.zeros(e * p * k, jnp.int32),
        distance_sum=zero,
        travel=dict.fromkeys(env.joint_positions(state), zero),
        success=false,
        nonfinite=false,
        contact_peak=None if state.measures.contact is None else zero,
        violated=None if state.measures.violated is None else false,
    )
    return Loop(
        state=state,
        robot=_carries(robots, shape.egos, k if shape.paired else p * k),
        human=_carries(humans, shape.partners, e * k),
        tally=tally,
        time=jnp.zeros((), jnp.int32),
    )


def _advance(
    env: Environment,
    robots: Sequence[Any],
    humans: Sequence[Any],
    steps: int,
    stochastic: bool,
    loop: Loop,
    robot_params: Any,
    human_params: Any,
    keys: jax.Array,
    action: jax.Array | None,
    once: jax.Array | None,
    *,
    shape: Shape,
    forgets: bool = True,
) -> Loop:
    """Advance a block by `steps`; `action` is a robot's from outside; for `once` see `_once`.

    A robot that does not forget is never told that an episode begins.
    """
    e, p, k = shape.block

    def body(loop: Loop, _: None) -> tuple[Loop, None]:
        noise = _noise_keys(keys, loop.time, shape) if stochastic else (None, None)
        robot_action, robot_carry = action, loop.robot
        if robots:
            obs = loop.state.obs["robot"].reshape(*((p, k) if shape.paired else (e, p * k)), -1)
            first = loop.time == 0 if forgets else False
            robot_carry, acted = _act_all(robots, robot_params, loop.robot, obs, first, noise[0])
            robot_action = acted.reshape(e * p * k, -1)
        obs = loop.state.obs["human"].reshape(e, p, k, -1).swapaxes(0, 1).reshape(p, e * k, -1)
        first = loop.time == 0
        human_carry, acted = _act_all(humans, human_params, loop.human, obs, first, noise[1])
        human_action = acted.reshape(p, e, k, -1).swapaxes(0, 1).reshape(e * p * k, -1)
        state = _step_alone(env, loop.state, {"robot": robot_action, "human": human_action}, once)
        travel = _travel(env.joint_positions(loop.state), env.joint_positions(state))
        tally = accumulate(loop.tally, state, travel, loop.time)
        return Loop(state, robot_carry, human_carry, tally, loop.time + 1), None

    return jax.lax.scan(body, loop, None, length=steps)[0]


def accumulate(tally: Tally, state: Any, travel: dict[str, jax.Array], time: jax.Array) -> Tally:
    """Add the step that led to `state`, the `time`-th, to the episodes that were still running."""
    running = tally.running
    earning = running & ~state.nonfinite

    def gained(value: jax.Array) -> jax.Array:
        return jnp.where(earning, value, 0.0)

    measures = state.measures
    reward, force = gained(state.reward), gained(measures.force)
    touches = {}
    if tally.contact_peak is not None:
        peak = jnp.maximum(tally.contact_peak, gained(measures.contact))
        touches = {"contact_peak": peak, "violated": tally.violated | (earning & measures.violated)}
    return Tally(
        running=running & ~(state.terminated | state.truncated),
        steps=tally.steps + running,
        returns=tally.returns + reward,
        discounted=tally.discounted + GAMMA ** time.astype(jnp.float32) * reward,
        terms={name: tally.terms[name] + gained(value) for name, value in state.terms.items()},
        force_sum=tally.force_sum + force,
        force_peak=jnp.maximum(tally.force_peak, force),
        first_contact=jnp.where(
            (tally.first_contact == 0) & (force > 0), time + 1, tally.first_contact
        ),
        distance_sum=tally.distance_sum + gained(measures.distance),
        travel={role: tally.travel[role] + gained(value) for role, value in travel.items()},
        success=tally.success | (earning & measures.success),
        nonfinite=tally.nonfinite | (running & state.nonfinite),
        **touches,
    )


def _once() -> np.ndarray | None:
    """Return the trip count of the loop around one environment step: 1.

    It is passed to the compiled program as an argument. Written as a constant, XLA would see a loop
    of one trip, unroll it, and fuse the physics with the networks around it; how it fuses depends
    on the block's shape, and so would the last bit of every value. None where no loop is wanted: on
    an accelerator the host would wait for it at every step.
    """
    return np.asarray(1, np.int32) if jax.default_backend() == "cpu" else None


def _step_alone(
    env: Environment, state: Any, actions: dict[str, Any], once: jax.Array | None
) -> Any:
    """Step the environment in a loop of its own, into which nothing around it is fused."""
    if once is None:
        return env.step(state, actions)
    return jax.lax.fori_loop(0, once, lambda _, state: env.step(state, actions), state)


def _travel(before: dict[str, jax.Array], after: dict[str, jax.Array]) -> dict[str, jax.Array]:
    return {role: jnp.sum(jnp.abs(after[role] - before[role]), axis=-1) for role in after}


def _act_all(
    policies: Sequence[Any],
    params: Sequence[Any],
    carries: Sequence[Any],
    obs: jax.Array,
    first: jax.Array | bool,
    keys: jax.Array | None,
) -> tuple[tuple[Any, ...], jax.Array]:
    """Let every stack of a seat act for its rows of obs [G, R, O]; see `_act`."""
    starts = itertools.accumulate(_widths(params), initial=0)
    acted = [
        _act(policy, own, carry, obs[start:stop], first, None if keys is None else keys[start:stop])
        for policy, own, carry, (start, stop) in zip(
            policies, params, carries, itertools.pairwise(starts), strict=True
        )
    ]
    return tuple(carry for carry, _ in acted), jnp.concatenate([action for _, action in acted])


def _act(
    policy: Any,
    params: Any,
    carry: Any,
    obs: jax.Array,
    first: jax.Array | bool,
    keys: jax.Array | None,
) -> tuple[Any, jax.Array]:
    """Map a policy over its stacked parameters: obs [G, R, O] -> actions [G, R, A].

    With `keys` [G, R] every row draws its action with its key, else it takes the mode.
    """
    rows = obs.shape[1]
    # A product with one row takes another path on the CPU, which rounds differently: values would
    # depend on the block.
    obs = jnp.broadcast_to(obs, (obs.shape[0], _rows(rows), obs.shape[2]))
    first = jnp.broadcast_to(first, obs.shape[:2])
    if keys is None:
        carry, action = member_map(policy.act)(params, carry, obs, first)
        return carry, action[:, :rows]
    carry, gaussian = member_map(policy.step)(params, carry, obs, first)
    keys = jnp.broadcast_to(keys, obs.shape[:2])
    draw = jax.vmap(jax.vmap(lambda gaussian, key: gaussian.sample(key)))
    return carry, gaussian.action(draw(gaussian, keys))[:, :rows]


def _noise_keys(keys: jax.Array, time: jax.Array, shape: Shape) -> tuple[jax.Array, jax.Array]:
    """Return the keys of the robots' rows and of the humans' at a step, both [G, R].

    They are of the episode, [K] or [P, K], and apart from the environment's stream: every pair of
    an episode sees the same noise.
    """
    e, p, k = shape.block

    def keys_of(role: int) -> jax.Array:
        streams = (_ACTION_STREAM, role, time)
        flat = jax.vmap(lambda key: functools.reduce(jax.random.fold_in, streams, key))(
            keys.ravel()
        )
        return jnp.broadcast_to(flat.reshape(keys.shape), (p, k))

    robot, human = keys_of(0), keys_of(1)
    if not shape.paired:
        robot = jnp.broadcast_to(robot.reshape(1, p * k), (e, p * k))
    return robot, jnp.broadcast_to(human[:, None], (p, e, k)).reshape(p, e * k)


def _carries(policies: Sequence[Any], widths: Sequence[int], rows: int) -> tuple[Any, ...]:
    """Return each stack's recurrent state at the start, leaves [G, R, ...]."""
    return tuple(
        policy.initial_carry((width, _rows(rows)))
        for policy, width in zip(policies, widths, strict=True)
    )


def _widths(params: Sequence[Any]) -> tuple[int, ...]:
    """Return how many policies each stack of parameters has."""
    return tuple(jax.tree.leaves(one)[0].shape[0] for one in params)


def _rows(rows: int) -> int:
    return max(rows, 2)
