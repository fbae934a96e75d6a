"""Persons of gentle wave: they turn the forearm towards the tool."""

from assistax_envs.tasks.person import ARM_SEEN, ArmHelp, PersonKind
from assistax_envs.tasks.person_numbers import SKIN

# Degrees about the axes of upper arm and forearm that the tool cannot reach while the arm rests.
HIDDEN = ((90.0, 200.0), (150.0, 295.0))

PERSON = PersonKind(
    parameters=SKIN,
    layout=(*ARM_SEEN, ("distance", 1), ("outward", 3), ("touch", 1), ("felt", 4), ("known", 2)),
    help=ArmHelp("presents", hidden=HIDDEN, most=0.95),
)
