"""Gentle feeding: a spoon waits before the mouth, comes in level, is closed upon, and leaves.

Neither can do it alone: the robot cannot open the mouth, and the human cannot reach the spoon. The
human likes a distance at which the spoon waits and a depth to which it comes; the robot has to
find them out. The mouth opens when the human wants it to.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.models.care_scenes import LIPS, OPEN
from assistax_envs.tasks import care
from assistax_envs.tasks.base import ROBOT_JOINTS, Measures, Pose, observations
from assistax_envs.tasks.gentle_base import (
    ROUGHNESS,
    Preferences,
    episode_preferences,
    roughness,
    with_preference,
)
from assistax_envs.tasks.mouth import (
    BESIDE,
    ENTERING,
    FARTHEST,
    FULL,
    LEAVING,
    OPENED,
    SLOWLY,
    TAKING,
    UNIT,
    WAITING,
    MouthReadings,
    MouthSensors,
)

# The robot's joints, rad, from 25 cm before the lips to 3 cm behind them: a bowl level on the
# mouth's axis.
WAY = (
    (-0.126, -1.162, -0.238, -2.590, -0.086, 1.948, 0.517),
    (-0.082, -1.046, -0.182, -2.562, -0.056, 2.039, 0.582),
    (-0.047, -0.919, -0.129, -2.515, -0.031, 2.120, 0.641),
    (-0.023, -0.785, -0.081, -2.450, -0.012, 2.188, 0.694),
    (-0.007, -0.649, -0.034, -2.366, -0.001, 2.241, 0.745),
    (0.001, -0.512, 0.009, -2.266, -0.001, 2.278, 0.797),
    (0.006, -0.430, 0.033, -2.199, -0.008, 2.292, 0.829),
)
START = {joint: (angle, -0.08, 0.08) for joint, angle in zip(ROBOT_JOINTS, WAY[0], strict=True)}
START |= {f"human_neck_{way}": (0.0, -0.05, 0.05) for way in ("pitch", "yaw", "roll")}
# m before the lips, at each row of `WAY`. Episodes start anywhere on the way in, and on the way
# back until it is 10 cm away.
WAY_OUT = (0.25, 0.2, 0.15, 0.1, 0.05, 0.0, -0.03)
BEFORE = 0.02  # m before the lips, from where on a spoon waits, and does not enter yet
HALF = 0.25  # rad of the jaw: open for a bowl
CLOSING = 0.35  # rad: above it no mouth has closed on a bowl, however low that lies
SHUT = 0.12  # rad: below it the mouth was closed between two bites
SHALLOW, DEEP = 0.01, 0.03  # m behind the lips, where the bowl is in the mouth
INSIDE = 0.02  # m: depth that targets and progress take
ASIDE = 0.01  # m from the mouth's axis
STILL = 0.05  # m/s
SMOOTH = 0.1  # share of a step's velocity or force in the smoothed one: over 0.2 s
LEVEL, SPILT = 0.966, 0.866  # cosines of 15 and 30 degrees
SERVE, BITE = 15, 10  # steps: 0.3 s still in the mouth, 0.2 s between the lips
SOFTEST, HARDEST = 0.5, 5.0  # N of either lip on the bowl, smoothed over 0.2 s
GONE = 0.08  # m before the lips
ASKED, MEAL = 3, 6  # bites as liked that are success, and bites that are paid
OUTSIDE = 0.16  # m before the lips, nearer than which no approach is paid
JAW_WAY = 0.2  # m of a stage's way that a radian of the jaw counts for


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FeedState:
    """Progress of the meal and of its present bite."""

    bites: jax.Array  # int32
    stage: jax.Array  # int32: WAITING to FULL
    held: jax.Array  # int32, steps that a stage's condition held, less those that it did not
    shut: jax.Array  # bool: the mouth was closed since the last bite
    drift: jax.Array  # [3] m/s, the bowl's smoothed velocity
    bitten: jax.Array  # N, the smoothed force of a lip on it
    left: jax.Array  # m of this stage's way a step ago; NaN before its first step
    earned: jax.Array  # what this bite has paid: a spill takes it back
    tilted: jax.Array  # bool: the last step spilt
    waited: jax.Array  # bool: the spoon of this bite waited as liked
    served: jax.Array  # bool: it came in as deep as liked
    well: jax.Array  # int32, bites as liked
    care: care.Care
    preference: Preferences


class AtMouth:
    """Base of tasks at the mouth: the start of an episode, sensors and weights."""

    stops: ClassVar = True
    terms: ClassVar[dict[str, float]]  # weights of its own reward terms
    felt: ClassVar[tuple[str, ...]] = LIPS  # see `MouthSensors`

    def __init__(
        self,
        model: mujoco.MjModel,
        weights: dict[str, float] | None = None,
        told: tuple[str, ...] = ("human",),
    ) -> None:
        # Humans lean forward to eat, or to have their teeth brushed: a bent trunk costs nothing.
        self.weights = self.terms | ROUGHNESS | care.COSTS
        self.weights |= {"trunk": 0.0, "violation": 20.0} | (weights or {})
        self.pose = Pose(model, START)
        self.sensors = MouthSensors(model, self.pose, self.felt)
        self._told = told
        self._robot = np.array([model.joint(name).qposadr[0] for name in ROBOT_JOINTS])
        self._jaw = int(model.joint("human_jaw").qposadr[0])


class GentleFeeding(AtMouth):
    """Pay for each stage of a bite as it is liked, and for its way; a spill takes it back."""

    name = scene = "gentle_feeding"
    target_colours: ClassVar = {"mouth": (0.95, 0.05, 0.55, 0.6)}

    terms: ClassVar = {
        "progress": 100.0,
        "open": 20.0,
        "serve": 20.0,
        "take": 10.0,
        "leave": 20.0,
        "hold": 5.0,
        "level": 0.1,
        "spill": 10.0,
    }

    def reset(self, key: jax.Array, params: Any) -> tuple[jax.Array, FeedState]:
        """Draw the start pose [nq] and, unless it is given, the preference."""
        pose_key, preference_key, start_key = jax.random.split(key, 3)
        place = jax.random.uniform(start_key, maxval=1.5 * (len(WAY) - 1))
        back = place > len(WAY) - 1
        place = jnp.where(back, 2 * (len(WAY) - 1) - place, place)
        out = jnp.interp(place, jnp.arange(len(WAY)), jnp.asarray(WAY_OUT, jnp.float32))
        arm = arm_at(place)
        pose = self.pose.draw(pose_key)
        # Near the mouth there is less room for noise.
        noise = (pose - self.pose.angle)[self._robot] * jnp.maximum(out, 0.0) / WAY_OUT[0]
        pose = pose.at[self._robot].set(arm + noise)
        inward = jnp.where(out < BEFORE, ENTERING, WAITING)
        outward = jnp.where(out < -SHALLOW, TAKING, jnp.where(out < GONE, LEAVING, WAITING))
        stage = jnp.where(back, outward, inward).astype(jnp.int32)
        pose = pose.at[self._jaw].set(jnp.where(stage == WAITING, 0.0, OPENED))
        zero = jnp.zeros((), jnp.int32)
        return pose, FeedState(
            bites=zero,
            stage=stage,
            held=zero,
            shut=jnp.ones((), bool),
            drift=jnp.zeros(3, jnp.float32),
            bitten=jnp.zeros((), jnp.float32),
            left=jnp.full((), jnp.nan, jnp.float32),
            earned=jnp.zeros((), jnp.float32),
            tilted=jnp.zeros((), bool),
            waited=jnp.zeros((), bool),
            served=jnp.zeros((), bool),
            well=zero,
            care=care.untouched(self.scene, params),
            preference=episode_preferences(params, preference_key),
        )

    def targets(self, task_state: FeedState, readings: MouthReadings) -> dict[str, jax.Array]:
        """See `Task.targets`: the way into the mouth."""
        way = [readings.mouth_position + out * readings.forward for out in (GONE, -INSIDE)]
        return {"mouth": jnp.stack(way, axis=1)}

    def transition(
        self, task_state: FeedState, readings: MouthReadings
    ) -> tuple[FeedState, dict[str, jax.Array], dict[str, jax.Array], Measures]:
        """See `Task.transition`; the goal holds after three bites as liked."""
        s, r = task_state, readings
        out, aside = r.bowl[:, 0], jnp.linalg.norm(r.bowl[:, 1:], axis=-1)
        drift = s.drift + SMOOTH * (r.tool_velocity - s.drift)
        speed = jnp.linalg.norm(drift, axis=-1)
        bitten = s.bitten + SMOOTH * (r.felt.max(axis=1) - s.bitten)
        shut = s.shut | (r.jaw < SHUT)
        held, done = self._done(s, r, out, aside, speed, bitten, shut)
        spilt = (r.level < SPILT) & (s.stage < LEAVING)
        passed = [done & (s.stage == stage) & ~spilt for stage in range(FULL)]
        felt = self._felt(s, r, out, aside, speed, shut)
        best = s.preference.of(self.scene)
        liked = care.paid(care.liked(felt.done, best, felt.width[:, None]))
        within = care.within(felt.done, best)
        waited = jnp.where(passed[WAITING], within[:, 0], s.waited)
        served = jnp.where(passed[ENTERING], within[:, 1], s.served)
        stage, bites = self._next(s, done, spilt)
        changed, first = stage != s.stage, jnp.isnan(s.left)
        left = _left(s.stage, r, out, aside)
        pay = _pay(passed, liked) | {
            "progress": jnp.where(first | (s.stage == FULL), 0.0, s.left - left),
            "hold": (held - s.held) / jnp.where(s.stage == ENTERING, SERVE, BITE),
        }
        # A tilted spoon spills once, until it is level again.
        charged = spilt & ~s.tilted
        earned = s.earned + sum(self.weights[name] * paid for name, paid in pay.items())
        terms = (
            pay
            | {
                "level": -jnp.clip((1.0 - r.level) / (1.0 - SPILT), 0.0, 1.0),
                "spill": charged * (-1.0 - jnp.maximum(s.earned, 0.0) / self.weights["spill"]),
            }
            | roughness(r, felt.violated)
            | care.costs(felt)
        )
        state = FeedState(
            bites=bites,
            stage=stage,
            held=jnp.where(changed, 0, held),
            shut=jnp.where(passed[LEAVING] | spilt, False, shut),
            drift=drift,
            bitten=bitten,
            left=jnp.where(changed, jnp.nan, left),
            earned=jnp.where(passed[LEAVING] | spilt, 0.0, earned),
            tilted=spilt,
            waited=waited,
            served=served,
            well=s.well + (passed[LEAVING] & s.waited & s.served),
            care=felt,
            preference=s.preference,
        )
        obs, goal = self._observed(state, r, speed), state.well >= ASKED
        return state, obs, terms, care.measures(felt, r, jnp.abs(out) + aside, goal, best)

    def _felt(
        self,
        s: FeedState,
        r: MouthReadings,
        out: jax.Array,
        aside: jax.Array,
        speed: jax.Array,
        shut: jax.Array,
    ) -> care.Care:
        """Return the care after a step: of a spoon that waits, and of a bowl in the mouth."""
        waits = (s.stage == WAITING) & shut & _before(out, aside, speed)
        inside = ((s.stage == ENTERING) | (s.stage == TAKING)) & (out < -SHALLOW)
        sample, judged = (jnp.maximum(out, 0.0), jnp.maximum(-out, 0.0)), (waits, inside)
        return care.after(s.care, self.scene, s.preference, r, sample, judged, UNIT)

    def _done(
        self,
        s: FeedState,
        r: MouthReadings,
        out: jax.Array,
        aside: jax.Array,
        speed: jax.Array,
        bitten: jax.Array,
        shut: jax.Array,
    ) -> tuple[jax.Array, jax.Array]:
        """Return the steps [N] that the stage's condition held, and whether the stage is done."""
        opened = shut & _before(out, aside, speed) & (r.jaw > HALF)
        there = (out < -SHALLOW) & (out > -DEEP) & (aside < ASIDE) & (r.level > LEVEL)
        served = there & (r.jaw > HALF) & (speed < STILL)
        taken = (bitten > SOFTEST) & (bitten < HARDEST) & (out < 0.0) & (r.jaw < CLOSING)
        holds = jnp.where(s.stage == ENTERING, served, (s.stage == TAKING) & taken)
        held = jnp.where(holds, s.held + 1, jnp.maximum(s.held - 1, 0))
        done = jnp.stack([opened, held >= SERVE, held >= BITE, out > GONE, jnp.zeros_like(shut)])
        return held, done[s.stage, jnp.arange(out.shape[0])]

    def _next(self, s: FeedState, done: jax.Array, spilt: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the stage and the bites after this step [N]."""
        bites = s.bites + (done & (s.stage == LEAVING))
        again = jnp.where(bites >= MEAL, FULL, WAITING)
        stage = jnp.where(done, jnp.where(s.stage == LEAVING, again, s.stage + 1), s.stage)
        return jnp.where(spilt, WAITING, stage).astype(jnp.int32), bites.astype(jnp.int32)

    def _observed(
        self, state: FeedState, r: MouthReadings, speed: jax.Array
    ) -> dict[str, jax.Array]:
        """Return the observations of all roles after a step."""
        goal = (
            r.bowl * 10.0,
            r.up,
            r.jaw[:, None] / OPEN,
            jax.nn.one_hot(state.stage, FULL + 1),
            state.shut[:, None].astype(jnp.float32),
            state.held[:, None] / SERVE,
            state.bites[:, None] / MEAL,
            r.force[:, None] / 10.0,
            state.bitten[:, None] / HARDEST,
            speed[:, None] * 10.0,
        )
        obs = observations(r, *goal, body=(r.mouth_position, r.forward))
        felt = care.felt_by(state.care, self.scene)
        return with_preference(obs, felt, state.preference.observed(self.scene), self._told)


def _pay(passed: list[jax.Array], liked: jax.Array) -> dict[str, jax.Array]:
    """Return the pay [N] of stages that are passed [N] now, by how well they are liked [N, 2]."""
    return {
        "open": passed[WAITING] * liked[:, 0],
        "serve": passed[ENTERING] * liked[:, 1],
        "take": passed[TAKING].astype(jnp.float32),
        "leave": passed[LEAVING].astype(jnp.float32),
    }


def _left(stage: jax.Array, r: MouthReadings, out: jax.Array, aside: jax.Array) -> jax.Array:
    """Return the rest of the stage's way [N], m; a jaw in the wrong place adds to it."""
    inside = jnp.linalg.norm(r.bowl + jnp.array([INSIDE, 0.0, 0.0])[None], axis=-1)
    far = jnp.maximum(jnp.linalg.norm(r.bowl, axis=-1), OUTSIDE) + aside
    ways = jnp.stack(
        [
            far,
            inside + JAW_WAY * jnp.maximum(OPENED - r.jaw, 0.0),
            inside + JAW_WAY * jnp.maximum(r.jaw - SHUT, 0.0),
            jnp.maximum(GONE - out, 0.0),
            jnp.zeros_like(out),
        ]
    )
    return ways[stage, jnp.arange(out.shape[0])]


def _before(out: jax.Array, aside: jax.Array, speed: jax.Array) -> jax.Array:
    """Return whether a spoon waits before the mouth [N]."""
    return (out > BEFORE) & (out < FARTHEST) & (aside < BESIDE) & (speed < SLOWLY)


def arm_at(place: jax.Array, rows: int = len(WAY)) -> jax.Array:
    """Return the robot's joints [7] at a place on the first rows of `WAY`, between two of them."""
    way = jnp.asarray(WAY, jnp.float32)[:rows]
    return jnp.stack([jnp.interp(place, jnp.arange(rows), joint) for joint in way.T])
