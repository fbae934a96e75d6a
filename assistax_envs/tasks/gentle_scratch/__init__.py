"""Gentle scratch: strokes to and fro over an itch, as the human prefers them."""

import dataclasses

from assistax_envs.tasks.gentle_recipe import RECIPE
from assistax_envs.tasks.gentle_scratch.person import PERSON
from assistax_envs.tasks.kind import TaskKind
from assistax_envs.tasks.scratch import TASK as BASE

TASK = TaskKind(
    name="gentle_scratch",
    version=4,
    make="assistax_envs.tasks.gentle_scratch.task:GentleScratch",
    script="assistax_envs.tasks.gentle_scratch.script:SCRIPT",
    scene=dataclasses.replace(BASE.scene, human_share=0.5, softened=True),
    tool="stick",
    looks=BASE.looks,
    preferences=("force", "speed"),
    person=PERSON,
    recipe={**RECIPE, "entropy_coef": 3e-3},
    seed_sd=18.3,
    goal="The robot strokes an itch on the person's arm, to and fro.",
)
