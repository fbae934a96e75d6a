"""Persons: perception, reactions to touches, and help."""

import functools
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from PIL import Image

from assistax_envs.persons import muscles, reaction
from assistax_envs.persons.body import JOINTS
from assistax_envs.persons.controller import Controller, Mind
from assistax_envs.persons.measure import earned, episodes, film
from assistax_envs.persons.player import PersonPlayer, person_params
from assistax_envs.persons.rows import (
    FAMILIES,
    INNER,
    PARAMETERS,
    WIDTH,
    index,
    left,
    marked,
    person_kind,
    persons,
)
from assistax_envs.persons.senses import sense
from assistax_envs.preferences import PREFERRED, VALUES
from assistax_envs.registered import REGISTERED
from assistax_envs.tasks.base import HUMAN_ACTUATORS
from assistax_envs.tasks.gentle_base import FELT
from tests.envs.conftest import constant_actions, each_of, environment, one_gentle_task, play, start

BATCH = 48
HUMANS = ("person", "idle")
NOBODY = {  # numbers of somebody without impairment or chance, of the gentle tasks of the skin
    "strength": 1.0, "range": 1.0, "tremor_frequency": 6.0, "tremor": 0.0, "spasticity": 0.0,
    "catch_speed": 1.0, "fatigue": 0.0, "slow_start": 0.1, "stiffness": 1.0, "delay": 0.1,
    "noise": 0.0, "gravity": 1.0, "pace": 0.1, "initiative": 0.0, "lapses": 0.0,
    "belief_shoulder1": 0.0, "belief_shoulder2": 0.0, "belief_elbow": 0.0, "liked_force": 4.0,
    "liked_speed": 0.05, "tolerance": 2.5, "liked_distance": 0.25, "liked_place": 0.2,
    "settle": 0.3, "withdraw": 0.15, "lean": 0.05, "limit": 1.0, "expressive": 0.0,
    "talkative": 0.0, "word_delay": 0.6, "word_pause": 1.0, "word_error": 0.0,
}  # fmt: skip


def somebody(task: str = "gentle_scratch", count: int = 1, **numbers: float) -> np.ndarray:
    """Return rows [count, 30] of a person without impairment, with the given numbers."""
    row = [(NOBODY | numbers)[parameter.name] for parameter in PARAMETERS[task]]
    return np.array([row] * count, np.float32)


@functools.cache
def player(task: str) -> PersonPlayer:
    return PersonPlayer(task)


def controller(task: str = "gentle_scratch") -> Controller:
    return player(task).controller


@functools.cache
def acting(task: str):
    return jax.jit(player(task).act)


@functools.cache
def at_rest(task: str = "gentle_scratch") -> np.ndarray:
    """Return the human's observation [O] at an episode's start, without a touch."""
    return np.array(start(task, "fused", ["d1"] * 3, seed=3).obs["human"][0])


def watched(
    rows: np.ndarray, touches: np.ndarray, task: str = "gentle_scratch", family: str = "spring"
) -> tuple[list[Mind], np.ndarray]:
    """Return carries and actions [T, N, 3] while forces [T] N act on an arm that is held still."""
    count, columns = len(rows), person_kind(task).columns
    # The paper's tasks have the force itself, in N.
    felt, unit = ("touch", 10.0) if "touch" in columns else ("force", 1.0)
    where = columns[felt].start
    rows = np.resize(rows, (BATCH, WIDTH))  # one size: compiled once
    row = jnp.asarray(marked(rows, FAMILIES.index(family)))
    mind, minds, actions = player(task).initial_carry((BATCH,)), [], []
    for time, touch in enumerate(touches):
        obs = np.tile(at_rest(task), (BATCH, 1))
        obs[:, where] = touch / unit
        if "felt" in columns:  # the first wish, of forces but in lift
            seen = columns["felt"].start
            obs[:, seen] = touch / VALUES[PREFERRED[task][0]][1]
            obs[:, seen + len(PREFERRED[task])] = touch > FELT
        first = jnp.full(BATCH, time == 0)
        mind, action = acting(task)({"row": row}, mind, jnp.asarray(obs), first)
        minds.append(jax.tree.map(lambda leaf: leaf[:count], mind))
        actions.append(np.asarray(action)[:count])
    return minds, np.stack(actions)


