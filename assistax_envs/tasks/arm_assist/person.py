"""Persons of arm assist: they bring the forearm to the waist."""

import dataclasses

from assistax_envs.tasks.person import ARM_SEEN, ArmHelp, Parameter, PersonKind
from assistax_envs.tasks.person_numbers import BODY, CONTROL, INTENTION, RANGE, REACTION, SIGNS

CARRIED = (
    Parameter("liked_distance", "m", 0.1, 0.6, RANGE, "liked distance of the hook", 0.25, 0.6),
    Parameter("liked_place", "m", 0.1, 0.3, RANGE, "liked place of the arm across the waist"),
    Parameter(
        "tolerance", "1", 1.5, 4.0,
        "design: 40 N on average, in weights of the forearm, 16 N",
        "force that hurts, in weights of the forearm", 2.5, 0.3,
    ),
)  # fmt: skip
# A carried person has to find its place itself: 0.25 rad off, a third of persons could not rest
# within 6 cm of it, whichever robot brought them there; of those that are not off, 2% cannot.
_NEAR = tuple(
    dataclasses.replace(number, low=-0.1, high=0.1) if number.name.startswith("belief") else number
    for number in INTENTION
)
CARRIED_PERSON = (*BODY, *CONTROL, *_NEAR, *CARRIED, *REACTION, *SIGNS)

PERSON = PersonKind(
    parameters=CARRIED_PERSON,
    layout=(*ARM_SEEN, ("distance", 1), ("turn", 9), ("to_place", 3), ("left", 1)),
    help=ArmHelp("brings"),
)
