"""Persons of gentle brushing: they show the place that is to be brushed."""

from assistax_envs.tasks.person import HEAD_SEEN, HeadHelp, Parameter, PersonKind
from assistax_envs.tasks.person_numbers import RANGE, numbers_of_head

_BRUSHED = (
    Parameter(
        "liked_press", "N", 0.8, 4.0,
        "1.6 N on average, by hand: Wiegand et al. 2012; 330 g: Van der Weijden et al. 1998, "
        "J Clin Periodontol 25:413; the ends are a design",
        "liked press on the teeth", 2.0, 0.5,
    ),
    Parameter("liked_speed", "m/s", 0.02, 0.08, RANGE, "liked speed over the teeth", 0.04, 0.5),
    Parameter(
        "tolerance", "1", 1.5, 5.0, "design: 5 N on average", "force that hurts, in liked forces",
        2.5, 0.3,
    ),
)  # fmt: skip

PERSON = PersonKind(
    parameters=numbers_of_head(_BRUSHED),
    layout=(
        *HEAD_SEEN,
        ("up", 3),
        ("fine", 3),
        ("towards", 3),
        ("outward", 3),
        ("along", 3),
        ("jaw", 1),
        ("yaw", 1),
        ("progress", 12),  # the place
        ("side", 1),
        ("flag", 1),  # whether the place is shown
        ("time", 1),
        ("strokes", 1),
        ("done", 1),
        ("touch", 1),
        ("pressed", 1),
        ("felt", 4),  # of two wishes: what is done over a usual value, whether it is judged
        ("known", 3),
    ),
    help=HeadHelp(
        "assistax_envs.tasks.gentle_brushing.showing:feel",
        "assistax_envs.tasks.gentle_brushing.showing:intend",
    ),
    touch_unit=5.0,
)
