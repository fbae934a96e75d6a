"""Gentle brushing: strokes over twelve places on the teeth, at the liked force and speed.

Neither can do it alone: the human turns its head to show a side and opens its mouth for the inside,
the robot brushes. The robot has to find out how hard and how fast the human likes it.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.models.care_scenes import OPEN, TEETH
from assistax_envs.models.teeth import INNER, OFF, PLACES, ROW, SHOWN_BY, places
from assistax_envs.tasks import care
from assistax_envs.tasks.base import Measures, human_joints, observations, rotate
from assistax_envs.tasks.gentle_base import (
    STEP,
    Preferences,
    episode_preferences,
    roughness,
    with_preference,
)
from assistax_envs.tasks.gentle_feeding.task import AtMouth, arm_at
from assistax_envs.tasks.mouth import OPENED, TURNED, MouthReadings

HALF = 0.008  # m, from a place's middle to either end of its strokes
AT_END = 0.004  # m along the row, how near the brush comes to an end
STROKE = 0.01  # m, way of a stroke: what a liked speed means in time
BESIDE = 0.007  # m across the row, how far the brush may be from where it should be
LIGHTEST, HARDEST = 0.1, 8.0  # N on the row
# Of a place: a dentist's ten would take a minute and a half. How well they are liked changes what
# they pay, not their number: a robot that observed when a place is done would be told.
STROKES = 4
# Places that are success, with this many strokes within 1.5 of the liked force and time.
ASKED, WELL = 6, 2
HALF_OPEN = 0.25  # rad of the jaw, from where on the inside can be brushed
SHOWN = 0.3  # rad of the neck's yaw, likewise a side
JAW_WAY, TURN_WAY = 0.2, 0.1  # m of a place's way that a radian of jaw and neck counts for
GATE = np.array([0.0, 0.0, -0.005], np.float32)  # between the lips, where a brush goes in and out
WITHIN = -0.002  # m: a brush that is farther out than this is before the mouth
NEAR = 0.75  # share of the last 16 mm of a way that is not paid: strokes pay by preference
BEFORE = 5  # rows of `WAY` in which episodes start before the mouth
# The robot's joints at each place, rad: the brush along the mouth's axis, 2 mm from the teeth of a
# human that shows them.
AT = (
    (0.093, 0.052, -0.504, -1.551, 0.546, 1.661, -0.680),
    (0.019, -0.382, -0.229, -2.063, 0.294, 2.071, -0.042),
    (0.014, -0.495, 0.013, -2.207, 0.006, 2.235, 0.787),
    (0.014, -0.497, 0.013, -2.239, 0.006, 2.266, 0.787),
    (0.089, -0.392, -0.287, -2.097, 0.267, 2.107, -0.029),
    (0.107, 0.045, -0.513, -1.589, 0.544, 1.691, -0.692),
    (-0.173, 0.100, -0.222, -1.558, 0.545, 1.720, -0.695),
    (0.300, -0.371, -0.444, -2.111, 0.197, 2.182, 0.031),
    (0.018, -0.472, 0.045, -2.261, 0.001, 2.312, 0.825),
    (0.018, -0.474, 0.044, -2.210, 0.001, 2.260, 0.824),
    (0.047, -0.340, -0.232, -2.048, 0.298, 2.104, -0.028),
    (0.006, 0.117, -0.425, -1.492, 0.569, 1.660, -0.688),
)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class BrushState:
    """Progress of the brushing and of its present stroke."""

    place: jax.Array  # int32 index into `teeth.ORDER`
    done: jax.Array  # int32, places that are brushed
    strokes: jax.Array  # int32, of this place
    well: jax.Array  # int32, those of them that were liked
    liked_places: jax.Array  # int32
    side: jax.Array  # +1 or -1: the end that the brush goes to
    time: jax.Array  # steps that this stroke has taken at the place
    liked: jax.Array  # sum over them of how well the human liked the force
    pressed: jax.Array  # sum over the touched ones of the logarithm of the force
    touched: jax.Array  # those in touch
    speed: jax.Array  # m/s, of the last stroke; 0 before the first
    left: jax.Array  # m of the way to that end a step ago; NaN before the first step
    care: care.Care
    preference: Preferences


class GentleBrushing(AtMouth):
    """Progress to the stroke's end, pay for each stroke as it is liked, and for each place.

    A stroke pays by the steps that it should take, as in gentle scratch: a fixed pay teaches haste.
    """

    name = scene = "gentle_brushing"
    target_colours: ClassVar = {"place": (0.95, 0.05, 0.55, 0.5)}
    terms: ClassVar = {"progress": 50.0, "stroke": 1.0, "place": 10.0}
    felt: ClassVar = TEETH

    def __init__(
        self,
        model: mujoco.MjModel,
        weights: dict[str, float] | None = None,
        told: tuple[str, ...] = ("human",),
    ) -> None:
        super().__init__(model, weights, told)
        self._yaw = int(model.joint("human_neck_yaw").qposadr[0])
        # Among the joints that are read.
        self._read_yaw = human_joints(model).index("human_neck_yaw")

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, BrushState]:
        """Draw the start pose [nq], the first place and, unless it is given, the preference."""
        pose_key, preference_key, place_key, start_key, side_key = jax.random.split(key, 5)
        place = jax.random.randint(place_key, (), 0, PLACES)
        out = jax.random.uniform(start_key, maxval=2.0 * (BEFORE - 1))
        there = out > BEFORE - 1  # half of the episodes start at the place itself
        arm = jnp.where(there, jnp.asarray(AT, jnp.float32)[place], arm_at(out, BEFORE))
        pose = self.pose.draw(pose_key)
        noise = (pose - self.pose.angle)[self._robot] * jnp.where(there, 0.0, 0.5)
        pose = pose.at[self._robot].set(arm + noise)
        turn = TURNED * jnp.asarray(SHOWN_BY, jnp.float32)[place]
        pose = pose.at[self._yaw].set(jnp.where(there, turn, pose[self._yaw]))
        opened = there & jnp.asarray(INNER)[place]
        pose = pose.at[self._jaw].set(jnp.where(opened, OPENED, 0.0))
        zero, nought = jnp.zeros((), jnp.float32), jnp.zeros((), jnp.int32)
        return pose, BrushState(
            place=place,
            done=nought,
            strokes=nought,
            well=nought,
            liked_places=nought,
            side=jnp.where(jax.random.bernoulli(side_key), 1.0, -1.0),
            time=zero,
            liked=zero,
            pressed=zero,
            touched=zero,
            speed=zero,
            left=jnp.full((), jnp.nan, jnp.float32),
            care=care.untouched(self.scene, params),
            preference=episode_preferences(params, preference_key),
        )

    def targets(self, task_state: BrushState, readings: MouthReadings) -> dict[str, jax.Array]:
        """See `Task.targets`: the ends of the place."""
        spot = self._spot(task_state, readings)
        ends = [
            readings.mouth_position
            + rotate(readings.mouth_orientation, spot.middle + side * HALF * spot.along)
            for side in (1.0, -1.0)
        ]
        return {"place": jnp.stack(ends, axis=1)}

    def transition(
        self, task_state: BrushState, readings: MouthReadings
    ) -> tuple[BrushState, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """See `Task.transition`; the goal holds after six places as liked."""
        s, r = task_state, readings
        spot = self._spot(s, r)
        full = s.done >= PLACES
        there = spot.shown & (spot.aside < BESIDE) & ~full
        touching = there & (spot.force > LIGHTEST) & (spot.force < HARDEST)
        arrived = touching & (s.side * spot.at > HALF - AT_END) & (jnp.abs(spot.at) < HALF + AT_END)
        felt = self._felt(s, r, spot, touching)
        press, best = felt.done[:, 0], STROKE / s.preference.speed / STEP  # steps
        time = s.time + there
        liked = s.liked + touching * care.liked(press, s.preference.press, felt.width)
        pressed = s.pressed + touching * jnp.log(jnp.maximum(press, LIGHTEST))
        touched, took = s.touched + touching, jnp.maximum(time, 1.0)
        pays = care.paid(care.liked(took, best, felt.width) * liked / took)
        well = arrived & care.within(took, best)
        well &= care.within(jnp.exp(pressed / jnp.maximum(touched, 1.0)), s.preference.press)
        strokes, well = s.strokes + arrived, s.well + well
        finished = strokes >= STROKES
        as_liked = finished & (well >= WELL)
        moved = jnp.isnan(s.left) | full
        terms = {
            "progress": jnp.where(moved, 0.0, s.left - spot.left),
            "stroke": arrived * best * pays,
            "place": as_liked.astype(jnp.float32),
        }
        terms |= roughness(r, felt.violated) | care.costs(felt)
        after = dataclasses.replace(
            s,
            place=jnp.where(finished, (s.place + 1) % PLACES, s.place),
            done=s.done + finished,
            liked_places=s.liked_places + as_liked,
            strokes=jnp.where(finished, 0, strokes).astype(jnp.int32),
            well=jnp.where(finished, 0, well).astype(jnp.int32),
            side=jnp.where(arrived, -s.side, s.side),
            time=jnp.where(arrived, 0.0, time),
            liked=jnp.where(arrived, 0.0, liked),
            pressed=jnp.where(arrived, 0.0, pressed),
            touched=jnp.where(arrived, 0.0, touched),
            speed=jnp.where(arrived, STROKE / (STEP * took), s.speed),
            care=felt,
        )
        ahead = self._spot(after, r)
        after = dataclasses.replace(after, left=ahead.left)
        obs = self._observed(after, r, ahead, liked / took)
        goal, wishes = after.liked_places >= ASKED, s.preference.of(self.scene)
        return after, obs, terms, care.measures(felt, r, spot.left, goal, wishes)

    def _felt(
        self, s: BrushState, r: MouthReadings, spot: "Spot", touching: jax.Array
    ) -> care.Care:
        """Return the care after a step: of the press, and of the last stroke's speed."""
        sample, judged = (spot.force, s.speed), (touching, touching & (s.speed > 0.0))
        given = s.care, self.scene, s.preference, r
        return care.after(*given, sample, judged, s.preference.press)

    def _spot(self, s: BrushState, r: MouthReadings) -> "Spot":
        """Return the brush relative to the place that is to be brushed."""
        middle, along, normal = places(s.place, r.jaw)
        inner, shown_by = jnp.asarray(INNER)[s.place], jnp.asarray(SHOWN_BY, jnp.float32)[s.place]
        off = r.bowl - middle
        at = (off * along).sum(-1)
        across = off - at[:, None] * along - OFF * normal
        goal = middle + OFF * normal + (s.side * HALF)[:, None] * along
        yaw = shown_by * r.human_position[:, self._read_yaw]
        sideways = shown_by != 0.0
        before = (r.bowl[:, 0] > WITHIN) | (
            jnp.linalg.norm(r.bowl[:, 1:] - GATE[None, 1:], axis=-1) > 0.03
        )
        straight = jnp.linalg.norm(goal - r.bowl, axis=-1)
        gate = jnp.asarray(GATE)[None]
        around = jnp.linalg.norm(r.bowl - gate, axis=-1) + jnp.linalg.norm(goal - gate, axis=-1)
        tool = jnp.where(inner == before, around, straight)
        left = (
            tool
            - NEAR * jnp.minimum(tool, 2.0 * HALF)
            + inner * JAW_WAY * jnp.maximum(OPENED - r.jaw, 0.0)
            + sideways * TURN_WAY * jnp.maximum(TURNED - yaw, 0.0)
        )
        row = jnp.arange(s.place.shape[0])
        return Spot(
            middle=middle,
            along=along,
            normal=normal,
            goal=goal,
            at=at,
            aside=jnp.linalg.norm(across, axis=-1),
            force=r.felt[row, jnp.asarray(ROW)[s.place]],
            shown=(~inner | (r.jaw > HALF_OPEN)) & (~sideways | (yaw > SHOWN)),
            left=left,
        )

    def _observed(
        self, s: BrushState, r: MouthReadings, spot: "Spot", liked: jax.Array
    ) -> dict[str, jax.Array]:
        """Return the observations of all roles after a step."""
        goal = (
            r.bowl * 10.0,
            r.up,
            jnp.clip(spot.goal - r.bowl, -0.05, 0.05) * 20.0,
            rotate(r.mouth_orientation, spot.goal - r.bowl) * 5.0,
            rotate(r.mouth_orientation, spot.normal),
            rotate(r.mouth_orientation, spot.along),
            r.jaw[:, None] / OPEN,
            r.human_position[:, self._read_yaw][:, None],
            jax.nn.one_hot(s.place, PLACES),
            s.side[:, None],
            spot.shown[:, None].astype(jnp.float32),
            jnp.minimum(s.time, 50.0)[:, None] / 25.0,
            s.strokes[:, None] / STROKES,
            s.done[:, None] / PLACES,
            r.force[:, None] / 5.0,
            spot.force[:, None] / 5.0,
        )
        obs = observations(r, *goal, body=(r.mouth_position, r.forward))
        # The human alone feels how well the force fits: a robot that observed it would be told.
        seen = jnp.column_stack([liked, s.preference.observed(self.scene)])
        return with_preference(obs, care.felt_by(s.care, self.scene), seen, self._told)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Spot:
    """A place and the brush, in the mouth's frame; m and N."""

    middle: jax.Array  # [N, 3]
    along: jax.Array  # [N, 3]
    normal: jax.Array  # [N, 3]
    goal: jax.Array  # [N, 3] where the brush should be at the stroke's end
    at: jax.Array  # [N] along the row, from its middle
    aside: jax.Array  # [N] across it, from where it should be
    force: jax.Array  # [N] of the brush on that row
    shown: jax.Array  # [N] bool: the head is turned and the mouth open as the place needs it
    left: jax.Array  # [N] of the way to that end
