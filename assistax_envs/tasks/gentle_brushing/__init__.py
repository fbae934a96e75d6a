"""Gentle brushing: strokes over twelve places on the teeth."""

import dataclasses

from assistax_envs.tasks.gentle_brushing.person import PERSON
from assistax_envs.tasks.gentle_recipe import RECIPE
from assistax_envs.tasks.kind import TaskKind
from assistax_envs.tasks.scratch import TASK as BASE

TASK = TaskKind(
    name="gentle_brushing",
    version=2,
    make="assistax_envs.tasks.gentle_brushing.task:GentleBrushing",
    script="assistax_envs.tasks.gentle_brushing.script:SCRIPT",
    scene=dataclasses.replace(BASE.scene, human_share=1.0, softened=True, teeth=True),
    tool="brush",
    looks=BASE.looks,
    preferences=("press", "speed"),
    person=PERSON,
    seat="mouth",
    recipe={**RECIPE, "entropy_coef": 3e-3},
    goal="The robot brushes the teeth of a person who opens the mouth.",
)
