"""Measure persons without a trained robot: returns of scripts, and pictures.

python -m assistax_envs.persons.measure play TASK
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
from assistax_envs.persons.player import PersonPlayer, person_params
from assistax_envs.persons.rows import (
    FAMILIES,
    INNER,
    PARAMETERS,
    ROWS,
    Person,
    family_place,
    marked,
    person,
    persons,
)
from assistax_envs.preferences import PREFERRED, VALUES
from assistax_envs.tasks.chain import script_of, told_script_of
from assistax_envs.tasks.gentle_base import FELT

# s, in which a probing script goes from the least to the largest value of a wish and back
SWEEPS = (4.0, 6.0)
STEPS_A_SECOND = 50
_LABEL = 20  # pixels below a picture of a person, for its wishes

# A robot with a memory: from N to its memory before the first observation, and from memory,
# observations [N, O] and the step to its memory and actions [N, 7].
Robot = tuple[Callable[[int], Any], Callable[[Any, jax.Array, jax.Array], tuple[Any, jax.Array]]]


@functools.cache
def _program(task: str, robot: str | Robot, human: str, steps: int) -> tuple[Any, Any, Any]:
    """Return the environment, and programs that start episodes and play `steps` of them."""
    env, player = assistax_envs.make(task), PersonPlayer(task)

    def command(memory: Any, state: Any, time: jax.Array) -> tuple[Any, jax.Array]:
        obs = state.obs["robot"]
        if not isinstance(robot, str):
            return robot[1](memory, obs, time)
        if robot == "idle":
            return memory, jnp.zeros((obs.shape[0], env.action_size["robot"]))
        if robot == "script":
            return memory, script_of(task, env.model)(obs)
        wishes = state.params.preference.of(task)
        if robot == "probe":
            wishes = jnp.broadcast_to(probed(task, time), wishes.shape)
        return memory, told_script_of(task, env.model)(obs, wishes)

    def step(row: jax.Array, loop: tuple[Any, ...], time: jax.Array) -> tuple[Any, Any]:
        state, carry, memory = loop
        obs = state.obs
        carry, action = player.act({"row": row}, carry, obs["human"], time == 0)
        action = jnp.zeros_like(action) if human == "idle" else action
        memory, driven = command(memory, state, time)
        stopped = state.terminated  # what comes after counts for nothing
        word = player.word(carry) * (human != "idle")
        before = env.joint_positions(state)["human"]
        state = env.step(state, {"robot": driven, "human": action, "word": word})
        seen = {
            "reward": jnp.where(stopped, 0.0, state.reward),
            "force": state.measures.force,
            "success": state.measures.success & ~stopped,
            "violated": state.measures.violated,
            "discomfort": state.measures.discomfort,
            "done": state.measures.done,
            "judged": state.measures.judged,
            "liked": state.measures.liked,
            "moved": jnp.abs(env.joint_positions(state)["human"] - before).sum(axis=-1),
            "terminated": stopped,
            "word": word,
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
        rows: [N, 30] of the persons.
        robot: "script"; "told", the script that keeps to their wishes; "probe", which keeps to
            the wishes of `probed`; "idle"; or a robot of your own.
        human: "person", or "idle": a human of the person's body and preference that does nothing.
        family: of the persons.
        steps: to play.
        seed: of the episodes' starts.

    Returns:
        Arrays [T, N] "reward", "force", "success", "violated", "discomfort", "moved" (rad, of all
        the human's joints), "terminated" (before the step), "word", [T, N, W] "done", "judged",
        "liked" of the wishes, and [T, N, O] "obs".
    """
    _, begin, play = _program(task, robot, human, steps)
    keys = jax.random.split(key_of(seed), len(rows))
    row = jnp.asarray(marked(rows, FAMILIES.index(family)))
    loop = begin(row, person_params(task, rows), keys)
    _, seen = play(row, loop, jnp.zeros((), jnp.int32))
    return jax.tree.map(np.asarray, seen)


