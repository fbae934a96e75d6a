"""Gentle wave: long strokes along the forearm, as the human prefers them."""

from assistax_envs.tasks.gentle_recipe import RECIPE
from assistax_envs.tasks.kind import Scene, TaskKind
from assistax_outside.gentle_wave.person import PERSON

TASK = TaskKind(
    name="gentle_wave",
    version=1,
    make="assistax_outside.gentle_wave.task:GentleWave",
    script="assistax_outside.gentle_wave.script:SCRIPT",
    scene=Scene("assistax_outside.gentle_wave:scene.xml", human_share=0.5, softened=True),
    tool="stick",
    preferences=("force", "speed"),
    person=PERSON,
    recipe=RECIPE,
    goal="The robot strokes a person's forearm from end to end.",
)