@each_of(tuple(task for task in PARAMETERS if REGISTERED[task].seat == "arm"))
def test_senses_read_what_the_human_observes(task: str) -> None:
    env = environment(task, "fused")
    assert list(person_kind(task).columns.values())[-1].stop == env.observation_size["human"]
    actions = constant_actions(3, 3, 0.3, 0.2)
    state = play(task, "fused", start(task, "fused", ["d1"] * 3, seed=5), actions)[-1]
    senses = sense(task, state.obs["human"])
    addresses = [env.model.joint(name).qposadr[0] for name in HUMAN_ACTUATORS]
    np.testing.assert_allclose(senses.position, state.physics.qpos[:, addresses], atol=0.02)
    np.testing.assert_allclose(senses.force, state.measures.force, rtol=1e-4, atol=1e-4)
    position, _ = controller(task).arm.frames(senses.position)
    seen = state.obs["human"]
    for segment, name in enumerate(("upper_arm", "lower_arm")):
        np.testing.assert_allclose(
            position[:, segment], seen[:, person_kind(task).columns[name]], atol=5e-3
        )


@pytest.mark.parametrize("task", ["gentle_scratch", "gentle_lift"])
def test_arm_weighs_and_turns_as_in_mujoco(task: str) -> None:
    arm, model = controller(task).arm, environment(task, "fused").model
    rng = np.random.default_rng(1)
    angles = rng.uniform(*arm.range.T, (4, JOINTS)).astype(np.float32)
    weight = np.asarray(arm.gravity(jnp.asarray(angles)))
    data, dofs = mujoco.MjData(model), [model.joint(name).dofadr[0] for name in HUMAN_ACTUATORS]
    qpos = [model.joint(name).qposadr[0] for name in HUMAN_ACTUATORS]
    # The pose in which episodes start has no public name; it fills the other joints.
    start = environment(task, "fused")._task.pose.angle
    for row, own in zip(angles, weight, strict=True):
        data.qpos[:] = start
        data.qpos[qpos] = row
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(own, data.qfrc_bias[dofs], atol=1e-4)
    hand = data.geom("human_right_hand").xpos
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacGeom(model, data, jacobian, None, model.geom("human_right_hand").id)
    ours = arm.jacobian(
        jnp.asarray(angles[-1:]), jnp.asarray(hand[None], jnp.float32), jnp.ones(1, bool)
    )
    np.testing.assert_allclose(ours[0], jacobian[:, dofs], atol=1e-5)


@one_gentle_task
def test_environment_pays_by_the_persons_preference(task: str) -> None:
    env, rows, place = environment(task, "fused"), persons(task)[:4], index(task)
    keys = jax.random.split(jax.random.key(1), 4)
    state = jax.jit(env.reset)(keys, person_params(task, rows))
    for name in ("force", "speed", "distance", "place"):
        if f"liked_{name}" in place:
            liked = getattr(state.task.preference, name)
            np.testing.assert_array_equal(liked, rows[:, place[f"liked_{name}"]])


@pytest.mark.parametrize("family", ["spring", "muscle"])
def test_same_start_gives_same_actions_in_any_order(family: str) -> None:
    rows, order = persons("gentle_scratch")[:BATCH], np.random.default_rng(2).permutation(BATCH)
    touches = np.concatenate([np.zeros(5), np.full(40, 12.0), np.zeros(15)])
    _, actions = watched(rows, touches, family=family)
    np.testing.assert_array_equal(actions, watched(rows, touches, family=family)[1])
    np.testing.assert_array_equal(
        actions[:, order], watched(rows[order], touches, family=family)[1]
    )
    assert np.abs(actions).max() > 0.05 and len(np.unique(actions[-1, :, 0])) == BATCH


