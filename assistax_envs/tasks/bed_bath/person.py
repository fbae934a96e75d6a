"""Persons of bed bath: they present the next point to the pad."""

from assistax_envs.tasks.person import ARM_SEEN, ArmHelp, PersonKind
from assistax_envs.tasks.person_numbers import SKIN

# Degrees about each segment's axis, from its frame's x to its y: where the pad comes little while
# the arm rests, and which rolling the arm inward shows. Teams that rolled it outward first, where
# there were points too, stayed there: docs/log/gentle_tasks.md.
UNDERSIDE = ((90.0, 270.0), (165.0, 340.0))

PERSON = PersonKind(
    parameters=SKIN,
    layout=(*ARM_SEEN, ("distance", 1)),
    help=ArmHelp("presents", again=100, hidden=UNDERSIDE, most=0.95),
)
