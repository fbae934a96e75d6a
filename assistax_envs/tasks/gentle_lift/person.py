"""Persons of gentle lift: they bring the forearm to their own place on the waist."""

from assistax_envs.preferences import PLACES
from assistax_envs.tasks.arm_assist.person import CARRIED_PERSON
from assistax_envs.tasks.person import ARM_SEEN, ArmHelp, PersonKind

MIDDLE = PLACES[1]  # m: the place that the robot observes
ACROSS = (0.78, 0.6258, 0.0)  # direction across the waist, in which places differ

PERSON = PersonKind(
    parameters=CARRIED_PERSON,
    layout=(
        *ARM_SEEN,
        ("distance", 1),
        ("to_place", 3),
        ("left", 1),
        ("touch", 1),
        ("swing", 1),
        ("felt", 4),  # of two wishes: what is done over a usual value, whether it is judged
        ("known", 3),
    ),
    help=ArmHelp("brings", across=(ACROSS, MIDDLE)),
)
