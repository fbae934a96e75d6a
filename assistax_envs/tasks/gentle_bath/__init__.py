"""Gentle bath: the underside of the arm is wiped, as the human prefers it."""

import dataclasses

from assistax_envs.tasks.bed_bath import TASK as BASE
from assistax_envs.tasks.gentle_bath.person import PERSON
from assistax_envs.tasks.gentle_recipe import RECIPE
from assistax_envs.tasks.kind import TaskKind

TASK = TaskKind(
    name="gentle_bath",
    version=4,
    make="assistax_envs.tasks.gentle_bath.task:GentleBath",
    script="assistax_envs.tasks.gentle_bath.script:SCRIPT",
    scene=dataclasses.replace(BASE.scene, human_share=0.5, softened=True),
    tool="pad",
    looks=BASE.looks,
    preferences=("force", "speed"),
    person=PERSON,
    recipe={**RECIPE, "entropy_coef": 3e-3, "liking_width": 1.0},
    seed_sd=31.5,
    goal="The robot wipes points on the arm of a person in bed.",
)
