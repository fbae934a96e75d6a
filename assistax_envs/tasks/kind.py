"""A task as one object: all that the other packages ask of it. Imports no JAX or MuJoCo."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal

from assistax_envs.preferences import VALUES
from assistax_envs.tasks.person import PersonKind


@dataclasses.dataclass(frozen=True)
class Scene:
    """Physical scene of a task: a human, a Panda robot and furniture.

    Attributes:
        mjcf: MJCF of the scene: a file "PACKAGE:NAME.xml", or the text itself. It attaches
            `human.xml` and `panda.xml`, which lie beside it when it is read, under the prefixes
            `human_` and `robot_`; `assistax_envs/tasks/scratch/scene.xml` is an example.
        human_share: Share of the healthy human's torque limits that is left.
        rest: Angles at which springs hold joints of the human, rad, by name without prefix.
        softened: Whether the skin gives way, the robot runs in reduced mode, and every touch of
            robot and human is felt.
        teeth: Whether a human with a mouth has teeth, which the tool touches in place of the lips.
    """

    mjcf: str
    human_share: float = 1.0
    rest: Mapping[str, float] = dataclasses.field(default_factory=dict)
    softened: bool = False
    teeth: bool = False


@dataclasses.dataclass(frozen=True)
class TaskKind:
    """A task. Heavy parts are named as "MODULE:ATTRIBUTE" and imported on use.

    Attributes:
        name: The task's name, as commands and registries have it.
        version: Version of the environment, see `assistax_envs.versions`.
        make: Place of the class, which has the protocol `tasks.base.Task`.
        script: Place of the `tasks.chain.Script` that plays the robot.
        scene: The physical scene.
        tool: MJCF of the tool in the robot's hand: a name in `assistax_envs/models`, or a file
            "PACKAGE:NAME.xml", or the text itself.
        looks: Furniture of pictures: a name in `assistax_envs/models/looks`, or a file
            "PACKAGE:NAME.toml"; without one the scene's own geoms are shown.
        preferences: Quantities about which a human of this task has a preference, names of
            `preferences.VALUES`; the human observes them. Empty if humans have no preferences.
        person: The persons of the task; None if it has no persons.
        seat: Part of the body that the human's seat moves: the right arm, or trunk, neck and jaw.
        recipe: Hyperparameters of PPO's presets that training for the gates changes.
        spreads: Standard deviations of returns by method, "ppo" or "sac": of seeds, partners,
            pairs, episodes and starts, as `evaluation.figures.metrics.variance.Spread` takes them.
        seed_sd: Standard deviation between seeds of one method of their mean return over partners;
            None if it was not measured.
        goal: A sentence that tells spectators the robot's goal.
    """

    name: str
    version: int
    make: str
    script: str
    scene: Scene
    tool: str
    looks: str = ""
    preferences: tuple[str, ...] = ()
    person: PersonKind | None = None
    seat: Literal["arm", "mouth"] = "arm"
    recipe: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    spreads: Mapping[str, tuple[float, ...]] = dataclasses.field(default_factory=dict)
    seed_sd: float | None = None
    goal: str = ""

    def __post_init__(self) -> None:
        if unknown := [name for name in self.preferences if name not in VALUES]:
            raise ValueError(
                f"task {self.name} has preferences about {', '.join(unknown)}; allowed are "
                f"{', '.join(VALUES)}"
            )
        wide = 2 * len(self.preferences)  # as `care.felt_by` has it
        if wide and self.person and dict(self.person.layout).get("felt") != wide:
            raise ValueError(
                f"task {self.name} has {len(self.preferences)} preferences, its persons' layout "
                f'lacks ("felt", {wide}); place it where `with_preference` adds it'
            )

    @property
    def felt(self) -> bool:
        """Whether every touch is felt: backends must give the frames of contacts."""
        return self.scene.softened

    @property
    def spared(self) -> float:
        """Share of an impairment that humans are spared: in softened scenes they are weak already.

        A setting's 0.4 leaves them 0.7 of their torques, or of the elbow's range. With 0.4 of the
        torques a human that lies on a bed cannot lift its arm, and with 0.4 of the range it cannot
        fold it across the waist.
        """
        return 0.5 if self.scene.softened else 0.0