def probed(task: str, time: jax.Array) -> jax.Array:
    """Return the wishes [1, W] that a probing script keeps to at a step.

    Each goes from its least to its largest usual value and back, in a time of its own.
    """
    low, _, high = np.array([VALUES[name] for name in PREFERRED[task]]).T
    periods = STEPS_A_SECOND * np.resize(SWEEPS, len(low))
    share = 1.0 - 2.0 * jnp.abs((time / periods) % 1.0 - 0.5)
    return jnp.asarray(low * (high / low) ** share, jnp.float32)[None]


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


@own_settings()
def film(task: str, each: int, path: str, seconds: float, seed: int = 0) -> None:
    """Draw a picture of persons, a line for each family, with their wishes below.

    Args:
        task: one of the gentle tasks.
        each: persons of each family; no two have the same row of numbers.
        path: of the picture.
        seconds: of the script's episode before the picture.
        seed: of the episodes' starts.
    """
    from PIL import Image

    numbers = [place * (ROWS + each) + i for place in range(len(FAMILIES)) for i in range(each)]
    chosen = [person(task, number) for number in numbers]
    rows, places = np.stack([one.row for one in chosen]), [family_place(p.family) for p in chosen]
    env, begin, play = _program(task, "script", "person", 10)
    row, starts = jnp.asarray(marked(rows, places)), jax.random.split(key_of(seed), each)
    loop = begin(row, person_params(task, rows), jnp.concatenate([starts] * len(FAMILIES)))
    for time in range(0, int(seconds * STEPS_A_SECOND), 10):
        loop, _ = play(row, loop, jnp.asarray(time, jnp.int32))
    shots = [
        _named(env.render(loop[0], i, "close", 240, 260, (f"human {one.name}",))[:168], one)
        for i, one in enumerate(chosen)
    ]
    env.close()
    lines = [np.concatenate(shots[i : i + each], axis=1) for i in range(0, len(shots), each)]
    picture = Image.fromarray(np.concatenate(lines))
    picture.quantize(256, Image.Quantize.FASTOCTREE).save(path, optimize=True)


def _named(shot: np.ndarray, shown: Person) -> np.ndarray:
    """Return a picture with the person's family and wishes written below."""
    from PIL import Image, ImageDraw, ImageFont

    parameters = PARAMETERS[shown.task]
    named = {one.name: (value, one) for value, one in zip(shown.row, parameters, strict=True)}
    wishes = [named[f"liked_{name}"] for name in PREFERRED[shown.task]]
    label = Image.new("RGB", (shot.shape[1], _LABEL), "white")
    font = ImageFont.load_default(size=13)
    words = f"{shown.family}, likes {', '.join(f'{value:.2g} {one.unit}' for value, one in wishes)}"
    ImageDraw.Draw(label).text((6, 2), words, fill="#222222", font=font)
    return np.concatenate([shot, np.asarray(label)])


def main() -> None:
    """Run one of the module's commands."""
    parser = argparse.ArgumentParser(prog="python -m assistax_envs.persons.measure")
    parser.add_argument("what", choices=("play", "film"))
    parser.add_argument("task", choices=tuple(PREFERRED))
    parser.add_argument("path", nargs="?", default="persons.png")
    parser.add_argument("--count", type=int)
    parser.add_argument("--family", choices=FAMILIES, default="spring")
    options = parser.parse_args()
    count = options.count or {"play": 50, "film": 3}[options.what]
    if options.what == "film":
        film(options.task, count, options.path, 4.0)
        return
    rows = persons(options.task)[:INNER][:count]
    pairs = [(robot, "person") for robot in ("script", "told", "probe", "idle")]
    for robot, human in (*pairs, ("script", "idle")):
        figures = earned(episodes(options.task, rows, robot, human, options.family))
        line = ", ".join(f"{name} {value:.3g}" for name, value in figures.items())
        print(f"{options.task}, {robot} with {human} x {count}: {line}", flush=True)


if __name__ == "__main__":
    main()
