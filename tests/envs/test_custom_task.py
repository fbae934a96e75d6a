"""A task of one's own is a class that takes the scene of another."""

from typing import Any

import numpy as np
import pytest

from assistax_envs import make
from assistax_envs.tasks.gentle_scratch.task import GentleScratch
from assistax_envs.tasks.scratch.task import Scratch
from tests.envs.conftest import random_actions, start


class Flee(Scratch):
    name = "flee"
    scene = "scratch"

    def transition(self, task_state: Any, readings: Any) -> Any:
        state, seen, terms, measures = super().transition(task_state, readings)
        return state, seen, {name: -term for name, term in terms.items()}, measures


def test_custom_task_plays_with_its_own_reward() -> None:
    env, state = make(Flee, "native"), start("scratch", "native", ["d1", "d9"])
    action = random_actions(2, 1)[0]
    mine, theirs = env.step(state, action), make("scratch", "native").step(state, action)
    np.testing.assert_array_equal(mine.obs["robot"], theirs.obs["robot"])
    np.testing.assert_array_equal(mine.reward, -theirs.reward)
    assert (env.task, env.version) == ("flee", 0)


def test_custom_task_has_version_zero() -> None:
    class Same(Scratch):
        scene = "scratch"

    assert make(Same, "native").version == 0 != make("scratch", "native").version


def test_gentle_scene_needs_contact_frames() -> None:
    class Mine(GentleScratch):
        name, scene = "mine", "gentle_scratch"

    with pytest.raises(ValueError, match="gentle_scratch needs to know which way"):
        make(Mine, "mjx")
