"""Measure persons without a trained robot: returns of scripts, and preferences that can be read.

python -m assistax_envs.persons.measure play TASK
python -m assistax_envs.persons.measure read TASK
python -m assistax_envs.persons.measure film TASK nine.png
"""

import argparse
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import assistax_envs
from assistax_envs.own_settings import key_of, own_settings
from assistax_envs.persons.parameters import index
from assistax_envs.persons.player import PersonPlayer, person_params
from assistax_envs.persons.rows import INNER, persons
from assistax_envs.preferences import PREFERRED
from assistax_envs.registered import REGISTERED
from assistax_envs.tasks.chain import SCRIPTS, script_of
from assistax_envs.tasks.gentle_base import FELT

SCRIPTED = 4.0  # N that the scripts keep to
SWEEP = 4.0  # s, in which a probing script goes from a light to a hard touch and back
WINDOWS = (2.0, 5.0)  # s from the first touch
STEPS_A_SECOND = 50
TOOL, ARMS = slice(14, 17), slice(24, 30)  # of the robot's observation: places, m
TOUCHES = (FELT, 1.5, 3.0, 5.0, 8.0, 12.0, 20.0)  # N, bounds between strengths of a touch
LEAST_READ = 9  # persons
ANSWER = 20  # steps in which an arm answers


# A robot with a memory: from N to its memory before the first observation, and from memory,
# observations [N, O] and the step to its memory and actions [N, 7].
Robot = tuple[Callable[[int], Any], Callable[[Any, jax.Array, jax.Array], tuple[Any, jax.Array]]]


@functools.cache
def _program(
    task: str, robot: str | Robot, human: str, family: str, steps: int
) -> tuple[Any, Any, Any]:
    """Return the environment, and programs that start episodes and play `steps` of them."""
    env, player = assistax_envs.make(task), PersonPlayer(task, family)
    script, column = script_of(task, env.model), SCRIPTS[task].force

    def command(memory: Any, obs: jax.Array, time: jax.Array) -> tuple[Any, jax.Array]:
        if not isinstance(robot, str):
            return robot[1](memory, obs, time)
        if robot == "idle":
            return memory, jnp.zeros((obs.shape[0], env.action_size["robot"]))
        # A probing script believes that the force is SCRIPTED when it is something else.
        if robot == "probe" and column is not None:
            phase = jnp.abs((time / (STEPS_A_SECOND * SWEEP)) % 1.0 - 0.5) * 2.0
            obs = obs.at[:, column].multiply(SCRIPTED / (1.0 + 14.0 * phase))
        return memory, script(obs)

    def step(row: jax.Array, loop: tuple[Any, ...], time: jax.Array) -> tuple[Any, Any]:
        state, carry, memory = loop
        obs = state.obs
        carry, action = player.act({"row": row}, carry, obs["human"], time == 0)
        action = jnp.zeros_like(action) if human == "idle" else action
        memory, driven = command(memory, obs["robot"], time)
        stopped = state.terminated  # what comes after counts for nothing
        word = player.word(carry) * (human != "idle")
        state = env.step(state, {"robot": driven, "human": action, "word": word})
        seen = {
            "reward": jnp.where(stopped, 0.0, state.reward),
            "force": state.measures.force,
            "success": state.measures.success & ~stopped,
            "violated": state.measures.violated,
            "discomfort": state.measures.discomfort,
            "done": state.measures.done,
            "judged": state.measures.judged,
            "word": word,
            # At the mouth a person shows its preference before the first touch.
            "met": (state.measures.force > FELT) | (REGISTERED[task].seat == "mouth"),
            "obs": obs["robot"],
        }
        return (state, carry, memory), seen

    @jax.jit
    def begin(row: jax.Array, params: Any, keys: jax.Array) -> tuple[Any, ...]:
        n = row.shape[0]
        memory = () if isinstance(robot, str) else robot[0](n)
        return env.reset(keys, params), player.initial_carry((n,)), memory

    @jax.jit
    def play(row: jax.Array, loop: tuple[Any, ...], time: jax.Array) -> tuple[Any, Any]:
        return jax.lax.scan(functools.partial(step, row), loop, time + jnp.arange(steps))

    return env, begin, play


