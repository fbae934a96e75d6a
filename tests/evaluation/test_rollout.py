import dataclasses
import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import disability_params
from evaluation.cast.roster import Roster
from evaluation.play.jobs import episode_seeds
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack
from population.play.layout import Layout
from population.play.programs import Block, Loop, Programs
from population.play.rollout import Rollout, segment_length
from population.play.tally import GAMMA, Tally
from tests.evaluation.matrix_game import (
    GRU,
    HUMAN,
    PAYOFF,
    ROBOT,
    MatrixGame,
    humans,
    random_roster,
    robots,
)

SETTINGS = ["d1", "d2", "d3"]
OTHER_HUMAN = dataclasses.replace(HUMAN, hidden=(6,))


def stack_of(roster: Roster) -> PolicyStack:
    [stack] = roster.stacks
    assert isinstance(stack, PolicyStack)
    return stack


def disabilities(roster: Roster) -> list[str]:
    return [str(member.disability) for member in roster.describe(roster.ids)]


def play(
    robots: Roster,
    humans: Roster,
    episodes: int = 3,
    env: MatrixGame | None = None,
    seeds: np.ndarray | None = None,
    **options: Any,
) -> Tally:
    robot, human = stack_of(robots), stack_of(humans)
    rollout = Rollout(env or MatrixGame(), [Policy(robot.spec)], [Policy(human.spec)], **options)
    settings = disabilities(humans)
    if seeds is None:
        seeds = np.array(episode_seeds(7, range(episodes)))
    return rollout.run([robot.params], [human.params], disability_params(settings), seeds)


def test_returns_of_the_matrix_game_are_its_payoffs():
    tally = play(robots(-0.5, 0.5), humans(-0.5, 0.5, -0.5))
    luck = tally.terms["luck"]
    expected = 4 * PAYOFF[[0, 1]][:, [0, 1, 0]]
    np.testing.assert_allclose(
        tally.terms["payoff"], np.repeat(expected[:, :, None], 3, axis=2), rtol=1e-6
    )
    np.testing.assert_allclose(tally.returns, tally.terms["payoff"] + luck, rtol=1e-6)
    assert (tally.steps == 4).all()
    assert not tally.nonfinite.any()


def test_discounting_force_and_success_follow_their_definitions():
    tally = play(robots(-0.5, 0.5), humans(0.5))
    step_reward = tally.returns / 4
    np.testing.assert_allclose(
        tally.discounted, step_reward * sum(GAMMA**t for t in range(4)), rtol=1e-6
    )
    np.testing.assert_allclose(tally.force_sum, 4 * 0.5 + 1 + 2 + 3 + 4)
    np.testing.assert_allclose(tally.force_peak, 4.5)
    assert tally.success.tolist() == [[[False] * 3], [[True] * 3]]  # (1, 1) at the second step only


def test_behaviour_is_summed_per_role():
    tally = play(robots(-0.5), humans(0.5))
    np.testing.assert_allclose(tally.travel["robot"], 4 * (0.5 + 0.5))
    np.testing.assert_allclose(tally.travel["human"], 4 * 0.25)
    assert (tally.first_contact == 1).all()
    broken = play(robots(-0.5), humans(0.5), env=MatrixGame(broken_from=0))
    assert not broken.first_contact.any()
    assert not broken.travel["robot"].any()


def test_all_pairs_play_the_same_episodes():
    luck = play(robots(-0.5, 0.5), humans(-0.5, 0.5)).terms["luck"]
    np.testing.assert_array_equal(luck, np.broadcast_to(luck[0, 0], luck.shape))
    assert len(set(luck[0, 0].tolist())) == 3


def test_more_episodes_extend_fewer():
    assert episode_seeds(3, range(10))[:4] == episode_seeds(3, range(4))
    assert episode_seeds(3, range(2, 4)) == episode_seeds(3, range(4))[2:]
    assert episode_seeds(3, range(4)) != episode_seeds(4, range(4))


def test_every_partner_plays_under_its_own_disability():
    tally = play(robots(-0.5, 0.5), humans(-0.5, -0.5, -0.5, disabilities=tuple(SETTINGS)))
    expected = 4 * PAYOFF[:, 0, None] * np.array([1.0, 0.7, 0.4])[None, :]
    np.testing.assert_allclose(
        tally.terms["payoff"], np.repeat(expected[:, :, None], 3, axis=2), rtol=1e-6
    )


def programs(spec: PolicySpec) -> Programs:
    policies = [Policy(spec)], [Policy(HUMAN)]
    return Programs(MatrixGame(), *policies, 4, paired=False, stochastic=False, forgets=True)


def block_of(spec: PolicySpec, episodes: int) -> Block:
    """Return two robots with three humans."""
    return Block(
        robots=(stack_of(random_roster(spec, 2, 1)).params,),
        humans=(stack_of(random_roster(HUMAN, 3, 2)).params,),
        env_params=disability_params(SETTINGS),
        keys=jax.vmap(jax.random.key)(jnp.arange(episodes)),
        trips=np.int32(1),
    )


