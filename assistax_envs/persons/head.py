"""A person at the mouth: moves its head and jaw, and shows discomfort.

The same person as `controller`'s, with another body: its row has numbers of neck and jaw in place
of an arm's. It turns away from a tool that comes too near too soon, goes too deep, presses too hard
or rubs too fast, and leans towards one that is too far or too light. Its task's `HeadHelp` has the
rest. Shapes: N simulations; joints are those of the seat: trunk, pitch, yaw and roll of the neck,
jaw.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.models.care_scenes import OPEN, SEAT
from assistax_envs.persons import common, muscles, reaction, signs
from assistax_envs.persons.common import LATEST, LAWS, REACTS, SMOOTHED, Numbers
from assistax_envs.persons.rows import WIDTH, index, person_kind
from assistax_envs.registered import REGISTERED, load
from assistax_envs.tasks.base import human_joints
from assistax_envs.tasks.gentle_base import FELT, STEP
from assistax_envs.tasks.mouth import Comfort, Perceived
from assistax_envs.tasks.person import HeadHelp

JOINTS = len(SEAT)
LEAN, PITCH, YAW, ROLL, JAW = range(JOINTS)
AJAR = 0.05  # rad of the jaw, above which an open mouth is wanted
AIM, MOVED = 0.05, 0.03  # rad, of movements, as in `controller`
REFLEX = 0.25  # s that a bite reflex lasts
HELD = 0.5  # of the scene's springs, what a person of stiffness 1 adds against errors
LATE = 0.3  # of that, the share that waits for the delay
BACK, ASIDE = 0.05, 0.1  # rad, how far it leans at most for its first wish, and its second
STEADY = np.array([1.0, 1.0, 1.0, 1.0, 0.5], np.float32)  # share of noise: a jaw is light
WANDERS = (0.21, 0.13)  # Hz, of pitch and yaw


def _felt_error(error: jax.Array, late: jax.Array) -> jax.Array:
    return (1.0 - LATE) * error + LATE * late


def _late_error(error: jax.Array, late: jax.Array) -> jax.Array:
    return late


def _at_once(activation: jax.Array, torque: jax.Array, numbers: Numbers) -> jax.Array:
    return torque


# By family: the error of a posture, made of that of now and that of a delay ago; and the torques
# that follow a command. A muscle knows the late error alone, and follows late.
ERRORS = {"spring": _felt_error, "muscle": _late_error, "stepper": _felt_error}
PULLS = {"spring": _at_once, "muscle": muscles.followed, "stepper": _at_once}


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Mind:
    """The carry; every leaf has axis N first."""

    seed: jax.Array  # uint32, of the episode's chance
    age: jax.Array  # int32, steps
    past: jax.Array  # [N, 16, JOINTS + 6] what was perceived, newest first
    tool: jax.Array  # [N, 3] m, in the mouth's frame, a step ago
    moving: jax.Array  # m/s, of the tool there, smoothed
    reaction: reaction.Reaction
    signs: signs.Signs
    shown: jax.Array  # [N, 5] rad, how far it leans for what it likes
    stopped: jax.Array  # bool: hurt, and not yet willing again
    place: jax.Array  # int32: the stage, or the place on the teeth, that it knows of
    willing: jax.Array  # s, how ripe its wish to open or to turn is
    lapsed: jax.Array  # s until attention is back
    aim: jax.Array  # [N, 5] rad, where the movement goes
    begin: jax.Array  # [N, 5] rad, where it began
    way: jax.Array  # s since then
    time: jax.Array  # s that the movement takes
    intended: jax.Array  # [N, 5] rad
    held: jax.Array  # [N, 5] rad, the posture that muscles hold, of the family that steps
    activation: jax.Array  # [N, 5] N m, torques that muscles follow
    shaken: jax.Array  # [N, 5] correlated noise
    bitten: jax.Array  # s that a bite reflex still lasts
    tired: jax.Array  # share of strength that is gone


class Head:
    """The program of all persons of a task at the mouth."""

    def __init__(self, task: str, model: mujoco.MjModel) -> None:
        """Prepare for a task's scene."""
        self.task = task
        joints = [model.joint(f"human_{name}") for name in SEAT]
        read = human_joints(model)
        self.joints_read = np.array([read.index(joint.name) for joint in joints])
        # N m, with the sign of what is forward.
        self._gear = np.array([model.actuator(j.name).gear[0] for j in joints], np.float32)
        ids = [joint.id for joint in joints]
        self._range = np.array(model.jnt_range[ids], np.float32)
        self._spring = np.array(model.jnt_stiffness[ids], np.float32).reshape(-1)
        self._rest = np.array([model.qpos_spring[joint.qposadr[0]] for joint in joints], np.float32)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        # N m that hold head and jaw.
        self._weight = np.array(data.qfrc_bias[[j.dofadr[0] for j in joints]], np.float32)
        self._signing = signs.Signing(task)
        # The jaw shows a wish about the mouth's inside, and the roll of the neck one about speed.
        self._aside = JAW if "liked_depth" in index(task) else ROLL
        self._place, self._spared = index(task), REGISTERED[task].spared
        person = person_kind(task)
        self._columns, self._touch_unit = person.columns, person.touch_unit
        assert isinstance(person.help, HeadHelp)
        self._judge: Callable[[Perceived], Comfort] = load(person.help.feel)
        self._want: Callable[[Perceived], tuple[jax.Array, jax.Array]] = load(person.help.intend)

    def initial(self, n: int) -> Mind:
        """Return the carry of N persons before their first observation."""
        zero, none = jnp.zeros(n, jnp.float32), jnp.zeros((n, JOINTS), jnp.float32)
        return Mind(
            seed=jnp.zeros(n, jnp.uint32),
            age=jnp.zeros(n, jnp.int32),
            past=jnp.zeros((n, LATEST, JOINTS + 6 + 2 * self._signing.wishes), jnp.float32),
            tool=jnp.zeros((n, 3), jnp.float32),
            reaction=reaction.calm(n, JOINTS),
            signs=signs.silent(n, self._signing.wishes),
            stopped=jnp.zeros(n, bool),
            place=jnp.full(n, -1, jnp.int32),
            bitten=zero - 1.0,
            **dict.fromkeys(("moving", "willing", "lapsed", "way", "time", "tired"), zero),
            **dict.fromkeys(
                ("aim", "begin", "intended", "held", "shown", "activation", "shaken"), none
            ),
        )

    def act(
        self, row: jax.Array, mind: Mind, obs: jax.Array, first: jax.Array
    ) -> tuple[Mind, jax.Array]:
        """Return the new carry and the actions [N, 5]: shares of the seat's torques.

        Args:
            row: [N, 31] numbers of `PARAMETERS`, and the family.
            mind: the carry.
            obs: [N, O] what a human in the seat observes.
            first: [N] whether an episode begins: its carry is fresh.
        """
        numbers = common.numbers_of(row, self._place)
        names = ("tool", "progress", "touch", "flag")
        parts = {name: obs[:, self._columns[name]] for name in names}
        now = obs[:, self.joints_read]
        mind = self._begun(mind, row[:, :WIDTH], obs, parts, first)
        tool = 0.1 * parts["tool"]
        drift = jnp.linalg.norm(tool - mind.tool, axis=-1) / STEP
        moving = mind.moving + STEP / SMOOTHED * (drift - mind.moving)
        seen = [tool, self._touch_unit * parts["touch"], moving[:, None], parts["flag"]]
        if self._signing.wishes:
            seen.append(obs[:, self._columns["felt"]])
        newest = jnp.concatenate([now, *seen], axis=-1)
        past, late = common.remembered(mind.past, newest, numbers)
        mind = dataclasses.replace(mind, past=past, tool=tool, moving=moving)
        chance = common.uniform(mind.seed, mind.age, JOINTS + 1)
        place = parts["progress"].argmax(axis=1).astype(jnp.int32)
        perceived = self._perceived(mind, late, place, numbers)
        comfort = self._judge(perceived)
        felt = self._felt(perceived, comfort)
        reacting = common.by_family(LAWS, numbers, mind.reaction, felt, numbers)
        mind = dataclasses.replace(mind, reaction=reacting)
        mind = self._show(mind, late[:, JOINTS + 6 :], felt, numbers)
        mind = self._intend(mind, perceived, chance[:, JOINTS])
        return self.move(mind, now, late, numbers, common.normal(chance[:, :JOINTS]))

    def _begun(
        self, mind: Mind, row: jax.Array, obs: jax.Array, parts: Numbers, first: jax.Array
    ) -> Mind:
        """Return the carry, fresh where an episode begins; bits of the start seed its chance."""
        now = obs[:, self.joints_read]
        bits = jax.lax.bitcast_convert_type(jnp.concatenate([now, row], axis=1), jnp.uint32)
        fresh = self.initial(obs.shape[0])
        tool = 0.1 * parts["tool"]
        still = fresh.past.at[:, :, :JOINTS].set(now[:, None])
        still = still.at[:, :, JOINTS : JOINTS + 3].set(tool[:, None])
        still = still.at[:, :, JOINTS + 5].set(parts["flag"])
        fresh = dataclasses.replace(
            fresh,
            seed=common.seed_of(bits),
            past=still,
            tool=tool,
            place=parts["progress"].argmax(axis=1).astype(jnp.int32),
            aim=now,
            begin=now,
            intended=now,
            held=now,
        )
        return common.chosen(first, fresh, mind)

    def _perceived(
        self, mind: Mind, late: jax.Array, place: jax.Array, numbers: Numbers
    ) -> Perceived:
        """Return the perception of a delay ago, with the person's own state."""
        return Perceived(
            tool=late[:, JOINTS : JOINTS + 3],
            force=late[:, JOINTS + 3],
            moving=late[:, JOINTS + 4],
            flag=late[:, JOINTS + 5],
            place=place,
            before=mind.place,
            willing=mind.willing,
            aim=mind.aim,
            eager=0.5 + 0.5 * numbers["initiative"],
            numbers=numbers,
        )

    def _felt(self, now: Perceived, comfort: Comfort) -> reaction.Felt:
        """Return the touch of a delay ago, as the reaction takes it."""
        one = jnp.ones_like(now.force)
        # Away from the side from which the tool comes; a tool in front turns the head to the left,
        # since the robot stands at the right.
        side = jnp.where(now.tool[:, 1] > 0.01, -1.0, 1.0)
        forward = jnp.sign(self._gear[LEAN])
        away = jnp.stack([-0.3 * forward * one, -0.4 * one, 0.85 * side, 0 * one, 0 * one], -1)
        away = away * comfort.way[:, None]
        return reaction.Felt(
            force=now.force,
            hurts=now.numbers["tolerance"] * comfort.unit,
            liked=comfort.preferred,
            asks=comfort.unit,
            speed=comfort.speed,
            near=comfort.near,
            away=away,
        )

    def _show(self, mind: Mind, done: jax.Array, felt: reaction.Felt, numbers: Numbers) -> Mind:
        """Lean and speak by the distance of the touch, a delay ago, from the liked one."""
        if not self._signing.wishes:
            return mind
        stopped = mind.reaction.discomfort > numbers["limit"]
        shows, leans = self._signing.show(mind.signs, done, stopped, numbers, (mind.seed, mind.age))
        sign = -1.0 if self._aside == JAW else 1.0  # a mouth closes a little on what is too deep
        shown = BACK * leans[:, :1] * felt.away
        shown = shown.at[:, self._aside].add(sign * ASIDE * leans[:, 1])
        return dataclasses.replace(mind, signs=shows, shown=shown)

    def _intend(self, mind: Mind, now: Perceived, chance: jax.Array) -> Mind:
        """Decide where head and jaw should be, and move on towards it by minimum jerk."""
        numbers = now.numbers
        stopped = common.stopped(mind.stopped, mind.reaction.discomfort, numbers["limit"])
        lapsed = common.lapsed(mind.lapsed, chance, numbers)
        willing, wanted = self._want(now)
        willing = jnp.where(stopped, 0.0, willing)
        off = jnp.zeros_like(mind.aim)
        off = off.at[:, PITCH].set(numbers["belief_pitch"]).at[:, YAW].set(numbers["belief_yaw"])
        opened = wanted[:, JAW] > AJAR
        off = off.at[:, JAW].set(jnp.where(opened, numbers["belief_jaw"], 0.0))
        wanted = jnp.where(stopped[:, None], 0.0, wanted + off)
        # Another movement begins where another posture is wanted.
        starts = jnp.abs(wanted - mind.aim).max(axis=1) > MOVED
        aim = jnp.where(starts[:, None], wanted, mind.aim)
        begin = jnp.where(starts[:, None], mind.intended, mind.begin)
        far = jnp.abs(aim - begin).max(axis=1)
        fitts = REACTS + 0.5 * numbers["pace"] * jnp.log2(1.0 + far / AIM)
        time = jnp.where(starts, fitts, mind.time)
        way = common.under_way(mind.way, starts, lapsed)
        return dataclasses.replace(
            mind,
            stopped=stopped,
            place=now.place,
            willing=willing,
            lapsed=lapsed,
            aim=aim,
            begin=begin,
            way=way,
            time=time,
            intended=begin + (aim - begin) * common.minimum_jerk(way, time)[:, None],
        )

    def move(
        self, mind: Mind, now: jax.Array, late: jax.Array, numbers: Numbers, normal: jax.Array
    ) -> tuple[Mind, jax.Array]:
        """Return the carry and the actions [N, 5] that muscles, noise, tremor and reflexes make."""
        strength = (1.0 - (1.0 - self._spared) * (1.0 - numbers["strength"])) * (1.0 - mind.tired)
        most = strength[:, None] * jnp.abs(jnp.asarray(self._gear))[None]
        low, high = jnp.asarray(self._range.T)[:, None]
        time = STEP * mind.age.astype(jnp.float32)
        wander = jnp.zeros_like(now)
        for joint, hertz in zip((PITCH, YAW), WANDERS, strict=True):
            phase = 2.0 * np.pi * hertz * time + (mind.seed % 628).astype(jnp.float32) / 100.0
            wander = wander.at[:, joint].set(numbers["wander"] * jnp.sin(phase))
        intended = mind.intended + mind.reaction.shift + mind.shown
        intended = common.strides(mind.age, mind.held, intended, numbers)
        goal = jnp.clip(intended + wander, low, high)
        spring = jnp.asarray(self._spring)[None]
        loud = numbers["stiffness"] * (1.0 + mind.reaction.discomfort)
        error = common.by_family(ERRORS, numbers, goal - now, goal - late[:, :JOINTS])
        torque = spring * (goal - jnp.asarray(self._rest)[None] + HELD * loud[:, None] * error)
        torque = torque + jnp.asarray(self._weight)[None]
        torque = activation = common.by_family(PULLS, numbers, mind.activation, torque, numbers)
        shaken = common.shaken(mind.shaken, normal)
        torque = torque * (1.0 + numbers["noise"][:, None] * shaken * jnp.asarray(STEADY)[None])
        turn = 2.0 * np.pi * numbers["tremor_frequency"] * time
        trembles = np.array([0.0, 1.0, 1.0, 1.0, 0.5], np.float32)
        phases = np.array([0.0, 0.0, 0.7, 2.1, 1.4], np.float32)
        shake = jnp.sin(turn[:, None] + jnp.asarray(phases)[None]) * jnp.asarray(trembles)[None]
        torque = torque + numbers["tremor"][:, None] * most * shake
        # A touch in an open mouth may close it, once.
        touched = late[:, JOINTS + 3] > numbers["bite_onset"]
        begins = touched & (mind.bitten <= -1.0) & (now[:, JAW] > 0.25 * OPEN)
        bitten = jnp.where(begins, REFLEX, jnp.maximum(mind.bitten - STEP, -1.0))
        bitten = jnp.where(late[:, JOINTS + 3] > FELT, jnp.maximum(bitten, -0.98), bitten)
        reflex = numbers["bite_reflex"] * (bitten > 0.0)
        torque = torque.at[:, JAW].add(-reflex)
        torque = jnp.clip(torque, -most, most)
        mind = dataclasses.replace(
            mind,
            age=mind.age + 1,
            held=intended,
            activation=activation,
            shaken=shaken,
            bitten=bitten,
            tired=common.tired(mind.tired, torque, most, numbers),
        )
        return mind, torque / jnp.asarray(self._gear)[None]
