"""Persons of gentle scratch: they present the itch to the tool."""

from assistax_envs.tasks.person import ARM_SEEN, ArmHelp, PersonKind
from assistax_envs.tasks.person_numbers import SKIN
from assistax_envs.tasks.scratch.person import HIDDEN

PERSON = PersonKind(
    parameters=SKIN,
    layout=(
        *ARM_SEEN,
        ("distance", 1),
        ("fine", 3),
        ("outward", 3),
        ("slip", 3),
        ("touch", 1),
        ("time", 1),
        ("strokes", 1),
        ("felt", 4),  # of two wishes: what is done over a usual value, whether it is judged
        ("known", 3),
    ),
    help=ArmHelp("presents", hidden=HIDDEN, most=0.95),
)
