"""Arm assist: the robot lifts the human's hanging arm back onto the bed (paper, 3.1 and A)."""

from assistax_envs.tasks.arm_assist.person import PERSON
from assistax_envs.tasks.bed_bath import LEFT_ARM
from assistax_envs.tasks.kind import Scene, TaskKind

TASK = TaskKind(
    name="arm_assist",
    version=2,
    make="assistax_envs.tasks.arm_assist.task:ArmAssist",
    script="assistax_envs.tasks.arm_assist.script:SCRIPT",
    # The right arm is too weak to lift itself.
    scene=Scene("assistax_envs.tasks.arm_assist:scene.xml", human_share=0.07, rest=LEFT_ARM),
    tool="hook",
    looks="narrow_bed",
    person=PERSON,
    spreads={
        "ppo": (187.7, 124.9, 203.9, 286.8, 99.8),
        "sac": (2242.1, 26.8, 126.5, 234.0, 16.6),
    },
    seed_sd=1595.0,
    goal="The robot lays the arm of a person in bed across its waist.",
)
