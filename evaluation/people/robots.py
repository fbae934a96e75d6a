"""Robots of logs: published ones, the scripts of tasks, and the scripts that are told the wish."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Float32

from assistax_base.digest import sha256
from assistax_base.errors import ZooError
from assistax_envs.own_settings import own_settings
from assistax_envs.tasks.chain import told_script_of
from evaluation.cast.roster import Member, registry_roster
from evaluation.figures.normalised import SCRIPT
from evaluation.people.log import WITH_WISHES, LogError, Robot
from evaluation.people.playing import AT_ONCE, environment
from evaluation.play.baselines import script_roster
from population.networks.seat import Seat
from zoo.registry import Registry
from zoo.schema import PolicyEntry


@dataclasses.dataclass(frozen=True, eq=False)
class SeatRobot:
    """A robot that visitors played with."""

    member: Member  # its digest is of its parameters, or of the script's code
    player: Any  # a `population.networks.seat.Player`
    params: Any
    card: PolicyEntry | None = None  # None for a script

    @property
    def name(self) -> str:
        """The name that logs have for it."""
        return self.member.id

    def params_for(self, wishes: jax.Array) -> Any:
        """Return the parameters with which it plays with humans of some wishes [N, W]."""
        return {"wishes": wishes} if self.name == WITH_WISHES else self.params

    @own_settings()
    def actions(
        self, seen: Float32[np.ndarray, "T N O"], wishes: Float[np.ndarray, "N W"]
    ) -> Float32[np.ndarray, "T N A"]:
        """Return the actions of N whole episodes, with the robot's memory.

        Args:
            seen: What it observed before each step.
            wishes: What the visitors like, in the order of the task's preferences; a script that
                is told them uses them, and no other robot.
        """
        count = seen.shape[1]
        short = -count % AT_ONCE  # filled up, so that one program is compiled for all
        seen = np.pad(seen, ((0, 0), (0, short), (0, 0)), mode="edge")
        wishes = np.pad(wishes, ((0, short), (0, 0)), mode="edge")
        params = self.params_for(jnp.asarray(wishes, jnp.float32))
        return np.asarray(_program(self.player)(params, jnp.asarray(seen)))[:, :count]


class ToldScript:
    """Player of a task's script that is told what the human likes."""

    def __init__(self, task: str) -> None:
        self._robot = told_script_of(task, environment(task).model)

    def initial_carry(self, batch_shape: tuple[int, ...]) -> tuple[()]:
        """Return the empty carry."""
        return ()

    def act(
        self, params: Any, carry: tuple[()], obs: jax.Array, first: jax.Array
    ) -> tuple[tuple[()], jax.Array]:
        """Return actions [N, A] for observations [N, O]; `params` holds "wishes" [N, W]."""
        return carry, self._robot(obs, params["wishes"])


def robot_of(task: str, named: Robot, registry: Registry) -> SeatRobot:
    """Return the robot that a log names.

    Raises:
        LogError: There is no such robot of the task, or it has another hash.
    """
    if named.name in (SCRIPT, WITH_WISHES):
        return _script(task, named.name)
    try:
        entries = registry.select(named.name, role="robot")
        [entry] = [entry for entry in entries if (entry.id, entry.task) == (named.name, task)]
        roster = registry_roster(registry, [entry])
    except ZooError as error:
        raise LogError(f"its robot {named.name!r} was not loaded ({error})") from None
    except ValueError:
        raise LogError(
            f"its robot is {named.name!r}, which is no id of a robot of {task}; `assistax-zoo list "
            f"'{task}/*/robot'` prints them"
        ) from None
    if entry.sha256 != named.sha256:
        raise LogError(
            f"its robot {named.name} has sha256 {named.sha256}, and the published one has "
            f"{entry.sha256}; save the episode on a page that was built from this registry"
        )
    [stack], [member] = roster.policies, roster.describe(roster.ids)
    if stack.spec.observation_size != environment(task).observation_size["robot"]:
        raise LogError(
            f"its robot {named.name} was trained on another version of {task}; choose a robot that "
            "`assistax-zoo list` prints for it"
        )
    return SeatRobot(member, _player(stack.spec), stack.row(0), entry)


@functools.cache
def _script(task: str, name: str) -> SeatRobot:
    """Return the script of a task, or the one that is told the wish."""
    env = environment(task)
    roster = script_roster(task, env.observation_size["robot"], env.action_size["robot"])
    [stack], [member] = roster.policies, roster.describe(roster.ids)
    if name == SCRIPT:
        return SeatRobot(member, _player(stack.spec), stack.row(0))
    digest = sha256(f"{WITH_WISHES} {member.digest}".encode())
    return SeatRobot(
        dataclasses.replace(member, id=WITH_WISHES, digest=digest), ToldScript(task), {}
    )


@functools.cache
def _player(spec: Seat) -> Any:
    """Return the one player of a spec, for which programs are compiled once."""
    return spec.player()


@functools.cache
def _program(player: Any) -> Callable[[Any, jax.Array], jax.Array]:
    """Return the compiled program from observations [T, N, O] to actions [T, N, A]."""

    @jax.jit
    def acting(params: Any, seen: jax.Array) -> jax.Array:
        count = seen.shape[1]

        def step(carry: Any, now: tuple[jax.Array, jax.Array]) -> tuple[Any, jax.Array]:
            obs, time = now
            return player.act(params, carry, obs, jnp.broadcast_to(time == 0, (count,)))

        carry = player.initial_carry((count,))
        return jax.lax.scan(step, carry, (seen, jnp.arange(len(seen))))[1]

    return acting
