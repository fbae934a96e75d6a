"""What the gentle tasks share: their scenes, what is felt of a touch, preferences, costs, scripts.

Nothing here depends on what a task pays for.
"""

import dataclasses
import inspect
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import assistax_envs
from assistax_envs import disability_params
from assistax_envs.models import build_model
from assistax_envs.models.gentle_scenes import (
    LINKS,
    ROBOT_SHARE,
    SKIN,
    TRUNK,
    touching,
)
from assistax_envs.physics import PhysicsState
from assistax_envs.preferences import (
    FORCES,
    PREFERENCES,
    PREFERRED,
    SPEEDS,
    WORDS,
    Preference,
)
from assistax_envs.registered import REGISTERED
from assistax_envs.tasks.base import HUMAN_JOINTS, Readings
from assistax_envs.tasks.care import IMPACT, NONE
from assistax_envs.tasks.chain import SCRIPTS, Chain, script_of
from assistax_envs.tasks.gentle_base import (
    TouchReadings,
    along_skin,
    draw_preferences,
    in_segment,
    roughness,
    world_force,
)
from assistax_envs.versions import GENTLE_TASKS, PAPER_TASKS, TASKS
from tests.envs.base_scenes import BASES
from tests.envs.conftest import (
    compiled,
    constant_actions,
    environment,
    one_gentle_task,
    play,
    random_actions,
    seat,
    start,
)
from tests.envs.fused.scenes import converged, touching_states

N = 64


# Scenes.


@one_gentle_task
def test_scene_softens_that_of_the_paper(
    task: str,
) -> None:
    ours, theirs = build_model(task), build_model(BASES[task])
    for name in ("body_mass", "body_pos", "jnt_range", "geom_size", "qpos_spring"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    for i in range(ours.nu):
        name = ours.actuator(i).name
        share = ROBOT_SHARE if name.startswith("robot_") else REGISTERED[task].scene.human_share
        full = build_model("scratch").actuator(name).gear[0]
        assert ours.actuator(i).gear[0] == pytest.approx(share * full)
    for name in HUMAN_JOINTS:
        factor = TRUNK if "abdomen" in name else 1.0
        for field in ("jnt_stiffness", "dof_damping"):
            now, before = (getattr(m, field)[m.joint(name).id] for m in (ours, theirs))
            assert now == pytest.approx(factor * before)


@one_gentle_task
def test_pairs_of_robot_and_human_alone_are_felt(task: str) -> None:
    model = build_model(task)
    named = [
        (model.geom(int(a)).name, model.geom(int(b)).name)
        for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)
    ]
    felt = {
        frozenset((model.geom(int(a)).name, model.geom(int(b)).name))
        for a, b, kind in zip(
            model.sensor_objid, model.sensor_refid, model.sensor_type, strict=True
        )
        if kind == mujoco.mjtSensor.mjSENS_CONTACT
    }
    touches = {frozenset(pair) for pair in named if touching(*pair)}
    assert touches == felt
    for body, place, parts in LINKS.values():
        link = [
            geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == model.body(body).id
        ]
        assert {frozenset((model.geom(link[place]).name, part)) for part in parts} <= touches
    for pair, solref in zip(named, model.pair_solref, strict=True):
        assert (solref[0] == SKIN) == (frozenset(pair) in touches)


def test_furniture_and_own_parts_are_no_touch() -> None:
    assert touching("robot_tool", "human_torso") == ("robot_tool", "human_torso")
    assert touching("right_thigh", "robot_tool") == ("robot_tool", "right_thigh")
    assert touching("robot_tool", "right_rail_inner") is None
    assert touching("human_torso", "human_right_lower_arm") is None


# Sensors.


