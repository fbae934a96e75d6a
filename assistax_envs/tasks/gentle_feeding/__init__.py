"""Gentle feeding: a spoon waits before the mouth, comes in, and leaves."""

import dataclasses

from assistax_envs.tasks.gentle_feeding.person import PERSON
from assistax_envs.tasks.gentle_recipe import RECIPE
from assistax_envs.tasks.kind import TaskKind
from assistax_envs.tasks.scratch import TASK as BASE

TASK = TaskKind(
    name="gentle_feeding",
    version=3,
    make="assistax_envs.tasks.gentle_feeding.task:GentleFeeding",
    script="assistax_envs.tasks.gentle_feeding.script:SCRIPT",
    # Trunk, neck and jaw hold their posture.
    scene=dataclasses.replace(BASE.scene, human_share=1.0, softened=True),
    tool="spoon",
    looks=BASE.looks,
    preferences=("wait", "depth"),
    person=PERSON,
    seat="mouth",
    recipe={**RECIPE, "entropy_coef": 3e-3},
    goal="The robot brings a spoon to the mouth that its person opens.",
)
