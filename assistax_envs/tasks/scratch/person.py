"""Persons of scratch: they present the itch to the tool."""

from assistax_envs.tasks.person import ARM_SEEN, ArmHelp, PersonKind
from assistax_envs.tasks.person_numbers import SKIN

# Degrees about each segment's axis, from its frame's x to its y, where the tool cannot come while
# the arm rests. By inverse kinematics from the robot's start, 2,000 points: of those inside 8% can
# be touched, of those outside 84%.
HIDDEN = ((90.0, 200.0), (150.0, 295.0))

PERSON = PersonKind(
    parameters=SKIN,
    layout=(*ARM_SEEN, ("distance", 1)),
    help=ArmHelp("presents", hidden=HIDDEN, most=0.95),
)
