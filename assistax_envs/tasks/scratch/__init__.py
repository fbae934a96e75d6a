"""Scratch: the robot scratches a point on the human's right arm (paper, 3.1 and A)."""

from assistax_envs.tasks.kind import Scene, TaskKind
from assistax_envs.tasks.scratch.person import PERSON

TASK = TaskKind(
    name="scratch",
    version=1,
    make="assistax_envs.tasks.scratch.task:Scratch",
    script="assistax_envs.tasks.scratch.script:SCRIPT",
    scene=Scene("assistax_envs.tasks.scratch:scene.xml"),
    tool="stick",
    looks="wheelchair",
    person=PERSON,
    spreads={"ppo": (0.8, 3.8, 0.0, 18.6, 7.8), "sac": (8.8, 5.1, 8.9, 37.6, 16.7)},
    seed_sd=5.8,
    goal="The robot scratches an itch on the person's arm.",
)
