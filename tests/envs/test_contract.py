"""What every task promises on every backend."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax_envs
from assistax_envs import TASKS, select
from assistax_envs.registered import OURS, REGISTERED
from assistax_envs.versions import CARE_TASKS, GENTLE_TASKS
from tests.envs.conftest import (
    BACKENDS,
    QUICK_TASKS,
    backends,
    constant_actions,
    environment,
    play,
    random_actions,
    seat,
    start,
)

SETTINGS = ["d1", "d9", "d3", "d7"]  # four simulations: one compile a backend for the whole folder
WIDTHS = {
    "scratch": {"robot": 34, "human": 38, "global": 52},
    "bed_bath": {"robot": 34, "human": 38, "global": 52},
    "arm_assist": {"robot": 47, "human": 51, "global": 65},
    "gentle_scratch": {"robot": 54, "human": 57, "global": 79},
    "gentle_bath": {"robot": 72, "human": 74, "global": 96},
    "gentle_feeding": {"robot": 56, "human": 54, "global": 76},
    "gentle_brushing": {"robot": 77, "human": 76, "global": 98},
    "gentle_lift": {"robot": 48, "human": 51, "global": 73},
}
# Over 20 control steps of random torques, float32 against float64: rad, and reward. The largest
# differences are of an elbow that strikes its stop; the mean tells apart what the largest lets
# pass.
LARGEST_DIFFERENCE, MEAN_DIFFERENCE = 3e-2, 1e-3

WITHOUT_MJX = ("fused", "native")


def each_pair(among: tuple[str, ...] = BACKENDS) -> pytest.MarkDecorator:
    """Test tasks on the backends that play them: in every run all on `fused`, two on `native`."""
    pairs = [(task, backend) for task in TASKS for backend in backends(task, among)]
    quick = {(task, "fused") for task in TASKS} | {(task, "native") for task in QUICK_TASKS}
    return pytest.mark.parametrize(
        ("task", "backend"),
        [pytest.param(*pair, marks=() if pair in quick else pytest.mark.slow) for pair in pairs],
    )


each_task_and_backend = each_pair()


@pytest.mark.slow_for("gentle_brushing", "gentle_bath", "gentle_scratch")
@each_task_and_backend
def test_shapes_and_types(task: str, backend: str) -> None:
    env = environment(task, backend)
    state = start(task, backend, SETTINGS)
    after = play(task, backend, state, random_actions(4, 1, human=seat(task)))[0]
    widths = WIDTHS[task] if task in OURS else env.observation_size
    assert env.observation_size == widths
    assert env.action_size == {"robot": 7, "human": seat(task)}
    for moment in (state, after):
        assert {name: obs.shape for name, obs in moment.obs.items()} == {
            n: (4, w) for n, w in widths.items()
        }
        assert moment.reward.shape == (4,)
        assert set(moment.terms) == set(env.term_names)
        assert {leaf.shape[0] for leaf in jax.tree.leaves(moment)} == {4}
    assert jax.tree.structure(state) == jax.tree.structure(after)
    assert [leaf.dtype for leaf in jax.tree.leaves(state)] == [
        leaf.dtype for leaf in jax.tree.leaves(after)
    ]


@pytest.mark.slow_for("opposed", "random", "lift-native")
@each_task_and_backend
@pytest.mark.parametrize("actions", ["random", "full", "opposed"])
def test_episode_stays_finite_and_ends_by_time(task: str, backend: str, actions: str) -> None:
    env = environment(task, backend)
    rows = {
        "random": random_actions(4, 1000, seed=1, human=seat(task)),
        "full": constant_actions(4, 1000, 1.0, 1.0, seat(task)),
        "opposed": constant_actions(4, 1000, -1.0, 1.0, seat(task)),
    }[actions]
    states = play(task, backend, start(task, backend, SETTINGS), rows)
    for state in states[::50] + states[-1:]:
        assert all(bool(jnp.all(jnp.isfinite(obs))) for obs in state.obs.values())
        np.testing.assert_allclose(sum(state.terms.values()), state.reward, atol=1e-6)
    assert not bool(jnp.any(states[-1].nonfinite))
    for state in states[::50]:  # no end before its time but a protective stop's
        stopped = state.measures.violated if env.stops else jnp.zeros(4, bool)
        np.testing.assert_array_equal(state.terminated, stopped)
    assert [bool(jnp.all(state.truncated)) for state in (states[-2], states[-1])] == [False, True]
    assert int(states[-1].step[0]) == env.episode_length


@each_task_and_backend
def test_resets_are_equal_on_every_backend(task: str, backend: str) -> None:
    native, other = (start(task, name, SETTINGS, seed=7) for name in ("native", backend))
    for name in ("qpos", "qvel", "warmstart"):
        np.testing.assert_array_equal(getattr(native.physics, name), getattr(other.physics, name))
    jax.tree.map(np.testing.assert_array_equal, native.task, other.task)
    np.testing.assert_allclose(native.obs["global"], other.obs["global"], atol=1e-5)


@each_task_and_backend
def test_backends_agree_over_the_first_steps(task: str, backend: str) -> None:
    actions = random_actions(4, 20, seed=2, human=seat(task))
    native, other = (
        play(task, name, start(task, name, SETTINGS, seed=3), actions)
        for name in ("native", backend)
    )
    elsewhere = play(task, "native", start(task, "native", SETTINGS, seed=4), actions)
    paid = not REGISTERED[task].felt  # whose rewards, for a point or a stroke, come in lumps
    assert _agree(native, other, paid)
    assert not _agree(native, elsewhere, paid)  # the bounds tell another start apart


@each_pair(WITHOUT_MJX)
def test_diverged_simulation_is_frozen_alone(task: str, backend: str) -> None:
    state = start(task, backend, SETTINGS)
    actions = random_actions(4, 5, human=seat(task))
    calm = play(task, backend, state, actions)[-1]
    qvel = state.physics.qvel.at[1].set(jnp.nan)
    sick = dataclasses.replace(state, physics=dataclasses.replace(state.physics, qvel=qvel))
    last = play(task, backend, sick, actions)[-1]
    assert last.nonfinite.tolist() == [False, True, False, False]
    assert float(last.reward[1]) == 0.0
    np.testing.assert_array_equal(last.obs["global"][1], state.obs["global"][1])
    np.testing.assert_array_equal(last.obs["global"][0], calm.obs["global"][0])
    assert not bool(jnp.any(calm.nonfinite))


@pytest.mark.parametrize("backend", WITHOUT_MJX)
def test_nan_action_is_counted(backend: str) -> None:
    action = {"robot": jnp.zeros((4, 7)).at[2, 0].set(jnp.nan), "human": jnp.zeros((4, 3))}
    last = play("scratch", backend, start("scratch", backend, SETTINGS), [action])[-1]
    assert last.nonfinite.tolist() == [False, False, True, False]


def test_the_joint_range_of_each_simulation_holds() -> None:
    """The elbow, pushed against its stop, keeps to its own range on both engines alike."""
    joint = environment("scratch", "fused").model.joint("human_right_elbow")
    actions = constant_actions(4, 60, 0.0, 1.0)
    angles = {
        backend: play("scratch", backend, start("scratch", backend, SETTINGS, seed=8), actions)[
            -1
        ].physics.qpos[:, joint.qposadr[0]]
        for backend in WITHOUT_MJX
    }
    np.testing.assert_allclose(angles["fused"], angles["native"], atol=2e-2)
    assert len({round(float(angle), 1) for angle in angles["fused"]}) > 1


def test_fused_engine_ignores_the_warm_start() -> None:
    state = start("scratch", "fused", SETTINGS)
    warmstart = state.physics.warmstart + jnp.array([100.0, jnp.nan, 3.0, -1.0])[:, None]
    other = dataclasses.replace(
        state, physics=dataclasses.replace(state.physics, warmstart=warmstart)
    )
    actions = random_actions(4, 30, seed=3)
    ours, theirs = (play("scratch", "fused", begun, actions)[-1] for begun in (state, other))
    np.testing.assert_array_equal(ours.physics.qpos, theirs.physics.qpos)
    np.testing.assert_array_equal(ours.obs["global"], theirs.obs["global"])


def test_engine_and_version_are_named() -> None:
    assert environment("scratch", "native").engine["name"] == "native"
    engine = environment("scratch", "fused").engine
    assert engine["name"] == "fused"
    assert engine["version"].isdigit()


def test_select_takes_whole_simulations() -> None:
    fresh, old = (
        start("scratch", "native", SETTINGS, seed=5),
        start("scratch", "native", SETTINGS, seed=6),
    )
    mixed = select(jnp.array([True, False, False, True]), fresh, old)
    for i, source in enumerate((fresh, old, old, fresh)):
        jax.tree.map(
            lambda a, b, i=i: np.testing.assert_array_equal(a[i], b[i]), _raw(mixed), _raw(source)
        )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: assistax_envs.make("scrath"),
            "task is 'scrath'; allowed are scratch, bed_bath, arm_assist",
        ),
        (
            lambda: assistax_envs.make("scratch", "cuda"),
            "backend is 'cuda'; allowed are auto, fused, native, mjx, mjx-warp",
        ),
        (
            lambda: assistax_envs.make("scratch", "native", {"wipe": 2.0}),
            r"unknown terms \['wipe'\]; scratch has",
        ),
        (
            lambda: assistax_envs.make("arm_assist", "native", rotation="up"),
            "rotation is 'up'; allowed are printed, al",
        ),
        (
            lambda: assistax_envs.disability_params(["d10"]),
            "disability setting is 'd10'; allowed are d1, d2",
        ),
        (lambda: assistax_envs.make("scratch", "mjx-warp"), "backend 'mjx-warp' needs"),
        *(
            (
                lambda task=task, backend=backend: assistax_envs.make(task, backend),
                f"{task} needs to know which way a contact pushes, and backend '{backend}' does "
                "not say; use fused or native",
            )
            for task in (*GENTLE_TASKS, *CARE_TASKS)
            for backend in ("mjx", "mjx-warp")
        ),
        (
            lambda: assistax_envs.disability_params(["d1"], ["p10"]),
            "preference is 'p10'; allowed are drawn, p1, p2",
        ),
    ],
)
def test_bad_arguments_are_named(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def _agree(
    a: list[assistax_envs.EnvState], b: list[assistax_envs.EnvState], paid: bool = True
) -> bool:
    rows, others = (
        [
            np.concatenate([step.physics.qpos, step.reward[:, None] * paid], axis=-1)
            for step in steps
        ]
        for steps in (a, b)
    )
    difference = np.abs(np.stack(rows) - np.stack(others))
    return bool(difference.max() < LARGEST_DIFFERENCE and difference.mean() < MEAN_DIFFERENCE)


def _raw(state: assistax_envs.EnvState) -> assistax_envs.EnvState:
    return dataclasses.replace(state, key=jax.random.key_data(state.key))
