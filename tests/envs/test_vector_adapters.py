"""The vector adapters: against the environment itself, and by other libraries' own checks."""

import warnings
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pettingzoo
import pytest

import assistax_envs
from assistax_envs.adapters.batch import OBSERVATION_BOUND, Batch, checked_seed
from assistax_envs.adapters.gymnasium import AssistaxVectorEnv
from assistax_envs.adapters.jaxmarl import AssistaxMarlVectorEnv
from assistax_envs.adapters.partners import Idle, Persons
from assistax_envs.adapters.pettingzoo import ROLES, AssistaxParallelVectorEnv
from assistax_envs.persons import PersonPlayer, person
from assistax_envs.persons.rows import FAMILIES, index, marked
from assistax_envs.preferences import WORDS

TASK, LENGTH = "scratch", 4


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Episodes of four steps, of environments that a test makes."""
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", LENGTH)


@pytest.fixture(scope="module")
def vector() -> AssistaxVectorEnv:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("assistax_envs.env.EPISODE_LENGTH", LENGTH)
        return AssistaxVectorEnv(TASK, 3, disability=("d1", "d5", "d9"), backend="native")


def actions(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 7)).astype(np.float32)


def test_the_batch_is_the_environment():
    batch, env = Batch(TASK, Idle("d3"), 2, "native"), assistax_envs.make(TASK, "native")
    obs, state = jax.jit(batch.reset)(jax.random.key(7))
    _, of_starts = jax.random.split(jax.random.key(7))
    humans = assistax_envs.disability_params(["d3", "d3"])
    expected = jax.jit(env.reset)(jax.random.split(of_starts, 2), humans)
    np.testing.assert_array_equal(obs["robot"], expected.obs["robot"])
    robot = jnp.asarray(actions(2))
    state, step = jax.jit(batch.step)(jax.random.key(0), state, {"robot": robot})
    expected = jax.jit(env.step)(expected, {"robot": robot, "human": jnp.zeros((2, 3))})
    np.testing.assert_allclose(step.obs["robot"], expected.obs["robot"], atol=1e-6)
    np.testing.assert_allclose(step.reward, expected.reward, atol=1e-6)
    np.testing.assert_allclose(step.info["terms"]["scratch"], expected.terms["scratch"], atol=1e-6)


def test_humans_who_do_nothing_sit_in_every_task():
    """At the mouth a human has five torques, elsewhere three."""
    env = AssistaxVectorEnv("gentle_feeding", np.int64(2), backend="native")
    start, _ = env.reset(seed=0)
    obs, *_ = env.step(np.zeros((2, 7)))
    assert obs.shape == start.shape == (2, 56)


def test_gymnasium_resets_in_the_same_step(vector):
    assert vector.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.SAME_STEP
    start, _ = vector.reset(seed=4)
    for step in range(1, 2 * LENGTH + 1):
        obs, reward, terminated, truncated, info = vector.step(actions(3, step))
        ended = step % LENGTH == 0
        assert truncated.tolist() == [ended] * 3 and not terminated.any()
        assert ("final_obs" in info) == ("final_info" in info) == ended
        assert obs in vector.observation_space and reward.shape == (3,)
    last, final = info["final_obs"], info["final_info"]
    assert not np.allclose(last, obs) and info["_final_obs"].all()
    # A start is at rest, as the first one was; what a robot moved is not.
    assert np.abs(obs - start).max() < np.abs(last - start).max()
    np.testing.assert_allclose(sum(v for k, v in final["terms"].items() if k[0] != "_"), reward)


def test_gymnasium_is_reproducible_and_finite(vector):
    def play(seed: int | None) -> np.ndarray:
        seen = [vector.reset(seed=seed)[0]]
        seen += [vector.step(actions(3, step))[0] for step in range(LENGTH + 1)]
        return np.stack(seen)

    first, other, again = play(11), play(None), play(11)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    for space in (vector.observation_space, vector.action_space):
        assert np.isfinite(space.low).all() and np.isfinite(space.high).all()
    assert vector.single_observation_space.high[0] == OBSERVATION_BOUND
    # What was returned is the caller's own.
    obs, _ = vector.reset(seed=1)
    obs[:] = np.nan
    assert np.isfinite(vector.step(actions(3))[0]).all()


@pytest.mark.parametrize("seed", [[1, 2, 3], [None, 1, 2], -1, True])
def test_simulations_have_no_seeds_of_their_own(vector, seed: Any):
    """Gymnasium allows a list, one for each simulation; ours are drawn together."""
    with pytest.raises(ValueError, match=r"seed is .*; give one whole number from 0, from"):
        vector.reset(seed=seed)


@pytest.mark.parametrize("seed", [[1, 2], (1, 2), np.array([1, 2]), 1.5, -1, True, "a"])
def test_a_seed_is_one_whole_number(seed: Any):
    with pytest.raises(ValueError, match=r"seed is .*; give one whole number from 0, from"):
        checked_seed(seed)
    for whole in (None, 0, 3, np.uint32(4)):
        assert checked_seed(whole) == whole


def test_gymnasium_takes_its_own_wrappers(vector):
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(vector)
    env.reset(seed=2)
    rewards = []
    for step in range(LENGTH):
        _, reward, _, _, info = env.step(actions(3, step))
        rewards.append(reward)
    np.testing.assert_allclose(info["episode"]["r"], np.sum(rewards, axis=0), rtol=1e-5)
    assert info["episode"]["l"].tolist() == [LENGTH] * 3
    listed = gymnasium.wrappers.vector.DictInfoToList(vector)
    listed.reset(seed=2)
    infos = [listed.step(actions(3, step))[4] for step in range(LENGTH)]
    assert len(infos[0]) == 3 and set(infos[0][1]) >= {"force", "success", "terms"}
    assert infos[-1][2]["final_obs"].shape == (34,)


def test_gymnasium_makes_it_by_its_id():
    from assistax_envs.adapters.gymnasium import register

    names = register()
    try:
        env = gymnasium.make_vec(f"assistax/{TASK}-v1", 2, backend="native", disability="d9")
        assert isinstance(env.unwrapped, AssistaxVectorEnv) and env.num_envs == 2
    finally:
        for name in names:
            del gymnasium.registry[name]


class Row(gymnasium.Env):
    """The one simulation of a vector environment, for checks that know no batch."""

    def __init__(self) -> None:
        self.vector = AssistaxVectorEnv(TASK, 1, backend="native")
        self.observation_space = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        obs, info = self.vector.reset(seed=seed, options=options)
        return obs[0], info

    def step(self, action):
        obs, reward, terminated, truncated, info = self.vector.step(action[None])
        return obs[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), info


@pytest.mark.slow
def test_gymnasium_passes_the_check_of_environments():
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():  # that it was not made by an id
        warnings.filterwarnings("ignore", message=".*spec")
        check_env(Row(), skip_render_check=True)


class ParallelRow(pettingzoo.ParallelEnv):
    """Likewise for PettingZoo, whose agents go when an episode ends."""

    def __init__(self, vector: AssistaxParallelVectorEnv) -> None:
        self.vector, self.agents = vector, []
        self.possible_agents = vector.possible_agents
        self.metadata = vector.metadata

    def observation_space(self, agent):
        return self.vector.observation_space(agent)

    def action_space(self, agent):
        return self.vector.action_space(agent)

    def reset(self, seed=None, options=None):
        obs, infos = self.vector.reset(seed, options)
        self.agents = list(self.vector.agents)
        return {agent: value[0] for agent, value in obs.items()}, infos

    def step(self, actions):
        *values, infos = self.vector.step({role: value[None] for role, value in actions.items()})
        values = [{agent: value[0] for agent, value in by_agent.items()} for by_agent in values]
        if any(values[3].values()):
            self.agents = []
        return *values, infos


@pytest.mark.slow
def test_pettingzoo_passes_its_own_test():
    from pettingzoo.test import parallel_api_test

    for partners in (None, Idle("d2")):
        vector = AssistaxParallelVectorEnv(TASK, 1, partners, backend="native")
        parallel_api_test(ParallelRow(vector), num_cycles=3 * LENGTH)


def test_pettingzoo_has_batches_of_both_seats():
    env = AssistaxParallelVectorEnv(TASK, 2, disability="d3", backend="native")
    with pytest.raises(ValueError, match=r"call reset\(\) first"):
        env.state()
    obs, infos = env.reset(seed=3)
    assert {role: value.shape for role, value in obs.items()} == {
        "robot": (2, 34),
        "human": (2, 38),
    }
    assert env.state().shape == (2, 52) and infos == {"robot": {}, "human": {}}
    still = {"robot": np.zeros((2, 7)), "human": np.zeros((2, 3))}
    moved = {"robot": np.zeros((2, 7)), "human": np.ones((2, 3))}
    results = []
    for human in (still, moved):
        env.reset(seed=3)
        results.append([env.step(human) for _ in range(LENGTH)])
    assert not np.allclose(results[0][0][0]["human"], results[1][0][0]["human"])
    obs, rewards, _, truncated, infos = results[1][-1]
    assert truncated["human"].tolist() == [True, True] and env.agents == list(ROLES)
    assert not np.allclose(infos["human"]["final_obs"], obs["human"])
    np.testing.assert_array_equal(rewards["robot"], rewards["human"])
    with pytest.raises(ValueError, match="no actions of the human; give those of every agent"):
        env.step({"robot": np.zeros((2, 7))})


@pytest.mark.slow
def test_jaxmarl_scans_over_ends_of_episodes():
    env = AssistaxMarlVectorEnv(TASK, 2, disability=("d1", "d9"), backend="native")
    still = {"robot": jnp.zeros((2, 7)), "human": jnp.zeros((2, 3))}

    @jax.jit
    def play(key: jax.Array) -> Any:
        def body(state: Any, key: jax.Array) -> tuple[Any, Any]:
            obs, state, rewards, dones, infos = env.step(key, state, still)
            return state, (obs, rewards["__all__"], dones["__all__"], infos, state.env.step)

        _, state = env.reset(key)
        return jax.lax.scan(body, state, jax.random.split(key, LENGTH + 1))[1]

    obs, rewards, dones, infos, steps = play(jax.random.PRNGKey(5))  # raw, as JaxMARL's are
    assert dones[:, 0].tolist() == [False, False, False, True, False]
    assert steps[:, 1].tolist() == [1, 2, 3, 0, 1] and rewards.shape == (LENGTH + 1, 2)
    assert {value.shape for value in infos.values()} == {(LENGTH + 1, 2, 2)}
    assert env.observation_space("human").contains(obs["human"])
    assert AssistaxMarlVectorEnv(TASK, 2, Idle(), backend="native").agents == ["robot"]


def test_arrays_pass_without_copies():
    env = AssistaxVectorEnv(TASK, 2, backend="native", arrays="jax")
    obs, _ = env.reset(seed=0)
    shared = np.from_dlpack(obs)
    assert shared.__array_interface__["data"][0] == obs.unsafe_buffer_pointer()

    class Tensor:  # what PyTorch's has
        def __init__(self, values: np.ndarray) -> None:
            self.values = values

        def __dlpack__(self, **options: Any) -> Any:
            return self.values.__dlpack__(**options)

        def __dlpack_device__(self) -> Any:
            return self.values.__dlpack_device__()

    results = []
    for given in (actions(2), jnp.asarray(actions(2)), Tensor(actions(2))):
        env.reset(seed=0)
        results.append(np.asarray(env.step(given)[0]))
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


def test_wrong_arguments_say_what_is_allowed(vector):
    with pytest.raises(ValueError, match="num_envs is 0; allowed is 1 to"):
        AssistaxVectorEnv(TASK, 0)
    with pytest.raises(ValueError, match="arrays is 'torch'; allowed are 'numpy' and 'jax'"):
        AssistaxVectorEnv(TASK, 2, arrays="torch")
    with pytest.raises(ValueError, match="no disability setting is named"):
        AssistaxVectorEnv(TASK, 2, disability=())
    vector.reset(seed=0)
    with pytest.raises(ValueError, match=r"have shape \(2, 7\); expected \(3, 7\)"):
        vector.step(np.zeros((2, 7)))
    with pytest.raises(ValueError, match="all simulations begin together"):
        vector.reset(options={"reset_mask": np.ones(3, bool)})


@pytest.mark.slow
def test_every_episode_brings_new_persons():
    people = Persons("gentle_scratch")
    env = AssistaxVectorEnv("gentle_scratch", 4, people, backend="native", arrays="jax")
    assert len(people) == 14_400
    env.reset(seed=0)
    first = env.partner_names()
    for step in range(LENGTH):
        env.step(actions(4, step))
    second = env.partner_names()
    assert len({*first, *second}) == 8
    assert all(person("gentle_scratch", int(name[-5:])).side == "training" for name in first)


@pytest.mark.slow
def test_a_person_acts_as_itself():
    task, someone = "gentle_scratch", person("gentle_scratch", 42)
    batch = Batch(task, Persons(task, [42]), 2, "native")
    _, state = jax.jit(batch.reset)(jax.random.key(1))
    np.testing.assert_allclose(
        state.env.params.preference.force[0], someone.row[index(task)["liked_force"]]
    )
    player = PersonPlayer(task)
    human = jax.jit(player.act)(
        {"row": jnp.asarray(marked(someone.row[None])[0])},
        player.initial_carry((2,)),
        state.env.obs["human"],
        jnp.ones(2, bool),
    )[1]
    robot = jnp.asarray(actions(2))
    step = jax.jit(batch.step)
    with_person = step(jax.random.key(0), state, {"robot": robot})[1]
    by_hand = step(jax.random.key(0), state, {"robot": robot, "human": human})[1]
    idle = step(jax.random.key(0), state, {"robot": robot, "human": jnp.zeros((2, 3))})[1]
    np.testing.assert_allclose(with_person.obs["human"], by_hand.obs["human"], atol=1e-5)
    assert np.abs(with_person.obs["human"] - idle.obs["human"]).max() > 1e-3


class Talker:
    """Partners who say word `k` to simulation k, in the first step alone."""

    params = ()

    def begin(self, params: Any, key: jax.Array, before: Any, n: int) -> Any:
        _, humans = Idle().begin(params, key, before, n)
        return jnp.zeros(n, jnp.int32), humans

    def act(self, params: Any, seated: Any, obs: jax.Array, first: jax.Array) -> Any:
        word = jnp.where(first, jnp.arange(len(obs), dtype=jnp.int32), 0)
        return word, jnp.zeros((len(obs), 3), jnp.float32)

    def word(self, seated: Any, n: int) -> jax.Array:
        return seated

    def names(self, seated: Any, n: int) -> list[str]:
        return ["talker"] * n


def heard_in(obs: Any) -> list[int]:
    """Return the words that robots hear, from the end of their observations."""
    said = np.asarray(obs)[:, -len(WORDS) :]
    return np.where(said.max(axis=1) > 0, said.argmax(axis=1) + 1, 0).tolist()


@pytest.mark.parametrize("form", ["gymnasium", "pettingzoo", "jaxmarl"])
def test_partners_speak_through_every_adapter(form: str) -> None:
    made: Any = {
        "gymnasium": AssistaxVectorEnv,
        "pettingzoo": AssistaxParallelVectorEnv,
        "jaxmarl": AssistaxMarlVectorEnv,
    }[form]
    robot, env = actions(3), made("gentle_scratch", 3, Talker(), backend="native")
    if form == "gymnasium":
        env.reset(seed=0)
        obs = env.step(robot)[0]
    elif form == "pettingzoo":
        env.reset(seed=0)
        obs = env.step({"robot": robot})[0]["robot"]
    else:
        _, state = env.reset(jax.random.key(0))
        obs = env.step(jax.random.key(1), state, {"robot": jnp.asarray(robot)})[0]["robot"]
    assert heard_in(obs) == [0, 1, 2]


@pytest.mark.parametrize("form", ["pettingzoo", "jaxmarl"])
def test_an_agent_in_the_humans_seat_may_be_given_words(form: str) -> None:
    acts: dict[str, Any] = {"robot": actions(2), "human": np.zeros((2, 3), np.float32)}
    if form == "pettingzoo":
        env = AssistaxParallelVectorEnv("gentle_scratch", 2, backend="native")
        env.reset(seed=0)
        obs = [env.step(acts | said)[0]["robot"] for said in ({}, {"word": np.array([8, 0])})]
    else:
        env = AssistaxMarlVectorEnv("gentle_scratch", 2, backend="native")
        _, state = env.reset(jax.random.key(0))
        given, acts = ({}, {"word": jnp.array([8, 0])}), jax.tree.map(jnp.asarray, acts)
        obs = [env.step(jax.random.key(1), state, acts | said)[0]["robot"] for said in given]
    assert [heard_in(one) for one in obs] == [[0, 0], [8, 0]]


def test_persons_act_by_their_own_family() -> None:
    """Persons with the same numbers, and another family, act otherwise."""
    task = "gentle_scratch"
    people = Persons(task, [42, 10_042])
    (number, row, _), _ = people.begin(people.params, jax.random.key(2), None, 2)
    np.testing.assert_array_equal(row[0, :-1], row[1, :-1])
    assert sorted(number.tolist()) == [42, 10_042]
    named = [f"{task}/person-00042", f"{task}/person-10042"]
    assert sorted(people.names((number,), 2)) == named
    batch = Batch(task, people, 2, "native")
    _, state = jax.jit(batch.reset)(jax.random.key(2))
    obs = jnp.broadcast_to(state.env.obs["human"][:1], state.env.obs["human"].shape)
    seated, action = people.act(state.params, state.seated, obs, jnp.ones(2, bool))
    player = PersonPlayer(task)
    for at, number in enumerate(np.asarray(state.seated[0])):
        alone = marked(
            person(task, 42).row[None], FAMILIES.index(person(task, int(number)).family)
        )[0]
        given = {"row": jnp.asarray(alone)}, player.initial_carry((2,))
        _, own = player.act(*given, obs, jnp.ones(2, bool))
        np.testing.assert_allclose(action[at], own[at], atol=1e-6)
    assert people.word(seated, 2).shape == (2,)


def test_persons_of_the_test_side_are_refused():
    for number in (8000, 19_500, 20_000, 30_000, -1):
        with pytest.raises(ValueError, match=f"person {number} cannot be trained with"):
            Persons("gentle_scratch", [1, number])
    with pytest.raises(ValueError, match="task is 'swim'; allowed are "):
        Persons("swim")
    with pytest.raises(ValueError, match="no person is named"):
        Persons("gentle_bath", [])
