"""Bed bath: the robot wipes 52 points of the human's right arm in turn (paper, 3.1 and A)."""

from assistax_envs.tasks.bed_bath.person import PERSON
from assistax_envs.tasks.kind import Scene, TaskKind

# rad: the left arm rests beside the body, as its springs hold it.
LEFT_ARM = {"left_shoulder2": 0.84, "left_elbow": -1.571}
TASK = TaskKind(
    name="bed_bath",
    version=1,
    make="assistax_envs.tasks.bed_bath.task:BedBath",
    script="assistax_envs.tasks.bed_bath.script:SCRIPT",
    scene=Scene("assistax_envs.tasks.bed_bath:scene.xml", rest=LEFT_ARM),
    tool="pad",
    looks="wide_bed",
    person=PERSON,
    spreads={"ppo": (17.1, 4.5, 35.9, 25.1, 1.1), "sac": (16.7, 9.7, 36.7, 25.3, 1.6)},
    seed_sd=15.7,
    goal="The robot wipes points on the arm of a person in bed.",
)
