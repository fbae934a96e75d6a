"""Persons at the mouth: they open, show their teeth, and turn away."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs.models.care_scenes import OPEN
from assistax_envs.models.teeth import ORDER
from assistax_envs.persons.head import JAW, LEAN, YAW, Mind
from assistax_envs.persons.measure import earned, episodes
from assistax_envs.persons.player import PersonPlayer
from assistax_envs.persons.rows import INNER, PARAMETERS, WIDTH, marked, person_kind, persons
from assistax_envs.preferences import PREFERRED, VALUES
from assistax_envs.tasks.gentle_base import FELT
from assistax_envs.tasks.gentle_feeding.eating import WIDE
from assistax_envs.tasks.mouth import ENTERING, TAKING, TURNED, WAITING
from tests.envs import mouth
from tests.envs.conftest import start

NOBODY = {  # numbers of somebody without impairment or chance
    "strength": 1.0, "range": 1.0, "tremor_frequency": 6.0, "tremor": 0.0, "bite_reflex": 0.0,
    "bite_onset": 2.0, "fatigue": 0.0, "slow_start": 0.1, "stiffness": 1.0, "delay": 0.1,
    "noise": 0.0, "wander": 0.0, "pace": 0.1, "initiative": 1.0, "lapses": 0.0,
    "belief_pitch": 0.0, "belief_yaw": 0.0, "belief_jaw": 0.0, "liked_wait": 0.08,
    "liked_depth": 0.02, "liked_press": 1.0, "liked_speed": 0.04, "tolerance": 2.5, "settle": 0.3,
    "withdraw": 0.15, "lean": 0.05, "limit": 1.0, "expressive": 0.0, "talkative": 0.0,
    "word_delay": 0.6, "word_pause": 1.0, "word_error": 0.0,
}  # fmt: skip
BATCH = 16
FAMILIES = ("spring", "muscle")


@functools.cache
def acting(task: str):
    player = PersonPlayer(task)
    return player, jax.jit(player.act)


@functools.cache
def at_rest(task: str) -> np.ndarray:
    seen = np.array(start(task, "fused", ["d1"] * 3, seed=3).obs["human"][0])
    seen[:14] = 0.0  # head and jaw are still where their springs hold them
    return seen


def felt(task: str, stage: int, out: float, touch: float) -> list[float]:
    """Return what is done of both wishes over their middles, and whether each is judged."""
    (_, first, _), (_, second, _) = (VALUES[name] for name in PREFERRED[task])
    if task == "gentle_brushing":
        return [touch / first, 0.0, float(touch > FELT), 0.0]
    waits, inside = stage == WAITING and out > 0.0, stage in (ENTERING, TAKING) and out < 0.0
    return [max(out, 0.0) / first, max(-out, 0.0) / second, float(waits), float(inside)]


def met(
    task: str, stage: int, tool: tuple[float, float, float], steps: int = 100, touch: float = 0.0,
    family: str = "spring", **numbers: float,
) -> tuple[Mind, np.ndarray]:  # fmt: skip
    """Return the mind and the action [5] of a person after `steps` of one observation."""
    player, act = acting(task)
    row = [(NOBODY | numbers)[parameter.name] for parameter in PARAMETERS[task]]
    rows = np.resize(np.array(row, np.float32), (BATCH, WIDTH))
    rows = jnp.asarray(marked(rows, FAMILIES.index(family)))
    seen, where = at_rest(task).copy(), person_kind(task).columns
    seen[where["tool"]] = 10.0 * np.array(tool)
    seen[where["progress"]] = 0.0
    seen[where["progress"].start + stage] = 1.0
    seen[where["flag"]] = 1.0
    seen[where["touch"]] = touch / person_kind(task).touch_unit
    seen[where["felt"]] = felt(task, stage, tool[0], touch)
    obs, mind = jnp.asarray(np.tile(seen, (BATCH, 1))), player.initial_carry((BATCH,))
    action = jnp.zeros((BATCH, 5))
    for step in range(steps):
        mind, action = act({"row": rows}, mind, obs, jnp.full(BATCH, step == 0))
    return mind, np.asarray(action[0])


@pytest.mark.parametrize("family", FAMILIES)
def test_mouth_opens_sooner_at_the_preferred_distance(family: str) -> None:
    opened = {}
    for out in (0.03, 0.08, 0.2):
        mind, _ = met("gentle_feeding", WAITING, (out, 0.0, 0.0), 60, family=family)
        opened[out] = float(mind.aim[0, JAW])
    assert opened[0.08] == pytest.approx(WIDE) and max(opened[0.03], opened[0.2]) < 0.1
    # Who likes it nearer opens there.
    mind, _ = met("gentle_feeding", WAITING, (0.04, 0.0, 0.0), 60, family=family, liked_wait=0.04)
    assert float(mind.aim[0, JAW]) == pytest.approx(WIDE)


@pytest.mark.parametrize("family", FAMILIES)
def test_near_tool_turns_the_head_away(family: str) -> None:
    """To the other side than the spoon's; a spoon that was waited for may come."""
    for side, turns in ((0.02, -1.0), (-0.02, 1.0)):
        mind, action = met("gentle_feeding", WAITING, (0.01, side, 0.0), 30, family=family)
        assert turns * float(mind.reaction.shift[0, YAW]) > 0.05 and turns * action[YAW] > 0.05
    mind, action = met("gentle_feeding", ENTERING, (0.01, 0.02, 0.0), 30, family=family)
    assert float(mind.reaction.discomfort[0]) == 0.0 and abs(action[YAW]) < 0.05