def felt(task: str, backend: str = "native") -> tuple[Any, np.ndarray]:
    """Return readings of touching states, and MuJoCo's own world forces on the human: [N, P, 3]."""
    states, model = touching_states(task), environment(task, "native").model
    still = jnp.zeros_like(states.qvel)
    physics = PhysicsState(jnp.asarray(states.qpos), jnp.asarray(states.qvel), still)
    ranges = jnp.broadcast_to(
        jnp.asarray(model.jnt_range, jnp.float32), (len(states), model.njnt, 2)
    )
    env = environment(task, backend)
    # Forces of a state that is set, not reached: an environment only plays.
    readings = env._task.sensors.read(env._physics.forward(physics, ranges))
    if backend == "fused":  # which iterates until nothing changes
        model = converged(model)
    data, expected, force = (
        mujoco.MjData(model),
        np.zeros((len(states), model.npair, 3)),
        np.zeros(6),
    )
    pairs = [{int(a), int(b)} for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)]
    for i, (qpos, qvel) in enumerate(zip(states.qpos, states.qvel, strict=True)):
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(model, data)
        for k, contact in enumerate(data.contact):
            names = [model.geom(int(geom)).name for geom in contact.geom]
            touch = touching(*names)
            if touch is None:
                continue
            mujoco.mj_contactForce(model, data, k, force)
            world = contact.frame.reshape(3, 3).T @ force[:3]
            sign = 1.0 if names[1] == touch[1] else -1.0  # from the first to the second
            row = expected[i, pairs.index(set(map(int, contact.geom)))]
            if np.linalg.norm(world) > np.linalg.norm(row):
                row[:] = sign * world
    return readings, expected


@pytest.mark.slow_for("native")
@pytest.mark.parametrize("backend", ["native", "fused"])
@one_gentle_task
def test_force_sums_contacts_in_the_world_frame(task: str, backend: str) -> None:
    readings, expected = felt(task, backend)
    size = np.linalg.norm(expected, axis=-1)
    assert (size.sum(axis=1) > 1.0).sum() > 30
    scale = 1.0 + size.sum(axis=1)
    for read, want in (
        (readings.force, size.sum(axis=1)),
        (readings.peak, size.max(axis=1)),
        (np.linalg.norm(readings.tool_force - expected.sum(axis=1), axis=1), 0.0),
    ):
        assert np.median(np.abs(np.asarray(read) - want) / scale) < 1e-3
        assert (np.abs(np.asarray(read) - want) / scale < 0.05).mean() > 0.97
    mirrored = np.linalg.norm(readings.tool_force + expected.sum(axis=1), axis=1) / scale
    assert np.median(mirrored[size.sum(axis=1) > 1.0]) > 0.1  # the sign is seen


@one_gentle_task
def test_touches_on_the_arm_are_told_apart(task: str) -> None:
    readings, expected = felt(task)
    model = build_model(task)
    names = [
        {model.geom(int(g)).name for g in pair}
        for pair in zip(model.pair_geom1, model.pair_geom2, strict=True)
    ]
    arm = [
        {"robot_tool", f"human_{part}"}
        for part in ("right_upper_arm", "right_lower_arm", "right_hand")
    ]
    on_arm = np.linalg.norm(expected, axis=-1)[:, [pair in arm for pair in names]].sum(axis=1)
    scale = 1.0 + np.linalg.norm(expected, axis=-1).sum(axis=1)
    assert (np.abs(np.asarray(readings.on_arm) - on_arm) / scale < 0.05).mean() > 0.97
    assert (on_arm > 0.5).any() and (np.asarray(readings.force) - on_arm > 0.5).any()


@one_gentle_task
def test_quaternions_have_w_of_at_least_zero(task: str) -> None:
    readings, _ = felt(task)
    assert float(readings.tool_orientation[:, 0].min()) >= 0.0
    assert float(readings.arm_orientation[..., 0].min()) >= 0.0
    states = play(task, "native", start(task, "native", ["d1"] * 4), random_actions(4, 5))
    assert all(float(state.obs["robot"][:, 17].min()) >= 0.0 for state in states)


def test_forces_turn_into_the_world_frame() -> None:
    normal, tangent = jnp.array([0.0, 0.0, 1.0]), jnp.array([1.0, 0.0, 0.0])
    world = world_force(jnp.array([3.0, 2.0, 1.0]), normal, tangent)
    np.testing.assert_allclose(world, [2.0, 1.0, 3.0])  # y is z cross x


# Arithmetic of touch.


