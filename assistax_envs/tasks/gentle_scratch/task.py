"""Gentle scratch: strokes to and fro over an itch, at the liked force and speed.

The itch is a line of 2 cm along the arm. The tool goes from one end to the other and back, in
contact. Most itches lie where the tool cannot come while the arm rests: the human has to turn or
lift it.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.tasks import care
from assistax_envs.tasks.base import (
    ARM_SEGMENTS,
    Measures,
    Pose,
    observations,
    rotate,
    segment_points,
)
from assistax_envs.tasks.gentle_base import (
    FELT,
    ROUGHNESS,
    SOFT,
    STEP,
    Preferences,
    TouchReadings,
    TouchSensors,
    along_skin,
    episode_preferences,
    in_segment,
    roughness,
    with_preference,
)
from assistax_envs.tasks.scratch.task import START

HALF = 0.01  # m, from the itch to either end, along the arm
AT_END = 0.005  # m over the skin, how near the tool comes to an end: strokes are longer than 1 cm
OFF_END = (
    0.02  # m, how far the middle of the tool's round tip, of radius 1 cm, may be from an end in all
)
STROKE = 0.012  # m, way of a stroke: what a liked speed means in time
# Degrees about each segment's axis, where itches lie: inside of `scratch.person.HIDDEN`. Of 1,536
# itches there the script scratches 24% with a human that does nothing, near the arcs' ends; in
# these arcs it scratches 1%.
ARCS = ((110.0, 165.0), (175.0, 285.0))
# Liked strokes that are success, within 1.5 of the liked force and time: half of those that the
# slowest wish leaves time for.
ENOUGH = 12


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class StrokeState:
    """Place of the itch, and progress of the strokes."""

    segment: jax.Array  # int32 index into ARM_SEGMENTS
    offset: jax.Array  # [3] of the itch in the segment's frame, m
    side: jax.Array  # +1 or -1: the end that the tool goes to
    last: jax.Array  # [3] tool a step ago, in the segment's frame; NaN before the first step
    distance: jax.Array  # m, to that end a step ago
    time: jax.Array  # steps that this stroke has taken
    liked: jax.Array  # sum over them of how well the human liked the force
    pressed: jax.Array  # sum over them of the logarithm of the force in touch
    touched: jax.Array  # steps of them in touch
    speed: jax.Array  # m/s, of the last stroke; 0 before the first
    strokes: jax.Array  # int32, done
    well: jax.Array  # int32, of these liked ones
    care: care.Care
    preference: Preferences


class GentleScratch:
    """Progress to the stroke's end, and for each stroke as many points as steps it should take.

    A stroke of time T that should take T* pays T* liked(T; T*) mean(liked(F; F*)): 1 a step at the
    liked force and speed, whatever they are. Pay for speed itself teaches trembling, and a fixed
    pay teaches haste.
    """

    name = scene = "gentle_scratch"
    stops: ClassVar = True
    target_colours: ClassVar = {"itch": (0.95, 0.05, 0.55, 1.0), "ends": (0.05, 0.20, 0.75, 1.0)}

    def __init__(
        self,
        model: mujoco.MjModel,
        weights: dict[str, float] | None = None,
        hard: float = 1.0,
        told: tuple[str, ...] = ("human",),
    ) -> None:
        """Prepare.

        Args:
            model: The scene.
            weights: Of reward terms, in place of the task's own.
            hard: Share of itches out of reach while the arm rests.
            told: Roles that observe the preference.
        """
        terms = {"progress": 20.0, "stroke": 1.0}
        self.weights = terms | ROUGHNESS | care.COSTS | {"violation": 20.0} | (weights or {})
        self.pose = Pose(model, START)
        self.sensors = TouchSensors(model, self.pose)
        self._hard, self._told = hard, told
        sites = [model.site(f"human_{segment}") for segment in ARM_SEGMENTS]
        self._radius = np.array([site.size[0] for site in sites], np.float32)
        self._half_length = np.array([site.size[1] for site in sites], np.float32)

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, StrokeState]:
        """Draw the start pose [nq], the itch and, unless it is given, the preference."""
        pose_key, itch_key, side_key, preference_key = jax.random.split(key, 4)
        segment, offset = self._itch(itch_key)
        nan, zero = jnp.full(3, jnp.nan, jnp.float32), jnp.zeros((), jnp.float32)
        state = StrokeState(
            segment=segment,
            offset=offset,
            side=jnp.where(jax.random.bernoulli(side_key), 1.0, -1.0),
            last=nan,
            distance=zero,
            time=zero,
            liked=zero,
            pressed=zero,
            touched=zero,
            speed=zero,
            strokes=jnp.zeros((), jnp.int32),
            well=jnp.zeros((), jnp.int32),
            care=care.untouched(self.scene, params),
            preference=episode_preferences(params, preference_key),
        )
        return self.pose.draw(pose_key), state

    def targets(self, task_state: StrokeState, readings: TouchReadings) -> dict[str, jax.Array]:
        """See `Task.targets`: the itch and its ends."""
        s = task_state
        ends = [segment_points(readings, s.segment, _end(s, side)) for side in (1.0, -1.0)]
        itch = segment_points(readings, s.segment, s.offset)
        return {"itch": itch[:, None], "ends": jnp.stack(ends, axis=1)}

    def transition(
        self, task_state: StrokeState, readings: TouchReadings
    ) -> tuple[StrokeState, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """See `Task.transition`; the goal holds after enough liked strokes without a violation."""
        s, r = task_state, readings
        tool = in_segment(r, s.segment, r.tool_position)
        first = jnp.isnan(s.last[:, 0])
        step = jnp.where(first[:, None], 0.0, tool - s.last)
        touching = r.on_arm > FELT
        to_end = _end(s, s.side) - tool
        distance = jnp.linalg.norm(to_end, axis=-1)
        near = (along_skin(to_end, tool) < AT_END) & (distance < OFF_END)
        arrived = touching & (r.force < SOFT) & near
        time = s.time + 1.0
        felt = self._felt(s, r, touching)
        liked = s.liked + touching * care.liked(felt.done[:, 0], s.preference.force, felt.width)
        pressed = s.pressed + touching * jnp.log(jnp.maximum(felt.done[:, 0], FELT))
        touched = s.touched + touching
        best = STROKE / s.preference.speed / STEP  # steps
        well = arrived & care.within(time, best)
        well &= care.within(jnp.exp(pressed / jnp.maximum(touched, 1.0)), s.preference.force)
        terms = {
            "progress": jnp.where(first, 0.0, s.distance - distance),
            "stroke": arrived * best * care.liked(time, best, felt.width) * liked / time,
        }
        terms |= roughness(r, felt.violated) | care.costs(felt)
        after = dataclasses.replace(
            s,
            side=jnp.where(arrived, -s.side, s.side),
            last=tool,
            time=jnp.where(arrived, 0.0, time),
            liked=jnp.where(arrived, 0.0, liked),
            pressed=jnp.where(arrived, 0.0, pressed),
            touched=jnp.where(arrived, 0.0, touched),
            speed=jnp.where(arrived, STROKE / (STEP * time), s.speed),
            strokes=s.strokes + arrived,
            well=s.well + well,
            care=felt,
        )
        goal, left = self._goal(after, r, step, time)
        # The human alone feels how well the force fits: a robot that observed it would be told.
        seen = jnp.column_stack([liked / time, s.preference.observed(self.scene)])
        obs = with_preference(
            observations(r, *goal), care.felt_by(felt, self.scene), seen, self._told
        )
        done, wishes = after.well >= ENOUGH, s.preference.of(self.scene)
        return (
            dataclasses.replace(after, distance=left),
            obs,
            terms,
            care.measures(felt, r, distance, done, wishes),
        )

    def _felt(self, s: StrokeState, r: TouchReadings, touching: jax.Array) -> care.Care:
        """Return the care after a step: of the force, and of the last stroke's speed."""
        sample, judged = (r.on_arm, s.speed), (touching, touching & (s.speed > 0.0))
        given = s.care, self.scene, s.preference, r
        return care.after(*given, sample, judged, s.preference.force)

    def _goal(
        self, s: StrokeState, r: TouchReadings, step: jax.Array, time: jax.Array
    ) -> tuple[tuple[jax.Array, ...], jax.Array]:
        """Return the observed parts of the goal, and the distance [N] to the next end."""
        row = jnp.arange(s.side.shape[0])
        turn = r.arm_orientation[row, s.segment]
        towards = segment_points(r, s.segment, _end(s, s.side)) - r.tool_position
        left = jnp.linalg.norm(towards, axis=-1)
        outward = s.offset.at[:, 2].set(0.0)
        outward = outward / jnp.linalg.norm(outward, axis=-1, keepdims=True)
        goal = (
            towards,
            left[:, None],
            10.0
            * jnp.clip(
                towards, -0.03, 0.03
            ),  # the last centimetres once more, large enough to be seen
            rotate(turn, outward),
            rotate(turn, step) / STEP,  # m/s, over the skin
            r.force[:, None] / 10.0,
            jnp.minimum(time, 50.0)[:, None] / 25.0,
            jnp.minimum(s.strokes, ENOUGH)[:, None] / ENOUGH,
        )
        return goal, left

    def _itch(self, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Draw an itch on the skin of upper or lower arm: segment and offset [3]."""
        segment_key, side_key, along_key, around_key = jax.random.split(key, 4)
        area = self._radius * self._half_length
        segment = jax.random.categorical(segment_key, jnp.log(area)).astype(jnp.int32)
        hidden = jax.random.bernoulli(side_key, self._hard)
        low, high = jnp.moveaxis(jnp.asarray(ARCS)[segment], -1, 0)
        share = jax.random.uniform(around_key)
        angle = jnp.where(hidden, low + share * (high - low), high + share * (360.0 - high + low))
        along = jax.random.uniform(along_key, minval=-1.0, maxval=1.0)
        around = jnp.stack([jnp.cos(jnp.deg2rad(angle)), jnp.sin(jnp.deg2rad(angle))])
        half = jnp.asarray(self._half_length)[segment] - HALF
        return segment, jnp.append(jnp.asarray(self._radius)[segment] * around, along * half)


def _end(s: StrokeState, side: jax.Array | float) -> jax.Array:
    """Return the end of the itch on a side, [N, 3] in the segment's frame."""
    return s.offset.at[:, 2].add(HALF * side)
