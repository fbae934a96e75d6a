"""Persons of gentle bath: they show the points that are left to wipe."""

from assistax_envs.tasks.bed_bath.person import UNDERSIDE
from assistax_envs.tasks.person import ARM_SEEN, ArmHelp, PersonKind
from assistax_envs.tasks.person_numbers import SKIN

PERSON = PersonKind(
    parameters=SKIN,
    layout=(
        *ARM_SEEN,
        ("outward", 3),
        ("distance", 1),
        ("touch", 1),
        ("sliding", 1),
        ("unwiped", 25),
        ("felt", 4),  # of two wishes: what is done over a usual value, whether it is judged
        ("known", 2),
    ),
    help=ArmHelp(
        "shows",
        again=200,
        hidden=UNDERSIDE,
        most=0.95,
        points="assistax_envs.tasks.gentle_bath.task:underside",
    ),
)
