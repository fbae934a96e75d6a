"""A maker of logs for tests: the page's file, of a recorded mouse path and not of a person.

It plays the environment step by step, as films do, with a robot in its seat. So it computes actions
and results by other code than `evaluation.people` does.
"""

import base64
import itertools
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_base.digest import json_sha256
from assistax_envs.own_settings import own_settings
from assistax_envs.preferences import PREFERRED, middles
from assistax_envs.tasks.chain import told_script_of
from assistax_envs.versions import VERSIONS
from evaluation.cast.partners import Partner, zoo_partner
from evaluation.film import _programs  # the compiled steps of films, or each log compiles anew
from evaluation.people.playing import begun, drawn, environment, visitors
from evaluation.play.baselines import script_roster
from evaluation.seat.modules import read_manifest
from zoo.registry import Registry

ROBOT = "{task}/dagger-ego-s{seed}-v1/robot"


def mouse_path(seed: int, width: int) -> Iterator[tuple[np.ndarray, int]]:
    """Yield torques [A] and words of a recorded mouse path: slow sweeps, a word now and then."""
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(0.2, 0.6, width), rng.uniform(0.0, 6.0, width)
    for step in itertools.count():
        sweep = 0.5 * np.sin(2.0 * np.pi * rate * step / 50.0 + phase)
        yield sweep.astype(np.float32), int(rng.integers(1, 9)) if step % 150 == 100 else 0


def make_log(
    task: str,
    registry: Registry,
    *,
    robot: int | str = 0,
    start: int = 5,
    path: int = 0,
    wish: Mapping[str, float] | None = None,
    study: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the content of a log of a recorded mouse path.

    Args:
        task: The task.
        registry: Registry of the robot.
        robot: Seed of the published robot, or "script", or "told-script".
        start: Seed of the reset.
        path: Seed of the mouse path.
        wish: By default the middles of the task's wishes.
        study: The log's field; by default no study.
    """
    env = environment(task)
    wish = dict(wish or zip(PREFERRED[task], middles(task), strict=True))
    acting = _partner(task, robot, wish, registry)
    _, step = _programs(env)
    state = own_settings()(begun)(env, *drawn(task, [start]), visitors(task, [wish]))
    human, rows, earned = mouse_path(path, env.action_size["human"]), [], 0.0
    for _ in range(env.episode_length):
        torques, word = next(human)
        rows.append((acting.act(_seen(state)), torques, word))
        given = {"robot": rows[-1][0], "human": torques, "word": np.array(word, np.int32)}
        state = step(state, {role: value[None] for role, value in given.items()})
        earned += float(state.reward[0])
        if bool(state.terminated[0]):
            break
    robots, humans, words = (np.array(part) for part in zip(*rows, strict=True))
    content = {
        "format": "assistax-seat 1",
        "task": task,
        "environment": VERSIONS[task],
        "engine": read_manifest()["tasks"][task]["wasm"],
        "robot": {
            "name": acting.id,
            "sha256": None if acting.card is None else acting.card.sha256,
        },
        "study": dict(study or {"blind": False, "block": None, "order": None}),
        "start": start,
        "wish": wish,
        "device": {"width": 1400, "height": 900, "kind": "mouse", "class": "desktop"},
        "dropped": 0,
        "steps": len(rows),
        "actions": {"robot": encoded(robots, "<f4"), "human": encoded(humans, "<f4")},
        "words": encoded(words, "i1"),
        "result": {"return": earned, "success": bool(state.measures.success[0])},
        "saved": "2026-11-29T10:00:00.000Z",
        "consent": [True, True, True],
    }
    return signed(content)


def signed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return a log's content with the hash of everything else."""
    bare = {key: value for key, value in content.items() if key != "sha256"}
    return {**bare, "sha256": json_sha256(bare)}


def write(content: Mapping[str, Any], path: Path) -> Path:
    """Write a log as the page does, and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content), "utf-8")
    return path


def encoded(values: np.ndarray, kind: str) -> str:
    """Return numbers as a log has them."""
    return base64.b64encode(values.astype(kind).tobytes()).decode("ascii")


def _partner(task: str, robot: int | str, wish: Mapping[str, float], registry: Registry) -> Partner:
    """Return a robot for one simulation."""
    if isinstance(robot, int):
        return zoo_partner(registry, ROBOT.format(task=task, seed=robot), "robot")
    env = environment(task)
    [stack] = script_roster(task, env.observation_size["robot"], 7).policies
    if robot == "script":
        return Partner(robot, stack.spec, stack.row(0))
    return _Told(robot, stack.spec, stack.row(0), wish)


class _Told(Partner):
    """The script that is told the wish."""

    def __init__(self, name: str, spec: Any, params: Any, wish: Mapping[str, float]) -> None:
        super().__init__(name, spec, params)
        self._wishes = np.array([[wish[name] for name in PREFERRED[spec.task]]], np.float32)
        self._script = jax.jit(told_script_of(spec.task, environment(spec.task).model))

    @own_settings()
    def act(self, obs: np.ndarray) -> np.ndarray:
        return np.asarray(self._script(jnp.asarray(obs)[None], jnp.asarray(self._wishes))[0])


@own_settings()
def _seen(state: Any) -> np.ndarray:
    return np.asarray(state.obs["robot"][0])