def test_way_over_the_skin_leaves_out_crossing() -> None:
    at = jnp.array([0.04, 0.0, 0.1])
    steps = jnp.array([[0.0, 0.0, 0.03], [0.02, 0.0, 0.0], [0.5, 0.03, 0.04]])
    np.testing.assert_allclose(
        along_skin(steps, jnp.tile(at, (3, 1))), [0.03, 0.0, 0.05], atol=1e-6
    )


def _readings(n: int = 1, **fields) -> TouchReadings:
    shapes = {name: (n,) for name in ("force", "peak", "on_arm", "bent")} | {
        "tool_velocity": (n, 3)
    }
    names = [field for field in TouchReadings.__dataclass_fields__]
    zeros = {name: jnp.zeros(shapes.get(name, (n,))) for name in names}
    return TouchReadings(
        **(zeros | {name: jnp.asarray(v, jnp.result_type(float)) for name, v in fields.items()})
    )


def _roughness(violated: bool = False, **fields) -> dict[str, float]:
    terms = roughness(_readings(**fields), jnp.array([violated]))
    return {term: float(value[0]) for term, value in terms.items()}


def test_each_cost_has_its_reason_and_bound() -> None:
    calm = _roughness()
    assert not any(calm.values())
    reasons = {
        "force": {"force": [30.0], "on_arm": [30.0]},
        "stray": {"force": [9.0]},
        "haste": {"tool_velocity": [[0.0, 0.6, 0.0]]},
        "trunk": {"bent": [0.1]},
        "violation": {"violated": True},
    }
    assert set(reasons) == set(calm)
    for name, fields in reasons.items():
        paid = _roughness(**fields)
        assert -1.0 <= paid.pop(name) < 0.0
        assert not any(paid.values())
    worst = _roughness(True, force=[1e6], bent=[9.0], tool_velocity=[[99.0, 0.0, 0.0]])
    assert set(worst.values()) == {-1.0}


