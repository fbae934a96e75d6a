"""A person at work: feels with a delay, reacts, intends, and pulls. A pure function of a carry.

Shapes: N simulations; a row [N, 31] for each, see `rows.marked`. One step is 20 ms.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax_envs.persons import common, muscles, reaction, signs
from assistax_envs.persons.body import JOINTS, Arm
from assistax_envs.persons.common import LATEST, LAWS, REACTS, SMOOTHED, numbers_of
from assistax_envs.persons.postures import Postures
from assistax_envs.persons.rows import WIDTH, index, person_kind
from assistax_envs.persons.senses import Senses, sense
from assistax_envs.registered import REGISTERED, TASK_CLASSES
from assistax_envs.tasks.base import unit
from assistax_envs.tasks.gentle_base import FELT, STEP
from assistax_envs.tasks.person_numbers import FOREARM

CALLED, ASKED = 2.0 / 3.0, 1.0 / 3.0  # initiative above which it waits for nothing, or a touch
LIMP = 0.1  # tone of an arm at rest
RISE, FALL = 0.1, 0.4  # s, of the tone
AIM = 0.1  # rad, how well a posture is aimed at
MOVED = 0.1  # rad, from where on another posture is worth a movement
SUSTAINED = 0.2  # s, over which effort stiffens an arm
REFLEX = 0.04  # s, over which stretching is felt by the reflex
SEARCHED = 128  # persons whose postures are searched at a time
SHOWN = 0.25  # rad, how far it leans at most to show that a touch is not as liked
PHASES = np.array([0.0, 0.7, 2.1], np.float32)  # rad: joints do not tremble as one

MUSCLES = {"spring": muscles.spring, "muscle": muscles.muscle, "stepper": muscles.spring}
ELBOW = np.array([0.0, 0.0, 1.0], np.float32)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Mind:
    """The carry; every leaf has axis N first."""

    seed: jax.Array  # uint32, of the episode's chance
    age: jax.Array  # int32, steps
    past: jax.Array  # [N, 16, 9 + 2W] what was perceived, newest first
    tool: jax.Array  # [N, 3] m, a step ago
    sliding: jax.Array  # m/s, smoothed
    reaction: reaction.Reaction
    signs: signs.Signs
    shown: jax.Array  # [N, 3] rad, how far it leans for what it likes
    touched: jax.Array  # bool, ever
    pushed: jax.Array  # bool, ever
    stopped: jax.Array  # bool: hurt, and not yet willing again
    willing: jax.Array  # s since it wanted to help, 0 if it does not
    lapsed: jax.Array  # s until attention is back
    helps: jax.Array  # bool
    help: jax.Array  # [N, 3] rad, the posture that helps as it believes
    begin: jax.Array  # [N, 3] rad, where the movement began
    way: jax.Array  # s since then
    time: jax.Array  # s that the movement takes
    intended: jax.Array  # [N, 3] rad
    held: jax.Array  # [N, 3] rad, the posture that muscles hold, of the family that steps
    tone: jax.Array  # 0 to 1
    effort: jax.Array  # [N, 3] N m, smoothed torque
    activation: jax.Array  # [N, 3, 2] of muscles
    shaken: jax.Array  # [N, 3] correlated noise
    stretch: jax.Array  # [N, 3] rad/s, smoothed velocity
    tired: jax.Array  # share of strength that is gone


class Controller:
    """The program of all persons of a task."""

    def __init__(self, task: str, model: mujoco.MjModel) -> None:
        """Prepare for a task's scene."""
        of_task: Any = TASK_CLASSES[task](model)
        self.task, self.arm = task, Arm(model, np.array(of_task.pose.angle, float))
        self.postures = Postures(task, self.arm)
        self._place, self._carried = index(task), "liked_distance" in index(task)
        self._spared = REGISTERED[task].spared
        self._signing = signs.Signing(task)
        self._asked = 0.5 if self._carried else 1.0  # share of the usual force that asks for help

    def initial(self, n: int) -> Mind:
        """Return the carry of N persons before their first observation."""
        zero, none = jnp.zeros(n, jnp.float32), jnp.zeros((n, JOINTS), jnp.float32)
        no, calm = jnp.zeros(n, bool), reaction.calm(n)
        return Mind(
            seed=jnp.zeros(n, jnp.uint32),
            age=jnp.zeros(n, jnp.int32),
            past=jnp.zeros((n, LATEST, 9 + 2 * self._signing.wishes), jnp.float32),
            tool=none,
            sliding=zero,
            reaction=calm,
            signs=signs.silent(n, self._signing.wishes),
            shown=none,
            touched=no,
            pushed=no,
            stopped=no,
            willing=zero,
            lapsed=zero,
            helps=no,
            help=none,
            begin=none,
            way=zero,
            time=zero,
            intended=none,
            held=none,
            tone=zero,
            effort=none,
            activation=jnp.zeros((n, JOINTS, 2), jnp.float32),
            shaken=none,
            stretch=none,
            tired=zero,
        )

    def act(
        self, row: jax.Array, mind: Mind, obs: jax.Array, first: jax.Array
    ) -> tuple[Mind, jax.Array]:
        """Return the new carry and the actions [N, 3]: shares of the seat's torques.

        Args:
            row: [N, 31] numbers of `PARAMETERS`, and the family.
            mind: the carry.
            obs: [N, O] what a human in the seat observes.
            first: [N] whether an episode begins: its carry is fresh.
        """
        numbers = numbers_of(row, self._place)
        strength = 1.0 - (1.0 - self._spared) * (1.0 - numbers["strength"])
        now = sense(self.task, obs)
        mind = self._begun(mind, row[:, :WIDTH], obs, now, first)
        mind = self._look(mind, now, numbers, strength)
        mind, felt, late, done = self._feel(mind, now, numbers)
        reacting = common.by_family(LAWS, numbers, mind.reaction, felt, numbers)
        mind = dataclasses.replace(mind, reaction=reacting)
        chance = common.uniform(mind.seed, mind.age, 2 * JOINTS)
        mind = self._show(mind, felt, done, numbers)
        mind = self._intend(mind, felt, now, numbers, chance[:, JOINTS])
        return self.move(mind, now, late, numbers, strength, common.normal(chance[:, :JOINTS]))

    def _begun(
        self, mind: Mind, row: jax.Array, obs: jax.Array, now: Senses, first: jax.Array
    ) -> Mind:
        """Return the carry, fresh in simulations whose episode begins.

        Its chance comes from the bits of the joints' start, which the episode's key drew and which
        are the same on every backend, and from those of the row.
        """
        start = obs[:, person_kind(self.task).columns["position"]]
        bits = jax.lax.bitcast_convert_type(jnp.concatenate([start, row], axis=1), jnp.uint32)
        fresh = self.initial(obs.shape[0])
        still = jnp.zeros_like(fresh.past).at[:, :, :JOINTS].set(now.position[:, None])
        still = still.at[:, :, JOINTS + 1 : JOINTS + 3].set(1.0)  # no sliding, no near robot
        fresh = dataclasses.replace(
            fresh,
            seed=common.seed_of(bits),
            past=still,
            tool=now.tool,
            intended=now.position,
            held=now.position,
            begin=now.position,
            tone=jnp.full_like(fresh.tone, LIMP),
        )
        return common.chosen(first, fresh, mind)

    def _look(
        self, mind: Mind, now: Senses, numbers: dict[str, jax.Array], strength: jax.Array
    ) -> Mind:
        """Search the posture that helps: at first, and again in tasks that say so.

        In training only a few simulations begin an episode at any step, and a search for all of
        them took 80% of a step of gentle scratch. Always `SEARCHED` at a time: sizes change no bit.
        """
        again = self.postures.help.again
        due = mind.age % again == 0 if again else mind.age == 0
        place = numbers.get("liked_place", jnp.zeros_like(strength))
        beliefs = [numbers[f"belief_{joint}"] for joint in ("shoulder1", "shoulder2", "elbow")]
        belief = jnp.stack(beliefs, axis=-1)
        low, high = jnp.asarray(self.arm.range.T)[:, None]
        everybody = due.shape[0]

        def search(loop: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            left, posture = loop
            who = jnp.nonzero(left, size=SEARCHED, fill_value=everybody)[0]
            asked = (now, strength, place, belief)
            senses, able, where, off = jax.tree.map(lambda leaf: leaf[who], asked)
            found = jnp.clip(self.postures.best(senses, able, where) + off, low, high)
            left = left.at[who].set(False, mode="drop")
            return left, posture.at[who].set(found, mode="drop")

        _, posture = jax.lax.while_loop(lambda loop: loop[0].any(), search, (due, mind.help))
        return dataclasses.replace(mind, help=posture)

    def _feel(
        self, mind: Mind, now: Senses, numbers: dict[str, jax.Array]
    ) -> tuple[Mind, reaction.Felt, jax.Array, jax.Array]:
        """Return carry, and of a delay ago: touch, joints' position [N, 3], wishes [N, 2W]."""
        away, slip = self.arm.touched_by(now.tool, mind.tool, now.position, now.velocity)
        touching = now.force > FELT
        keep = STEP / SMOOTHED
        sliding = mind.sliding + keep * (jnp.where(touching, slip, 0.0) - mind.sliding)
        speed = near = jnp.ones_like(slip)
        if self._carried:  # once the arm lies there, a robot that waits is too near or too far
            waits = ~touching & self.postures.there(now, numbers["liked_place"])
            near = jnp.where(waits, now.distance / numbers["liked_distance"], 1.0)
        else:
            speed = sliding / numbers["liked_speed"]
        parts = [now.position, now.force[:, None], speed[:, None], near[:, None], away, now.felt]
        newest = jnp.concatenate(parts, axis=-1)
        past, then = common.remembered(mind.past, newest, numbers)
        position, force, speed, near, away, done = jnp.split(then, (3, 4, 5, 6, 9), axis=1)
        force = force[:, 0]
        # A carried person prefers no force, and misses no pressure.
        usual = jnp.full_like(force, FOREARM) if self._carried else numbers["liked_force"]
        liked = jnp.zeros_like(usual) if self._carried else usual
        hurts, asks = numbers["tolerance"] * usual, self._asked * usual
        felt = reaction.Felt(force, hurts, liked, asks, speed[:, 0], near[:, 0], away)
        mind = dataclasses.replace(mind, past=past, sliding=sliding, tool=now.tool)
        return mind, felt, position, done

    def _show(
        self, mind: Mind, felt: reaction.Felt, done: jax.Array, numbers: dict[str, jax.Array]
    ) -> Mind:
        """Lean and speak by the distance of the touch, a delay ago, from the liked one."""
        if not self._signing.wishes:
            return mind
        stopped = mind.reaction.discomfort > numbers["limit"]
        shows, leans = self._signing.show(mind.signs, done, stopped, numbers, (mind.seed, mind.age))
        aside = unit(jnp.cross(felt.away, jnp.asarray(ELBOW)[None]))
        shown = SHOWN * (leans[:, :1] * felt.away + leans[:, 1:2] * aside)
        return dataclasses.replace(mind, signs=shows, shown=shown)

    def _intend(
        self,
        mind: Mind,
        felt: reaction.Felt,
        now: Senses,
        numbers: dict[str, jax.Array],
        chance: jax.Array,
    ) -> Mind:
        """Decide whether to help, and move on towards it: by minimum jerk, unless hurt."""
        initiative, discomfort = numbers["initiative"], mind.reaction.discomfort
        touched = mind.touched | (felt.force > FELT)
        pushed = mind.pushed | (felt.force > felt.asks)
        stopped = common.stopped(mind.stopped, discomfort, numbers["limit"])
        wants = (initiative >= CALLED) | ((initiative >= ASKED) & touched) | pushed
        willing = jnp.where(wants & ~stopped, mind.willing + STEP, 0.0)
        helps = willing > numbers["slow_start"]
        lapsed = common.lapsed(mind.lapsed, chance, numbers)
        # Another movement begins with help, and where another posture would help more.
        aside = jnp.abs(mind.help - mind.intended).max(axis=1)
        arrived = mind.way >= mind.time
        starts = (helps & ~mind.helps) | (helps & arrived & (aside > MOVED))
        time = REACTS + numbers["pace"] * jnp.log2(1.0 + aside / AIM)
        begin = jnp.where(starts[:, None], mind.intended, mind.begin)
        way = common.under_way(mind.way, starts, lapsed)
        time = jnp.where(starts, time, mind.time)
        planned = begin + (mind.help - begin) * common.minimum_jerk(way, time)[:, None]
        # An arm that does nothing intends to be where it is.
        idle = mind.intended + STEP / FALL * (now.position - mind.intended)
        work = jnp.maximum(
            helps, jnp.clip(jnp.maximum(discomfort, mind.reaction.lightness), LIMP, 1.0)
        )
        tone = mind.tone + jnp.where(work > mind.tone, STEP / RISE, STEP / FALL) * (
            work - mind.tone
        )
        return dataclasses.replace(
            mind,
            touched=touched,
            pushed=pushed,
            stopped=stopped,
            willing=willing,
            lapsed=lapsed,
            helps=helps,
            begin=begin,
            way=way,
            time=time,
            intended=jnp.where(helps[:, None], planned, idle),
            tone=tone,
        )

    def move(
        self,
        mind: Mind,
        now: Senses,
        late: jax.Array,
        numbers: dict[str, jax.Array],
        strength: jax.Array,
        normal: jax.Array,
    ) -> tuple[Mind, jax.Array]:
        """Return the carry and the actions [N, 3] that muscles, noise and tremor make."""
        most = (strength * (1.0 - mind.tired))[:, None] * jnp.asarray(self.arm.torque)[None]
        low, high = jnp.asarray(self.arm.range.T)[:, None]
        intended = mind.intended + mind.reaction.shift + mind.shown
        intended = common.strides(mind.age, mind.held, intended, numbers)
        command = muscles.Command(
            intended=jnp.clip(intended, low, high),
            position=now.position,
            late=late,
            velocity=now.velocity,
            weight=numbers["gravity"][:, None] * self.arm.gravity(now.position),
            tone=mind.tone,
            discomfort=mind.reaction.discomfort,
            effort=mind.effort,
            most=most,
        )
        pulls = command, mind.activation, numbers, self.arm.damping
        activation, torque = common.by_family(MUSCLES, numbers, *pulls)
        stretch = mind.stretch + STEP / REFLEX * (now.velocity - mind.stretch)
        torque = torque + muscles.spasticity(numbers, stretch)
        shaken = common.shaken(mind.shaken, normal)
        torque = torque * (1.0 + numbers["noise"][:, None] * shaken)
        turn = 2.0 * np.pi * numbers["tremor_frequency"] * STEP * mind.age
        shake = jnp.sin(turn[:, None] + jnp.asarray(PHASES)[None])
        torque = torque + (numbers["tremor"] * mind.tone)[:, None] * most * shake
        torque = jnp.clip(torque, -most, most)
        mind = dataclasses.replace(
            mind,
            age=mind.age + 1,
            held=intended,
            effort=mind.effort + STEP / SUSTAINED * (torque - mind.effort),
            activation=activation,
            shaken=shaken,
            stretch=stretch,
            tired=common.tired(mind.tired, torque, most, numbers),
        )
        return mind, torque / jnp.asarray(self.arm.torque)[None]