@pytest.mark.parametrize("family", ["spring", "muscle"])
def test_excess_force_is_answered_and_forgiven(family: str) -> None:
    rows = somebody(count=2, slow_start=5.0)  # nobody begins to help meanwhile
    rows[1, index("gentle_scratch")["tolerance"]] = 5.0  # bears 20 N, not 10
    minds, actions = watched(
        rows, np.concatenate([np.zeros(10), np.full(50, 16.0), np.zeros(200)]), family=family
    )
    discomfort = np.array([mind.reaction.discomfort for mind in minds])
    assert (discomfort[:10] == 0.0).all() and (discomfort[:, 1] == 0.0).all()
    assert discomfort[59, 0] > 0.4 and discomfort[-1, 0] < 0.1 * discomfort[59, 0]
    before, pressed = np.abs(actions[5]).max(axis=1), np.abs(actions[59]).max(axis=1)
    assert pressed[0] > 3.0 * before[0] and pressed[1] < 1.5 * before[1]


@pytest.mark.parametrize("delay", [0.06, 0.14, 0.3])
def test_touch_is_felt_after_the_delay(delay: float) -> None:
    minds, _ = watched(somebody(delay=delay), np.concatenate([np.zeros(4), np.full(30, 20.0)]))
    discomfort = np.array([mind.reaction.discomfort[0] for mind in minds])
    assert np.flatnonzero(discomfort > 0.0)[0] == 4 + round(delay / 0.02)


def test_person_withdraws_from_force_and_leans_in() -> None:
    arm, obs = controller().arm, jnp.asarray(at_rest()[None])
    senses = sense("gentle_scratch", obs)
    position, _ = arm.frames(senses.position)
    for force, expected in ((20.0, 1.0), (1.0, -1.0)):
        minds, _ = watched(somebody(), np.full(60, force))
        shift = minds[-1].reaction.shift
        size = float(jnp.linalg.norm(shift))
        assert 0.03 < size < 0.2
        moved = arm.frames(senses.position + 0.1 * shift)[0] - position
        away = position - senses.tool[:, None]
        nearer = jnp.argmin(jnp.linalg.norm(away[0], axis=-1))
        assert float((moved * away)[0, nearer].sum()) * expected > 0.0


def test_torques_stay_within_strength() -> None:
    task = "gentle_scratch"
    rows = persons(task)[INNER : INNER + BATCH]
    strength = np.array([left(task, float(s)) for s in rows[:, index(task)["strength"]]])
    rng, n = np.random.default_rng(4), len(rows)
    for family in ("spring", "muscle"):
        row = jnp.asarray(marked(rows, FAMILIES.index(family)))
        mind, most = player(task).initial_carry((n,)), 0.0
        for time in range(30):
            obs = at_rest(task) + rng.normal(0.0, 3.0, (n, len(at_rest(task))))
            mind, action = acting(task)(
                {"row": row},
                mind,
                jnp.asarray(obs, jnp.float32),
                jnp.full(n, time == 0),
            )
            share = np.abs(action).max(axis=1) / strength
            most = max(most, float(share.max()))
            assert (share < 1.0 + 1e-6).all()
        assert most > 0.99  # they are driven to their ends


def test_a_tremor_has_its_frequency() -> None:
    frequencies = np.array([4.5, 7.0, 11.0])
    rows = somebody(count=3, initiative=1.0, tremor=0.2)
    rows[:, index("gentle_scratch")["tremor_frequency"]] = frequencies
    _, actions = watched(rows, np.zeros(600))
    steady = actions[100:, :, 1] - actions[100:, :, 1].mean(axis=0)
    spectrum = np.abs(np.fft.rfft(steady, axis=0))
    peaks = np.fft.rfftfreq(500, 0.02)[spectrum.argmax(axis=0)]
    np.testing.assert_allclose(peaks, frequencies, atol=0.15)


def test_initiative_decides_when_help_starts() -> None:
    rows = somebody(count=3)
    rows[:, index("gentle_scratch")["initiative"]] = 0.1, 0.5, 0.9
    touches = np.concatenate([np.zeros(50), np.full(50, 2.0), np.full(50, 6.0)])
    helps = np.array([mind.helps for mind in watched(rows, touches)[0]])
    assert helps[49].tolist() == [False, False, True]
    assert helps[99].tolist() == [False, True, True]
    assert helps[149].tolist() == [True, True, True]


def test_hurt_person_stops_helping_and_begins_again() -> None:
    touches = np.concatenate([np.zeros(60), np.full(60, 40.0), np.zeros(120)])
    helps = np.array([mind.helps[0] for mind in watched(somebody(initiative=1.0), touches)[0]])
    assert helps[59] and not helps[119] and helps[-1]


