"""Numbers that persons of several tasks have: of body, control, intention and reaction.

A source says what was read: "memory" marks a figure that was written down without its source at
hand, "design" one that was chosen without a measurement. Imports no JAX or MuJoCo.
"""

from assistax_envs.tasks.person import Parameter

_GOMI = "Gomi and Osu 1998, J Neurosci 18:8965, for its form; the scale is a design"
_WISH = "King et al. 2010, IROS: below 3 N wipe skin clean; Proc IMechE H 2023, 237:829"
FOREARM = 16.0  # N: what a forearm and a hand weigh, and a force at which a carried arm is at ease
RANGE = "design: the gentle tasks' own range"

BODY = (
    Parameter(
        "strength", "1", 0.4, 1.0,
        "d1 to d9 of the paper; MRC grade 4 holds 96% of elbow strength (MacAvoy and Green 2007)",
        "share of the torques of the seat, half of what is missing spared in gentle scenes",
    ),
    Parameter(
        "range", "1", 0.4, 1.0, "d1 to d9 of the paper",
        "share of the elbow's range about its rest angle, spared likewise",
    ),
    Parameter(
        "tremor_frequency", "Hz", 4.0, 12.0,
        "essential tremor 4 to 12 Hz, Parkinson's 3 to 8 Hz: introduction of PMC6806079",
        "frequency of the tremor",
    ),
    Parameter(
        "tremor", "1", 0.02, 0.3, "design: 0.3 of the torque moves the hand by millimetres",
        "amplitude of the tremor, as a share of the strength", none=0.4,
    ),
    Parameter(
        "spasticity", "N m s/rad", 0.2, 5.0,
        "memory: 2 on average, elbow, 2.8 N m at 5 and 6.3 at 100 deg/s (PMC5345015)",
        "torque of the elbow's flexors against fast stretching", none=0.5,
    ),
    Parameter(
        "catch_speed", "rad/s", 0.3, 1.5,
        "stretches of 15 to 150 deg/s show it: McPherson et al. 2018, Exp Brain Res 237:121",
        "speed of stretching at which spasticity begins",
    ),
    Parameter(
        "fatigue", "1/min", 0.0, 1.0, "memory: Rohmert 1960, full effort lasts about a minute",
        "share of strength that a minute of full effort costs",
    ),
    Parameter(
        "slow_start", "s", 0.1, 1.5,
        "slowed initiation in Parkinson's disease: Schugens et al. 1993, Mov Disord 8:367; "
        "the ends are a design",
        "time from the wish to move to the movement",
    ),
)  # fmt: skip
CONTROL = (
    Parameter(
        "stiffness", "1", 0.3, 2.0, _GOMI, "stiffness of the arm, relative to healthy adults"
    ),
    Parameter(
        "delay", "s", 0.06, 0.3,
        "long-latency reflex 50 to 100 ms, voluntary above 100 ms: Pruszynski and Scott 2012, "
        "Exp Brain Res 218:341; 300 ms is a design",
        "delay of what is felt",
    ),
    Parameter(
        "noise", "1", 0.02, 0.25,
        "torque varies in proportion to itself: Hamilton et al. 2004, Exp Brain Res 157:417; "
        "the ends are a design",
        "standard deviation of the torque as a share of it",
    ),
    Parameter(
        "gravity", "1", 0.7, 1.0, "design", "share of the arm's weight that is carried unasked"
    ),
)  # fmt: skip
INTENTION = (
    Parameter(
        "pace", "s/bit", 0.1, 0.5, "memory: Fitts 1954 found 0.1 s/bit; slower is a design",
        "time of movements, by Fitts' law",
    ),
    Parameter(
        "initiative", "1", 0.0, 1.0, "design",
        "when it helps: when pushed (below 1/3), when touched (below 2/3), or before a touch",
    ),
    Parameter("lapses", "1/min", 0.0, 6.0, "design", "how often attention goes for 1 s"),
    *(
        Parameter(
            f"belief_{joint}", "rad", -0.25, 0.25, "design",
            f"how far from the posture that helps this person believes {words} should be",
        )
        for joint, words in (
            ("shoulder1", "the first shoulder joint"),
            ("shoulder2", "the second shoulder joint"),
            ("elbow", "the elbow"),
        )
    ),
)  # fmt: skip
TOUCH = (
    Parameter("liked_force", "N", 1.5, 10.0, _WISH, "liked force on the skin", 4.0, 0.5),
    Parameter(
        "liked_speed", "m/s", 0.02, 0.12,
        "strokes of 1 to 10 cm/s please most: Loken et al. 2009, Nat Neurosci 12:547",
        "liked speed over the skin", 0.05, 0.6,
    ),
    Parameter(
        "tolerance", "1", 1.5, 5.0,
        "design: 10 N on average; Proc IMechE H 2023 has 11.1 N (shaving) to 55.7 N (hair)",
        "force that hurts, in liked forces", 2.5, 0.3,
    ),
)  # fmt: skip
REACTION = (
    Parameter(
        "settle", "s", 0.15, 0.6, "design: about 0.3 s", "how fast discomfort comes and goes"
    ),
    Parameter(
        "withdraw",
        "rad",
        0.05,
        0.3,
        "design: about 0.15 rad",
        "how far it withdraws at discomfort 1",
    ),
    Parameter(
        "lean", "rad", 0.02, 0.1, "design: about 0.05 rad", "how far it leans to too light a touch"
    ),
    Parameter("limit", "1", 0.6, 1.5, "design: about 1", "discomfort that ends the help"),
)
# Persons inside 80% of every axis have shares of 0.1 to 0.9: a tenth of them has less than 0.18.
SIGNS = (
    Parameter(
        "expressive", "1", 0.3, 1.0, "design",
        "share of its full lean for a touch not as liked; a fifth of that if it never speaks",
    ),
    Parameter(
        "talkative", "1", 0.5, 1.0, "design", "chance to say a word when one is due", none=0.18
    ),
    Parameter(
        "word_delay", "s", 0.25, 0.5,
        "a word takes over 0.6 s to prepare, of which some is the delay of what is felt: Levinson "
        "and Torreira 2015, Front Psychol 6:731; the ends are a design",
        "time from a reason to speak to the word",
    ),
    Parameter("word_pause", "s", 0.5, 0.9, "design", "least time between two words"),
    Parameter("word_error", "1", 0.0, 0.1, "design", "chance that a word is drawn from all words"),
)  # fmt: skip