def test_nonfinite_episode_earns_nothing_afterwards():
    tally = play(robots(-0.5), humans(-0.5), env=MatrixGame(broken_from=2))
    np.testing.assert_allclose(tally.terms["payoff"], 2 * PAYOFF[0, 0])
    assert tally.nonfinite.all()
    assert np.isfinite(tally.force_sum).all()
    np.testing.assert_allclose(tally.force_peak, 2.5)


@pytest.mark.parametrize("spec", [ROBOT, GRU], ids=["mlp", "gru"])
def test_block_equals_single_pairs(spec: PolicySpec):
    """Oracle: a loop over pairs, episodes and steps with one policy at a time."""
    env, seeds = MatrixGame(), episode_seeds(5, range(2))
    robot, human = random_roster(spec, 2, 1), random_roster(HUMAN, 3, 2)
    rollout = Rollout(env, [Policy(spec)], [Policy(HUMAN)])
    settings = disability_params(disabilities(human))
    params = [stack_of(robot).params], [stack_of(human).params]
    block = rollout.run(*params, settings, seeds)
    for e, p, k in np.ndindex(block.returns.shape):
        mine, theirs = stack_of(robot).row(e), stack_of(human).row(p)
        setting = jax.tree.map(lambda leaf, p=p: leaf[p : p + 1], settings)
        state = env.reset(jax.random.key(seeds[k])[None], setting)
        policies = {"robot": (Policy(spec), mine), "human": (Policy(HUMAN), theirs)}
        carries = {role: policy.initial_carry((1,)) for role, (policy, _) in policies.items()}
        total = 0.0
        for t in range(env.episode_length):
            actions = {}
            for role, (policy, params) in policies.items():
                carries[role], actions[role] = policy.act(
                    params, carries[role], state.obs[role], jnp.array([t == 0])
                )
            state = env.step(state, actions)
            total += float(state.reward[0])
        assert block.returns[e, p, k] == pytest.approx(total, rel=1e-5)


SEVERAL = (  # of each seat: its networks, and how many policies of each
    [stack_of(random_roster(ROBOT, 3, 1)), stack_of(random_roster(GRU, 2, 2))],
    [stack_of(random_roster(HUMAN, 3, 3)), stack_of(random_roster(OTHER_HUMAN, 2, 4))],
)
THEIR_SETTINGS = ["d1", "d2", "d3", "d7", "d9"]


def play_stacks(
    robots: list[PolicyStack], humans: list[PolicyStack], settings: list[str], **options: Any
) -> Tally:
    seats = robots, humans
    policies = ([Policy(stack.spec) for stack in seat] for seat in seats)
    params = ([stack.params for stack in seat] for seat in seats)
    rollout = Rollout(MatrixGame(), *policies, **options)
    return rollout.run(*params, disability_params(settings), episode_seeds(5, range(4)))


@pytest.mark.slow_for("stochastic")
@pytest.mark.parametrize("options", [{}, {"stochastic": True}, {"series": 2}], ids=str)
def test_mixed_block_equals_single_networks(options: dict[str, Any]):
    whole = play_stacks(*SEVERAL, THEIR_SETTINGS, **options)
    assert whole.returns.shape == (5, 5, 4)
    assert len(np.unique(whole.returns)) > 10
    shares = slice(0, 3), slice(3, 5)
    for (robot, e), (human, p) in itertools.product(
        *(zip(seat, shares, strict=True) for seat in SEVERAL)
    ):
        alone = play_stacks([robot], [human], THEIR_SETTINGS[p], **options)
        for value, every in zip(jax.tree.leaves(alone), jax.tree.leaves(whole), strict=True):
            np.testing.assert_allclose(value, every[e, p], rtol=1e-5)


def test_paired_block_equals_own_pairs():
    own = play_stacks(*SEVERAL, THEIR_SETTINGS, paired=True)
    every = play_stacks(*SEVERAL, THEIR_SETTINGS)
    assert own.returns.shape == (1, 5, 4)
    diagonal = every.returns[np.arange(5), np.arange(5)]
    np.testing.assert_allclose(own.returns[0], diagonal, rtol=1e-5)
    assert len(np.unique(diagonal)) > 10


