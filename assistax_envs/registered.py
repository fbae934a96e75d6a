"""Every task, registered once: what is known of it without JAX or MuJoCo, and where the rest is."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Registered:
    """A task, as its row below says."""

    home: str  # "MODULE:CLASS" in `assistax_envs.tasks`
    version: int  # see `assistax_envs.versions`
    script: str  # function of `assistax_envs.scripted` that plays the robot
    tool: str  # MJCF file of what is bolted to the robot's hand
    paper: bool = False  # whether it is a task of the paper
    # What of a human's preference matters here, and is observed; none: humans have no preferences.
    wishes: tuple[str, ...] = ()
    felt: bool = False  # whether all touches are felt: backends must give the frames of contacts
    seat: str = (
        "arm"  # what of the human its seat moves: the right arm, or head, jaw and trunk: "mouth"
    )


REGISTERED: dict[str, Registered] = {
    "scratch": Registered("scratch:Scratch", 1, "go", "stick", paper=True),
    "bed_bath": Registered("bed_bath:BedBath", 1, "go", "pad", paper=True),
    "arm_assist": Registered("arm_assist:ArmAssist", 2, "lift", "hook", paper=True),
    "gentle_scratch": Registered(
        "gentle_scratch:GentleScratch",
        3,
        "stroke",
        "stick",
        wishes=("force", "speed"),
        felt=True,
    ),
    "gentle_bath": Registered(
        "gentle_bath:GentleBath", 3, "wipe", "pad", wishes=("force", "speed"), felt=True
    ),
    "gentle_lift": Registered(
        "gentle_lift:GentleLift",
        3,
        "bring",
        "hook",
        wishes=("distance", "place"),
        felt=True,
    ),
    "gentle_feeding": Registered(
        "gentle_feeding:GentleFeeding",
        2,
        "feed",
        "spoon",
        wishes=("wait", "depth"),
        felt=True,
        seat="mouth",
    ),
    "gentle_brushing": Registered(
        "gentle_brushing:GentleBrushing",
        1,
        "brush",
        "brush",
        wishes=("press", "speed"),
        felt=True,
        seat="mouth",
    ),
}