@own_settings()
def episodes(
    task: str,
    rows: np.ndarray,
    robot: str | Robot = "script",
    human: str = "person",
    family: str = "spring",
    steps: int = 1000,
    seed: int = 0,
) -> dict[str, np.ndarray]:
    """Play an episode of a robot with each person.

    Args:
        task: one of the gentle tasks.
        rows: [N, 25] of the persons.
        robot: "script"; "idle"; "probe", the script with a force from 1 to 15 N and back in 4 s, if
            it keeps to a force; or a robot of your own.
        human: "person", or "idle": a human of the person's body and preference that does nothing.
        family: of the persons.
        steps: to play.
        seed: of the episodes' starts.

    Returns:
        Arrays [T, N] "reward", "force", "success", "violated", "discomfort", "met" (whether a
        person can be read: it was touched, or is at the mouth) and [T, N, O] "obs".
    """
    _, begin, play = _program(task, robot, human, family, steps)
    keys = jax.random.split(key_of(seed), len(rows))
    loop = begin(jnp.asarray(rows), person_params(task, rows), keys)
    _, seen = play(jnp.asarray(rows), loop, jnp.zeros((), jnp.int32))
    return jax.tree.map(np.asarray, seen)


def earned(seen: dict[str, np.ndarray]) -> dict[str, float]:
    """Return mean figures over persons of the episodes of `episodes`, by name."""
    success, violated = seen["success"].any(axis=0), seen["violated"].any(axis=0)
    touching = seen["force"][seen["force"] > FELT]
    return {
        "return": float(seen["reward"].sum(axis=0).mean()),
        "success": float(success.mean()),
        "safe success": float((success & ~violated).mean()),
        "violations": float(violated.mean()),
        "force, median": float(np.median(touching)) if touching.size else 0.0,
        "force, 99%": float(np.percentile(touching, 99)) if touching.size else 0.0,
        "in discomfort": float((seen["discomfort"] > 0.2).mean()),
    }


def read(seen: dict[str, np.ndarray], preference: np.ndarray, window: float) -> tuple[float, int]:
    """Return the share of unseen persons whose third of a preference a linear reader finds.

    The reader has means, spreads and changes of the robot's observations from the first touch on,
    at the mouth from the start on, and the arm's answers to light and to hard touches.

    Args:
        seen: of `episodes`.
        preference: [N] of the persons.
        window: s.

    Returns:
        The share, and the number of persons that it is of; a third is chance. 0 of 0 if fewer than
        `LEAST_READ` persons were touched for so long.
    """
    obs, force, touched = seen["obs"], seen["force"], seen["met"]
    begin, length = touched.argmax(axis=0), int(window * STEPS_A_SECOND)
    enough = touched.any(axis=0) & (begin + length <= len(obs))
    if enough.sum() < LEAST_READ:
        return 0.0, 0
    features = []
    for person in np.flatnonzero(enough):
        when = slice(begin[person], begin[person] + length)
        part = obs[when, person]
        halves = [half.mean(axis=0) for half in np.array_split(part, 2)]
        change = np.abs(np.diff(part, axis=0)).mean(axis=0)
        answers = _answers(part, force[when, person])
        features.append(np.concatenate([*halves, part.std(axis=0), change, answers]))
    x = np.array(features, np.float64)
    thirds = np.searchsorted(np.quantile(preference, [1 / 3, 2 / 3]), preference[enough])
    train = np.arange(len(x)) % 3 > 0
    spread = x[train].std(axis=0)
    x = (x - x[train].mean(axis=0)) / np.where(spread > 1e-9, spread, np.inf)
    x = np.clip(np.column_stack([x, np.ones(len(x))]), -5.0, 5.0)
    target = np.eye(3)[thirds]
    square = x[train].T @ x[train] + 30.0 * np.eye(x.shape[1])
    weights = np.linalg.solve(square, x[train].T @ target[train])
    hit = (x[~train] @ weights).argmax(axis=1) == thirds[~train]
    return float(hit.mean()), len(hit)