def test_intention_follows_minimum_jerk_in_fitts_time() -> None:
    rows = somebody(count=2, initiative=1.0)
    rows[:, index("gentle_scratch")["pace"]] = 0.1, 0.5
    minds, _ = watched(rows, np.zeros(200))
    intended = np.array([mind.intended for mind in minds])
    time = np.asarray(minds[-1].time)
    way = intended - intended[5]
    joint = np.abs(way[-1]).max(axis=0).argmax()
    share = way[:, :, joint] / way[-1, :, joint]
    took = [0.02 * ((share[:, i] > 1e-6) & (share[:, i] < 1.0 - 1e-6)).sum() for i in range(2)]
    np.testing.assert_allclose(took, time, atol=0.1)
    assert took[1] > 2.0 * took[0]
    speed = np.diff(share[:, 1]) / 0.02
    assert speed.max() * time[1] == pytest.approx(1.875, rel=0.02)  # of minimum jerk, at half way


def test_spasticity_catches_a_fast_stretch_alone() -> None:
    numbers = {"spasticity": jnp.full(4, 2.0), "catch_speed": jnp.full(4, 0.5)}
    velocity = np.zeros((4, 3), np.float32)
    velocity[:, muscles.FLEXORS] = -1.5, -0.4, 0.4, 1.5
    torque = muscles.spasticity(numbers, jnp.asarray(velocity))
    np.testing.assert_allclose(torque[:, muscles.FLEXORS], [2.0, 0.0, 0.0, 0.0])
    assert not torque[:, :2].any()


def test_stiffness_and_discomfort_pull_harder() -> None:
    def torque(scale: float, discomfort: float) -> float:
        zero = jnp.zeros((1, 3))
        command = muscles.Command(
            intended=zero + 0.1, position=zero, late=zero, velocity=zero, weight=zero,
            tone=jnp.ones(1), discomfort=jnp.full(1, discomfort), effort=zero, most=zero + 10.0,
        )  # fmt: skip
        numbers = {"stiffness": jnp.full(1, scale)}
        return float(muscles.spring(command, zero, numbers, np.full(3, 3.0, np.float32))[1][0, 0])

    assert torque(1.0, 0.0) == pytest.approx(0.1 * muscles.STILL[0], rel=1e-5)
    assert torque(2.0, 0.0) == pytest.approx(2.0 * torque(1.0, 0.0), rel=1e-5)
    assert torque(1.0, 1.0) == pytest.approx(2.0 * torque(1.0, 0.0), rel=1e-5)


def test_muscles_follow_in_50_to_80_ms() -> None:
    zero = jnp.zeros((2, 3))
    command = muscles.Command(
        intended=zero, position=zero, late=zero, velocity=zero, weight=zero + 5.0,
        tone=jnp.ones(2), discomfort=jnp.zeros(2), effort=zero, most=zero + 10.0,
    )  # fmt: skip
    numbers = {
        "stiffness": jnp.ones(2),
        "delay": jnp.full(2, 0.1),
        "settle": jnp.array([0.15, 0.6]),
    }
    activation, torques = jnp.zeros((2, 3, 2)), []
    for _ in range(40):
        activation, torque = muscles.muscle(command, activation, numbers, np.full(3, 3.0))
        torques.append(torque[:, 0])
    risen = np.array(torques) / np.array(torques[-1])
    np.testing.assert_allclose(torques[-1], 5.0, rtol=1e-3)
    after = 0.02 * (1 + (risen < 1.0 - np.exp(-1.0)).sum(axis=0))
    np.testing.assert_allclose(after, [0.05, 0.08], atol=0.011)


def test_laws_of_reaction_differ_in_form() -> None:
    one = jnp.ones(1)
    numbers = {"settle": 0.3 * one, "withdraw": 0.15 * one, "lean": 0.05 * one, "limit": one}
    away = jnp.array([[1.0, 0.0, 0.0]])
    shifts = {}
    for name, law in (("first", reaction.proportional), ("second", reaction.guarded)):
        for force in (13.0, 20.0):
            now = reaction.calm(1)
            felt = reaction.Felt(force * one, 10.0 * one, 4.0 * one, 4.0 * one, one, one, away)
            for _ in range(150):
                now = law(now, felt, numbers)
            shifts[name, force] = float(now.shift[0, 0])
    assert shifts["first", 20.0] > 2.0 * shifts["first", 13.0] > 0.0
    assert shifts["second", 20.0] == pytest.approx(shifts["second", 13.0], rel=0.05)


