"""Gentle lift: a hanging forearm is brought beside the waist, and rests there."""

import dataclasses

from assistax_envs.tasks.arm_assist import TASK as BASE
from assistax_envs.tasks.gentle_lift.person import PERSON
from assistax_envs.tasks.gentle_recipe import RECIPE
from assistax_envs.tasks.kind import TaskKind

TASK = TaskKind(
    name="gentle_lift",
    version=4,
    make="assistax_envs.tasks.gentle_lift.task:GentleLift",
    script="assistax_envs.tasks.gentle_lift.script:SCRIPT",
    # The arm holds the forearm where it was brought to, and cannot bring it there.
    scene=dataclasses.replace(BASE.scene, human_share=0.12, softened=True),
    tool="hook",
    looks=BASE.looks,
    preferences=("distance", "place"),
    person=PERSON,
    recipe={**RECIPE, "entropy_coef": 6e-3},
    seed_sd=88.5,
    goal="The robot lays the arm of a person in bed across its waist.",
)