def preference_parameters(task: str) -> list[str]:
    """Return the names of a task's parameters that are preferences, and tolerance."""
    return [name for name in index(task) if name.startswith("liked")] + ["tolerance"]


def _answers(part: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return the arm's motion after touches of each strength, and their frequencies.

    Args:
        part: [T, O] what the robot observed.
        force: [T] N, which it observes too.
    """
    arms = part[:, ARMS].reshape(len(part), 2, 3)
    aside = arms - part[:, None, TOOL]
    aside /= np.linalg.norm(aside, axis=-1, keepdims=True)
    moved = ((arms[ANSWER:] - arms[:-ANSWER]) * aside[:-ANSWER]).sum(axis=-1)  # [T', 2] m
    place = np.searchsorted(TOUCHES, force[:-ANSWER])
    rows = []
    for strength in range(len(TOUCHES) + 1):
        chosen = place == strength
        share = chosen.mean()
        rows.append([*(moved[chosen].mean(axis=0) if share else (0.0, 0.0)), share])
    return np.concatenate(rows)


@own_settings()
def film(task: str, rows: np.ndarray, path: str, seconds: float, seed: int = 0) -> None:
    """Draw a picture of each person, three in a row: the script's episode after a time."""
    from PIL import Image

    env, begin, play = _program(task, "script", "person", "spring", 10)
    keys = jax.random.split(key_of(seed), len(rows))
    row = jnp.asarray(rows)
    loop = begin(row, person_params(task, rows), keys)
    for time in range(0, int(seconds * STEPS_A_SECOND), 10):
        loop, _ = play(row, loop, jnp.asarray(time, jnp.int32))
    shots = [env.render(loop[0], i, "close", 240, 260)[:168] for i in range(len(rows))]
    env.close()
    lines = [np.concatenate(shots[i : i + 3], axis=1) for i in range(0, len(shots), 3)]
    picture = Image.fromarray(np.concatenate(lines))
    picture.quantize(256, Image.Quantize.FASTOCTREE).save(path, optimize=True)


def main() -> None:
    """Run one of the module's commands."""
    parser = argparse.ArgumentParser(prog="python -m assistax_envs.persons.measure")
    parser.add_argument("what", choices=("play", "read", "film"))
    parser.add_argument("task", choices=tuple(PREFERRED))
    parser.add_argument("path", nargs="?", default="persons.png")
    parser.add_argument("--count", type=int)
    parser.add_argument("--family", choices=("spring", "muscle"), default="spring")
    options = parser.parse_args()
    count = options.count or {"play": 50, "read": 900, "film": 9}[options.what]
    rows = persons(options.task)[:INNER][:count]
    if options.what == "film":
        film(options.task, rows, options.path, 4.0)
    elif options.what == "play":
        for robot, human in (("script", "person"), ("script", "idle"), ("idle", "person")):
            figures = earned(episodes(options.task, rows, robot, human, options.family))
            line = ", ".join(f"{name} {value:.3g}" for name, value in figures.items())
            print(f"{options.task}, {robot} with {human} x {count}: {line}", flush=True)
    else:
        _print_read(options.task, rows, options.family)


def _print_read(task: str, rows: np.ndarray, family: str) -> None:
    place = index(task)
    for robot in ("script",) if SCRIPTS[task].force is None else ("script", "probe"):
        seen = episodes(task, rows, robot, "person", family, steps=600)
        for name in preference_parameters(task):
            for window in WINDOWS:
                preference = rows[:, place[name]]
                share, of = read(seen, preference, window)
                mixed = np.random.default_rng(0).permutation(preference)
                chance, _ = read(seen, mixed, window)
                print(
                    f"{task}, {robot}: {name} from {window:g} s in {share:.0%} of {of} "
                    f"(shuffled {chance:.0%}, chance 33%)",
                    flush=True,
                )


if __name__ == "__main__":
    main()