def test_drawn_actions_depend_on_episode_step_role():
    env = MatrixGame(episode_length=1)
    tally = play(robots(0.0, 0.0), humans(0.0, 0.0), episodes=64, env=env, stochastic=True)
    force = tally.force_sum - 1  # |the robot's second action|
    np.testing.assert_array_equal(force, np.broadcast_to(force[0, 0], force.shape))
    assert len(set(force[0, 0].tolist())) == 64
    chosen = tally.terms["payoff"][0, 0]  # all four cells come up: the roles draw apart
    assert {round(float(value), 3) for value in chosen} == {4.0, 1.0, 0.5, 3.0}
    np.testing.assert_array_equal(
        play(robots(0.0), humans(0.0), episodes=8, env=env, stochastic=True).returns[0, 0],
        tally.returns[0, 0, :8],
    )
    whole = play(robots(0.0), humans(0.0), episodes=8, stochastic=True)
    assert len(set(whole.force_sum[0, 0].tolist())) == 8


def test_own_episodes_draw_own_actions():
    env = MatrixGame(episode_length=1)
    seeds = np.arange(128).reshape(2, 64)
    own = play(robots(0.0, 0.0), humans(0.0, 0.0), seeds=seeds, env=env, stochastic=True).force_sum
    np.testing.assert_array_equal(own[0], own[1])  # both robots meet a partner in the same episodes
    assert len(set(own[0].ravel().tolist())) == 128
    for partner, row in enumerate(seeds):
        common = play(robots(0.0), humans(0.0), seeds=row, env=env, stochastic=True)
        np.testing.assert_allclose(common.force_sum[0, 0], own[0, partner], rtol=1e-6)


def test_segments_divide_the_episode():
    assert [segment_length(steps) for steps in (1000, 4, 150, 997)] == [100, 4, 75, 1]


@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("stochastic", [False, True])
def test_values_do_not_depend_on_the_block(stochastic: bool):
    wide = PolicySpec("robot", observation_size=3, action_size=2, hidden=(64, 64), normalise=True)
    robot, human = random_roster(wide, 3, 1), random_roster(HUMAN, 5, 2)
    whole = play(robot, human, episodes=2, stochastic=stochastic)
    rollout = Rollout(MatrixGame(), [Policy(wide)], [Policy(HUMAN)], stochastic=stochastic)
    for e, p, k in np.ndindex(3, 5, 2):
        params = [[stack_of(robot).take([e]).params], [stack_of(human).take([p]).params]]
        settings = disability_params([f"d{1 + p}"])
        alone = rollout.run(*params, settings, episode_seeds(7, range(k, k + 1)))
        assert alone.returns[0, 0, 0] == whole.returns[e, p, k]
        assert alone.force_sum[0, 0, 0] == whole.force_sum[e, p, k]


def parameters_per_simulation(program: Any, simulations: int, kernel: int) -> list[str]:
    """Return the equations, at any depth, whose result holds a kernel for each simulation."""
    sizes = []
    for equation in program.eqns:
        for value in equation.outvars:
            if math.prod(getattr(value.aval, "shape", ())) >= simulations * kernel:
                sizes.append(str(equation.primitive))
        for inner in jax.tree.leaves(
            list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")
        ):
            inner = getattr(inner, "jaxpr", inner)
            if hasattr(inner, "eqns"):
                sizes += parameters_per_simulation(inner, simulations, kernel)
    return sizes


def test_no_simulation_has_parameters_of_its_own():
    wide = PolicySpec("robot", observation_size=3, action_size=2, hidden=(64, 64), normalise=False)
    block = block_of(wide, episodes=50)
    made = programs(wide)
    loop = made.start(block, made.env.reset(*made.episodes(block)))
    program = jax.make_jaxpr(made.advance)(loop, block, None)
    assert parameters_per_simulation(program.jaxpr, 300, 64 * 64) == []

    def gathered(obs: jax.Array, kernels: jax.Array) -> jax.Array:
        return jnp.einsum("no,noh->nh", obs, kernels[jnp.arange(300) // 150])

    kernels = block.robots[0]["Dense_1"]["kernel"]
    planted = jax.make_jaxpr(gathered)(jnp.zeros((300, 64)), kernels)
    assert parameters_per_simulation(planted.jaxpr, 300, 64 * 64) != []


def test_threads_share_one_compilation(monkeypatch: pytest.MonkeyPatch):
    traced: list[Any] = []
    start = Programs.start

    def counted(self: Programs, block: Block, state: Any) -> Loop:
        traced.append(self.layout(block))
        return start(self, block, state)

    monkeypatch.setattr(Programs, "start", counted)
    robot, human = stack_of(robots(-0.5)), stack_of(humans(0.5))
    rollout = Rollout(MatrixGame(), [Policy(robot.spec)], [Policy(human.spec)])
    block = [robot.params], [human.params], disability_params(["d1"]), episode_seeds(7, range(3))
    device = jax.local_devices()[0]
    with ThreadPoolExecutor(3) as pool:
        ahead = [pool.submit(rollout.prepare, *block, device) for _ in range(2)]
        tally = pool.submit(rollout.run, *block).result()
        assert [work.result() for work in ahead] == [None, None]
    assert traced == [Layout((1,), (1,), 3)]
    assert tally.returns.shape == (1, 1, 3)