@pytest.mark.parametrize("law", [reaction.proportional, reaction.guarded])
def test_speed_beyond_the_preference_causes_a_reaction(law) -> None:
    one, away = jnp.ones(4), jnp.tile(jnp.array([[1.0, 0.0, 0.0]]), (4, 1))
    numbers = {"settle": 0.3 * one, "withdraw": 0.15 * one, "lean": 0.05 * one, "limit": one}
    speed = jnp.array([4.0, 1.0, 0.2, 4.0])  # of the liked one; nothing touches the last
    force = jnp.array([3.0, 3.0, 3.0, 0.0])
    felt = reaction.Felt(force, 10.0 * one, 4.0 * one, 4.0 * one, speed, one, away)
    now = reaction.calm(4)
    for _ in range(100):
        now = law(now, felt, numbers)
    back = np.asarray(now.shift[:, 0])
    assert back[0] > 0.1 and back[1] == 0.0 and back[2] < -0.03 and back[3] == 0.0


@pytest.mark.parametrize("shape", [(5,), (2, 3)])
def test_person_player_has_the_form_of_a_policy(shape: tuple[int, ...]) -> None:
    task = "gentle_scratch"
    n = int(np.prod(shape))
    obs = jnp.asarray(np.tile(at_rest(task), (*shape, 1)))
    carry = player(task).initial_carry(shape)
    assert all(leaf.shape[: len(shape)] == shape for leaf in jax.tree.leaves(carry))
    rows = jnp.asarray(marked(persons(task)[:n])).reshape(*shape, -1)
    act, first = acting(task), jnp.ones(shape, bool)
    _, action = act({"row": rows}, carry, obs, first)
    assert action.shape == (*shape, 3)
    _, alone = act({"row": rows.reshape(n, -1)[0]}, carry, obs, first)
    np.testing.assert_array_equal(alone.reshape(-1, 3)[0], action.reshape(-1, 3)[0])
    assert np.abs(alone.reshape(-1, 3)[1] - action.reshape(-1, 3)[1]).max() > 0.0
    _, among_more = watched(persons(task)[:BATCH], np.zeros(1))
    # Of a batch of another size: another program, which may round the last bit otherwise.
    np.testing.assert_allclose(action.reshape(-1, 3), among_more[0, :n], atol=1e-6)


@pytest.mark.slow
def test_persons_help_more_than_idle_ones() -> None:
    rows = persons("gentle_scratch")[:24]
    figures = {human: earned(episodes("gentle_scratch", rows, "script", human)) for human in HUMANS}
    assert figures["person"]["return"] > 50.0 > 5.0 * figures["idle"]["return"]
    assert figures["person"]["success"] > figures["idle"]["success"]


@pytest.mark.parametrize("task", PREFERRED)
def test_the_environment_judges_by_each_persons_own_numbers(task: str) -> None:
    """What a person likes and bears is the same to its body and to the reward."""
    rows = persons(task)[:16]
    preference, place = person_params(task, rows).preference, index(task)
    own = {"tolerance": "tolerance"} | {f"liked_{name}": name for name in PREFERRED[task]}
    for number, field in own.items():  # of its row, and of the preference
        np.testing.assert_array_equal(getattr(preference, field), rows[:, place[number]], number)


@pytest.mark.slow
def test_picture_has_a_line_for_each_family_with_wishes_below(tmp_path: Path):
    path = tmp_path / "persons.png"
    film("gentle_scratch", 1, str(path), 0.2)
    picture = np.asarray(Image.open(path).convert("L"))
    assert picture.shape == (3 * 188, 240)
    labels = [picture[188 * i + 168 : 188 * (i + 1)] for i in range(3)]
    assert all((label < 128).any() and label[:, -4:].min() > 200 for label in labels)
    assert not any(np.array_equal(labels[i], labels[i - 1]) for i in range(3))