def test_points_are_given_in_the_segments_frame() -> None:
    half = np.sqrt(0.5)
    shape = {f: jnp.zeros((1, 1)) for f in Readings.__dataclass_fields__}
    shape["arm_position"] = jnp.array([[[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]])
    shape["arm_orientation"] = jnp.array([[[1.0, 0.0, 0.0, 0.0], [half, 0.0, 0.0, half]]])
    point = in_segment(Readings(**shape), jnp.array([1]), jnp.array([[1.0, 3.0, 3.0]]))
    np.testing.assert_allclose(point, [[1.0, 0.0, 0.0]], atol=1e-6)  # turned by 90 degrees about z


@one_gentle_task
def test_hard_contact_stays_a_violation(task: str) -> None:
    env = environment(task, "native")
    states, model = touching_states(task), env.model
    rows = jnp.arange(8)
    begun = start(task, "native", ["d1"] * 8)
    still = jnp.zeros((8, model.nv), jnp.float32)
    physics = PhysicsState(jnp.asarray(states.qpos)[rows], still, still)
    sensors: Any = env._task.sensors
    # Readings that the test alters before the task judges them: an environment returns neither.
    readings = sensors.read(env._physics.forward(physics, env._joint_range(begun.params)))
    hard = dataclasses.replace(readings, struck=rows % 2 == 0, hurt=jnp.zeros(8, bool))
    state, _, terms, measures = env._task.transition(begun.task, hard)
    assert np.asarray(measures.violated).tolist() == [True, False] * 4
    assert np.asarray(measures.violation).tolist() == [IMPACT, NONE] * 4
    assert (np.asarray(terms["violation"]) < 0.0).tolist() == [True, False] * 4
    np.testing.assert_array_equal(measures.contact, hard.peak)
    calm = dataclasses.replace(hard, struck=jnp.zeros(8, bool))
    _, _, _, measures = env._task.transition(state, calm)
    assert np.asarray(measures.violated).tolist() == [True, False] * 4
    assert not (np.asarray(measures.success) & np.asarray(measures.violated)).any()


# Preferences.


def test_preferences_cover_all_forces_and_speeds() -> None:
    assert list(PREFERENCES) == [f"p{k}" for k in range(1, 10)]
    assert {(preference.force, preference.speed) for preference in PREFERENCES.values()} == {
        (force, speed) for force in FORCES for speed in SPEEDS
    }
    # Any two values that matter in one task meet once.
    for first, other in itertools.chain.from_iterable(
        itertools.combinations(wishes, 2) for wishes in PREFERRED.values()
    ):
        pairs = {
            (getattr(preference, first), getattr(preference, other))
            for preference in PREFERENCES.values()
        }
        assert len(pairs) == len(PREFERENCES)
    with pytest.raises(ValueError, match="preferred speed is 0"):
        Preference(4.0, 0.0, 0.1, 0.2)


@one_gentle_task
def test_given_preference_is_kept_and_open_one_drawn(task: str) -> None:
    reset = compiled(task, "native")[0]
    keys = jax.random.split(jax.random.key(3), N)
    names = ["p1", "p9", "p5", "p6"] * (N // 4)
    for seed in range(2):
        state = reset(
            jax.random.split(jax.random.key(seed), N), disability_params(["d1"] * N, names)
        )
        likes = [PREFERENCES[name] for name in names]
        np.testing.assert_allclose(state.task.preference.force, [like.force for like in likes])
        np.testing.assert_allclose(state.task.preference.speed, [like.speed for like in likes])
        np.testing.assert_allclose(
            state.task.preference.distance, [like.distance for like in likes]
        )
    drawn = reset(keys, disability_params(["d1"] * N)).task.preference
    pairs = set(zip(drawn.force.tolist(), drawn.speed.tolist(), strict=True))
    assert len(pairs) == len(PREFERENCES)
    again = reset(
        jax.random.split(jax.random.key(4), N), disability_params(["d1"] * N)
    ).task.preference
    assert (np.asarray(again.force) != np.asarray(drawn.force)).any()


@one_gentle_task
def test_episode_draws_its_preference_once(task: str) -> None:
    first = start(task, "native", ["d1"] * 8)
    last = play(task, "native", first, random_actions(8, 5))[-1]
    jax.tree.map(np.testing.assert_array_equal, first.task.preference, last.task.preference)


@one_gentle_task
def test_human_alone_observes_its_preference(task: str) -> None:
    """The same start under two preferences: only the human and critics can tell them apart."""
    reset, keys = compiled(task, "native")[0], jax.random.split(jax.random.key(5), 2)
    apart = next(
        name
        for name, preference in PREFERENCES.items()
        if all(
            getattr(preference, wish) != getattr(PREFERENCES["p1"], wish)
            for wish in PREFERRED[task]
        )
    )
    first, other = (
        reset(keys, disability_params(["d1"] * 2, [name] * 2)).obs for name in ("p1", apart)
    )
    np.testing.assert_array_equal(first["robot"], other["robot"])
    count = len(PREFERRED[task])
    for who, words in (("human", 0), ("global", len(WORDS))):
        apart = np.flatnonzero((np.asarray(first[who]) != np.asarray(other[who])).any(axis=0))
        end = first[who].shape[1] - words
        assert apart.tolist() == list(range(end - count, end))
    middle = reset(keys, disability_params(["d1"] * 2, ["p5"] * 2)).obs["human"]
    np.testing.assert_allclose(middle[:, -count:], 0.0, atol=1e-6)


@one_gentle_task
def test_robot_observation_is_independent_of_preference(task: str) -> None:
    """The touches are the same: the robot reads a preference from the human's motion alone."""
    env = environment(task, "native")
    states, n = touching_states(task), 8
    readings = env._task.sensors.read(
        env._physics.forward(
            PhysicsState(
                jnp.asarray(states.qpos)[:n],
                jnp.asarray(states.qvel)[:n],
                jnp.asarray(states.qvel)[:n],
            ),
            env._joint_range(start(task, "native", ["d1"] * n).params),
        )
    )
    seen = []
    for name in ("p1", "p9"):
        state = env.reset(
            jax.random.split(jax.random.key(9), n), disability_params(["d1"] * n, [name] * n)
        ).task
        for _ in range(3):
            state, obs, _, _ = env._task.transition(state, readings)
        seen.append(obs)
    np.testing.assert_array_equal(seen[0]["robot"], seen[1]["robot"])
    assert (np.asarray(seen[0]["human"]) != np.asarray(seen[1]["human"])).any()


@pytest.mark.slow
@one_gentle_task
def test_told_robot_observes_the_preference(task: str) -> None:
    env = assistax_envs.make(task, "native", told=("human", "robot"))
    sizes = env.observation_size, environment(task, "native").observation_size
    more = sizes[0]["robot"] - sizes[1]["robot"]
    assert more >= len(PREFERRED[task])
    obs = env.reset(jax.random.split(jax.random.key(6), 4), disability_params(["d1"] * 4)).obs
    told = obs["robot"][:, : -len(WORDS)]  # words come last
    np.testing.assert_array_equal(told[:, -more:], obs["human"][:, -more:])


def test_paper_tasks_ignore_preferences() -> None:
    step, keys = compiled("scratch", "native"), jax.random.split(jax.random.key(7), 2)
    first, other = (
        step[0](keys, disability_params(["d1"] * 2, [name] * 2)) for name in ("p1", "p9")
    )
    actions = random_actions(2, 3)
    ends = [play("scratch", "native", begun, actions)[-1] for begun in (first, other)]
    np.testing.assert_array_equal(ends[0].obs["global"], ends[1].obs["global"])
    np.testing.assert_array_equal(ends[0].reward, ends[1].reward)


def test_key_draws_the_preference() -> None:
    names = {
        float(draw_preferences(jnp.int32(0), jax.random.key(seed)).force) for seed in range(20)
    }
    assert names == set(FORCES)
    assert float(draw_preferences(jnp.int32(9), jax.random.key(0)).force) == FORCES[-1]


# Scripts.


@pytest.mark.slow_for("gentle_bath", "gentle_scratch", "bed_bath", "arm_assist")
@pytest.mark.parametrize("task", [*PAPER_TASKS, *GENTLE_TASKS])
def test_script_brings_the_tool_to_its_target(task: str) -> None:
    """In three seconds, with an idle human: far nearer than a robot that does nothing."""
    env = environment(task, "native")
    act = jax.jit(script_of(task, env.model))
    begun = state = start(task, "native", ["d1"] * 8, seed=2)
    step = compiled(task, "native")[1]
    nearest = gap = np.asarray(_gap(state))
    for _ in range(150):
        state = step(state, {"robot": act(state.obs["robot"]), "human": jnp.zeros((8, seat(task)))})
        nearest = np.minimum(nearest, np.asarray(_gap(state)))
    assert not bool(state.nonfinite.any())
    assert np.median(nearest) < 0.6 * np.median(gap)
    idle = play(task, "native", begun, constant_actions(8, 150, 0.0, 0.0, seat(task)))
    assert np.median(nearest) < 0.6 * np.median([np.asarray(_gap(state)) for state in idle])


def _gap(state) -> jax.Array:
    """Return how far the tool is from where its task wants it: the first goal that is observed."""
    return jnp.linalg.norm(state.obs["robot"][:, 30:33], axis=-1)


def test_jacobian_matches_mujoco() -> None:
    model = build_model("gentle_scratch")
    chain, data = Chain(model), mujoco.MjData(model)
    rng = np.random.default_rng(8)
    joints = [model.joint(f"robot_joint{i}") for i in range(1, 8)]
    for _ in range(5):
        angles = np.array([rng.uniform(*joint.range) for joint in joints])
        data.qpos[[joint.qposadr[0] for joint in joints]] = angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        site = model.site("robot_end_effector").id
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, linear, angular, site)
        columns = [joint.dofadr[0] for joint in joints]
        jacobian = chain.jacobian(
            jnp.asarray(angles, jnp.float32)[None],
            jnp.asarray(data.site_xpos[site], jnp.float32)[None],
        )
        for ours, theirs in zip(jacobian, (linear, angular), strict=True):
            np.testing.assert_allclose(ours[0], theirs[:, columns], atol=1e-5)


def test_every_task_has_a_documented_script() -> None:
    assert set(SCRIPTS) == set(TASKS)
    assert all(inspect.getdoc(script.play) for script in SCRIPTS.values())