def test_person_leans_towards_a_far_tool() -> None:
    mind, action = met("gentle_feeding", WAITING, (0.2, 0.0, 0.0), 40)
    near, still = met("gentle_feeding", WAITING, (0.08, 0.0, 0.0), 40)
    assert float(mind.reaction.lightness[0]) > 0.5 > float(near.reaction.lightness[0])
    assert action[LEAN] > still[LEAN] + 0.02  # the seat's torque is positive forward


def test_lips_close_on_a_served_spoon() -> None:
    _, opened = met("gentle_feeding", ENTERING, (-0.02, 0.0, 0.0))
    _, closed = met("gentle_feeding", TAKING, (-0.02, 0.0, 0.0))
    assert opened[JAW] > closed[JAW] + 0.2
    mind, _ = met("gentle_feeding", ENTERING, (-0.02, 0.0, 0.0))
    deep, _ = met("gentle_feeding", ENTERING, (-0.045, 0.0, 0.0))
    assert float(mind.reaction.discomfort[0]) == 0.0 < float(deep.reaction.discomfort[0])


@pytest.mark.parametrize("place", range(len(ORDER)))
def test_teeth_are_shown_by_turning_and_opening(place: int) -> None:
    mind, _ = met("gentle_brushing", place, (0.1, 0.0, 0.0))
    _, side, inner = ORDER[place]
    turn = {"right": TURNED, "front": 0.0, "left": -TURNED}[side]
    assert float(mind.intended[0, YAW]) == pytest.approx(turn, abs=1e-3)
    assert (float(mind.intended[0, JAW]) > 0.3) == inner


@pytest.mark.parametrize("family", FAMILIES)
def test_hard_brush_ends_the_help(family: str) -> None:
    soft, _ = met("gentle_brushing", 6, (0.0, 0.0, 0.0), touch=1.0, family=family)
    hard, _ = met("gentle_brushing", 6, (0.0, 0.0, 0.0), touch=8.0, family=family)
    assert not bool(soft.stopped[0]) and bool(hard.stopped[0])
    assert float(hard.aim[0, JAW]) == 0.0 < float(soft.aim[0, JAW])


def test_bite_reflex_closes_the_mouth() -> None:
    _, calm = met("gentle_feeding", ENTERING, (-0.02, 0.0, 0.0), 56, touch=3.0)
    seen = at_rest("gentle_feeding")
    assert seen.shape[0] == 54 and calm[JAW] > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("task", ["gentle_feeding", "gentle_brushing"])
def test_head_persons_repeat_and_help(task: str) -> None:
    rows = persons(task)[:INNER][:32]
    helped = earned(episodes(task, rows, "script", "person"))
    alone = earned(episodes(task, rows, "script", "idle"))
    assert helped["return"] > alone["return"] + 40.0
    assert alone["success"] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_jaws_do_not_chatter_at_a_still_robot(family: str) -> None:
    """In 9 s nobody's jaw turns more than five times after 0.1 rad; 13 of 128 did before."""
    rows = persons("gentle_feeding")[:128]
    seen = episodes("gentle_feeding", rows, "idle", family=family, steps=500)
    jaws = OPEN * seen["obs"][50:, :, mouth.JAW]
    assert np.ptp(jaws, axis=0).max() > 0.1  # they do open
    turns = np.array([_turns(jaw) for jaw in jaws.T])
    assert turns.max() <= 5 and (turns > 4).sum() <= 1


def _turns(angle: np.ndarray, by: float = 0.1) -> int:
    """Return how often an angle [T] turns back by more than `by`."""
    high = low = angle[0]
    way = count = 0
    for now in angle:
        high, low = max(high, now), min(low, now)
        if (way >= 0 and high - now > by) or (way <= 0 and now - low > by):
            count += way != 0
            way = -1 if high - now > by else 1
            high = low = now
    return count
