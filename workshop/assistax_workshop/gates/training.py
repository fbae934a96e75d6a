"""Training of the policies for the gates of a gentle task; an audit reads the folders.

Examples are teams whose robot is told the human's preference, teams whose human is not told it, and
robots that train with an idle human. Only the gates use them; no release holds them.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax

from assistax_envs import make
from assistax_envs.disability import DISABILITY_SETTINGS, Disability
from assistax_envs.registered import ByTask
from assistax_workshop.gates.audit import held_roster
from assistax_workshop.gates.audit_teams import read_teams
from assistax_zoo.shell.console import TrainingLine
from evaluation.cast.roster import Roster
from evaluation.ego_training import shared_out
from population.config import MIXED, make_members, make_run
from population.hyperparameters import TrainerConfig, preset
from population.networks.members import member_map, to_members, to_simulations
from population.networks.seat import Carry
from population.networks.stack import PolicyStack
from population.partners.frozen import FrozenPartners
from population.runs.train import train
from population.views import View
from zoo.registry import load_registry

# Changes of PPO's presets for all runs of a task; empty for a task without a recipe.
CHANGES: Mapping[str, Mapping[str, Any]] = ByTask(lambda kind: kind.recipe)


@dataclasses.dataclass(frozen=True)
class Condition:
    """Algorithm, observations and partners of a training."""

    algorithm: str = "ippo"
    torso: str = "mlp"
    told: tuple[str, ...] = ("human",)  # roles that observe the preference
    # Frozen humans of a robot's training: none, a passive one, one team's, or those of every other
    # team, so that the remaining teams' humans are strangers.
    humans: str = "none"


KNOWING = View.PREFERENCE.condition  # teams whose robots observe the preference
CONDITIONS: Mapping[str, Condition] = {
    "teams": Condition(),
    "mappo": Condition("mappo"),
    "masac": Condition("masac"),
    KNOWING: Condition(told=("human", "robot")),
    "blind": Condition(told=()),
    "recurrent": Condition(torso="gru"),
    "passive": Condition(humans="passive"),
    "response": Condition(humans="one"),
    "ego": Condition(humans="half"),
    "ego-recurrent": Condition(torso="gru", humans="half"),
    "ego-told": Condition(told=("human", "robot"), humans="half"),
}


class OneEach(FrozenPartners):
    """Partners of which member i trains with partner i alone, for best responses in one program.

    Partners are of one spec and one setting. Members are not spread over several devices.
    """

    def __len__(self) -> int:
        return 1  # of each member

    def settings(self, num_envs: int) -> list[Disability]:
        """See `FrozenPartners.settings`."""
        return [self._settings[0]] * num_envs

    def initial_carry(self, simulations: int) -> tuple[Carry, ...]:
        """See `FrozenPartners.initial_carry`; by stack [M, N, ...]."""
        count = len(self.ids)
        return tuple(p.initial_carry((count, simulations // count)) for p in self._policies)

    def act(
        self,
        params: Any,
        carry: tuple[Carry, ...],
        obs: jax.Array,
        first: jax.Array,
        members: int,
        humans: Any = None,
    ) -> tuple[tuple[Carry, ...], jax.Array]:
        """See `FrozenPartners.act`."""
        [policy] = self._policies
        seen = to_members((obs, first), members)
        new, action = member_map(policy.act)(params[0], carry[0], *seen)
        return (new,), to_simulations(action)


def train_conditions(
    task: str,
    folder: Path,
    conditions: Sequence[str],
    *,
    seeds: Sequence[int],
    steps: int,
    disability: str = "d1",
    changes: Mapping[str, Any] | None = None,
    backend: str = "auto",
) -> None:
    """Train conditions of a gentle task, each into FOLDER/CONDITION.

    Interrupted runs continue. Conditions with humans of teams need FOLDER/teams first.

    Args:
        task: Gentle task.
        folder: Folder of the runs.
        conditions: Names among CONDITIONS.
        seeds: Seeds of each condition.
        steps: Environment steps of each team.
        disability: The human's setting.
        changes: Changes of the preset's hyperparameters.
        backend: Physics.

    Raises:
        ValueError: A condition is unknown, or there is not one seed for each team.
    """
    if unknown := [name for name in conditions if name not in CONDITIONS]:
        raise ValueError(f"condition is {unknown[0]!r}; allowed are {', '.join(CONDITIONS)}")
    for name in conditions:
        condition = CONDITIONS[name]
        env = make(task, backend, told=condition.told)
        for place, own, humans in _humans(condition, folder, name, seeds, env, disability):
            trainer = _trainer(task, condition, changes or {})
            if humans:
                trainer = shared_out(trainer, len(humans), keep=False)
            config = make_run(
                task,
                condition.algorithm,
                make_members(own, [MIXED if humans else disability]),
                steps,
                trainer,
                self_play_episodes=0,
                partners=humans.ids if humans else (),
            )
            with TrainingLine(str(place)) as line:
                train(config, env, place, partners=humans, progress=line)


def _trainer(task: str, condition: Condition, changes: Mapping[str, Any]) -> TrainerConfig:
    """Return the hyperparameters of a condition."""
    of_task = CHANGES[task]
    if preset(condition.algorithm).kind == "sac":
        of_task = {name: of_task[name] for name in ("initial_log_std",) if name in of_task}
    recurrent = {"torso": "gru"} if condition.torso == "gru" else {}
    return preset(condition.algorithm, **{**of_task, **recurrent, **changes})


def _humans(
    condition: Condition,
    folder: Path,
    name: str,
    seeds: Sequence[int],
    env: Any,
    disability: str,
) -> Iterator[tuple[Path, Sequence[int], FrozenPartners | None]]:
    """Yield the runs of a condition: folder, seeds, and frozen humans (None if teams train)."""
    if condition.humans == "none":
        yield folder / name, seeds, None
        return
    if condition.humans == "passive":
        sizes = env.observation_size["human"], env.action_size["human"]
        yield folder / name, seeds, _frozen(held_roster(*sizes, [(0.0,) * sizes[1]]), disability)
        return
    humans = read_teams([str(folder / "teams")], load_registry(), env.task).humans
    [stack] = humans.stacks
    assert isinstance(stack, PolicyStack)

    if condition.humans == "half":
        every_other = stack.take(range(0, len(stack.ids), 2))
        yield folder / name, seeds, _frozen(Roster((every_other,), humans.members), disability)
        return
    if len(seeds) != len(stack.ids):
        raise ValueError(f"{len(seeds)} seeds for {len(stack.ids)} teams; give one for each")
    own = DISABILITY_SETTINGS[disability]
    yield folder / name, seeds, OneEach([stack], dict.fromkeys(stack.ids, own))


def _frozen(humans: Roster, disability: str) -> FrozenPartners:
    """Return the humans of a roster as frozen partners of one setting."""
    stacks = [stack for stack in humans.stacks if isinstance(stack, PolicyStack)]
    setting = DISABILITY_SETTINGS[disability]
    return FrozenPartners(stacks, {name: setting for stack in stacks for name in stack.ids})