# Numbers of a person whose skin is touched.
SKIN = (*BODY, *CONTROL, *INTENTION, *TOUCH, *REACTION, *SIGNS)
# Numbers of a head, by the numbers of an arm whose places they take.
_OF_MOUTH = {
    "range": Parameter(
        "range", "1", 0.4, 1.0, "d1 to d9 of the paper",
        "share of the neck's and jaw's range, half of what is missing spared",
    ),
    "spasticity": Parameter(
        "bite_reflex", "N m", 0.02, 0.2, "design: 2 N between the lips at most",
        "torque of the jaw for a quarter of a second after a touch in the mouth", none=0.6,
    ),
    "catch_speed": Parameter(
        "bite_onset", "N", 0.5, 4.0, "design", "force of a touch at which the bite reflex begins"
    ),
    "stiffness": Parameter(
        "stiffness", "1", 0.3, 2.0, "design: 1 is half of the scene's springs",
        "with which trunk, neck and jaw hold where they should be",
    ),
    "gravity": Parameter(
        "wander", "rad", 0.0, 0.08, "design", "how far the head wanders about where it should be"
    ),
    "initiative": Parameter(
        "initiative", "1", 0.0, 1.0, "design", "how soon it opens or turns, from half as soon on"
    ),
    "belief_shoulder1": Parameter(
        "belief_pitch", "rad", -0.08, 0.08, "design",
        "how far from the posture that helps this person believes the neck should nod",
    ),
    "belief_shoulder2": Parameter(
        "belief_yaw", "rad", -0.1, 0.1, "design", "likewise, how far it should turn"
    ),
    "belief_elbow": Parameter(
        "belief_jaw", "rad", -0.08, 0.08, "design", "likewise, how far the jaw should open"
    ),
}  # fmt: skip


def numbers_of_head(own: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
    """Return the numbers of a person that moves its head; `own` are the task's three."""
    numbers = (*BODY, *CONTROL, *INTENTION)
    return (*(_OF_MOUTH.get(number.name, number) for number in numbers), *own, *REACTION, *SIGNS)
