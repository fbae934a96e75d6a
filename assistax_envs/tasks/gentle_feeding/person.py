"""Persons of gentle feeding: they open for a spoon that waits, close on it, and let it go."""

from assistax_envs.tasks.person import HEAD_SEEN, HeadHelp, Parameter, PersonKind
from assistax_envs.tasks.person_numbers import RANGE, numbers_of_head

_FED = (
    Parameter("liked_wait", "m", 0.04, 0.16, RANGE, "liked wait before the lips", 0.08, 0.8),
    Parameter("liked_depth", "m", 0.012, 0.028, RANGE, "liked depth behind the lips", 0.02, 0.3),
    Parameter(
        "tolerance", "1", 1.5, 5.0, "design: 5 N on average, in forces of 2 N",
        "force that hurts, in forces of 2 N", 2.5, 0.3,
    ),
)  # fmt: skip

PERSON = PersonKind(
    parameters=numbers_of_head(_FED),
    layout=(
        *HEAD_SEEN,
        ("up", 3),
        ("jaw", 1),
        ("progress", 5),  # the stage
        ("flag", 1),  # whether the mouth was closed since the last bite
        ("held", 1),
        ("bites", 1),
        ("touch", 1),
        ("bitten", 1),
        ("speed", 1),
        ("felt", 4),  # of two wishes: what is done over a usual value, whether it is judged
        ("known", 2),
    ),
    help=HeadHelp(
        "assistax_envs.tasks.gentle_feeding.eating:feel",
        "assistax_envs.tasks.gentle_feeding.eating:intend",
    ),
)
