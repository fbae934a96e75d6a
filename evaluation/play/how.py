"""Settings of a play of robots and partners, checked when they are made."""

import dataclasses
import math
from collections.abc import Sequence

from assistax_base.extensions import METRICS, extensions
from assistax_envs.preferences import check_preferences, preferences_of
from assistax_envs.versions import TASKS


@dataclasses.dataclass(frozen=True)
class PlaySettings:
    """Settings of a play of robots and partners.

    Attributes:
        task: Task, such as scratch. Default: that of the names.
        episodes: Episodes of each pair. Default 18 in the gentle tasks, where nine preferences take
            turns, 4 with persons, and 8 in the other tasks.
        seed: Seed of the episodes. Each partner has its own episodes, the same for every robot.
        backend: Physics: fused, native, mjx, mjx-warp, or auto for the fastest one here.
        stochastic: Draw actions instead of taking each policy's most likely one.
        max_envs: Most simulations in a saved part, and on a GPU at once. Lower it if memory runs
            out.
        preferences: Preferences of a gentle task's humans, such as p1,p5. Each partner takes turns
            in them from episode to episode. Default: those of the partner's side of the split, or
            all if the split holds none out.
        series: Episodes that a robot plays with a partner before it forgets. Its recurrent state is
            kept through a series, and the partner's preference stays. The result then says how the
            return grows within a series.
        metrics: Metrics that installed packages add, such as a,b. The figures have them under
            "more", and episodes have the columns that the metrics need.

    Raises:
        ValueError: A value is not allowed. The error says which values are.
    """

    task: str
    episodes: int | None = None
    seed: int = 0
    backend: str = "auto"
    stochastic: bool = False
    max_envs: int | None = None
    preferences: str | None = None
    series: int = 1
    metrics: str | None = None

    def __post_init__(self) -> None:
        if self.task not in TASKS:
            raise ValueError(f"task is {self.task!r}; allowed are {', '.join(TASKS)}")
        check_numbers(self.episodes, self.seed, self.series)
        if self.max_envs is not None and self.max_envs < 1:
            raise ValueError(f"max_envs is {self.max_envs}; allowed is 1 or more")
        if self.preferences is not None:
            check_preferences(self.task, self.turns)
        check_metrics(self.metric_names)

    @property
    def turns(self) -> tuple[str, ...]:
        """The preferences in which a partner takes turns; none for the paper's tasks."""
        if self.preferences is None:
            return preferences_of(self.task)
        return tuple(self.preferences.split(",")) if self.preferences else ()

    @property
    def metric_names(self) -> tuple[str, ...]:
        """The names of the metrics that installed packages add."""
        return tuple(self.metrics.split(",")) if self.metrics else ()

    @property
    def episodes_of_pair(self) -> int:
        """How many episodes a pair plays."""
        return self.episodes or default_episodes(self.task, self.series)


def default_episodes(task: str, series: int = 1) -> int:
    """Return how many episodes a pair plays if nothing else is asked for: whole series.

    If the preferences take turns, every partner has each of them equally often.
    """
    turns = 2 * len(preferences_of(task)) or 8
    return math.ceil(turns / series) * series


def check_numbers(episodes: int | None, seed: int, series: int) -> None:
    """Refuse episodes, None where the task's default is meant, that no pair can play.

    Raises:
        ValueError: Says which number, and what is allowed.
    """
    if episodes is not None and episodes < 1:
        raise ValueError(f"episodes is {episodes}; each pair needs at least 1")
    if seed < 0:
        raise ValueError(f"seed is {seed}; allowed is 0 or more")
    if series < 1 or (episodes or 0) % series:
        of = "" if episodes is None else f" of {episodes} episodes"
        raise ValueError(
            f"series is {series}{of}; give 1 or more, and a multiple of it as episodes, such as a "
            "series of 5 and 10 episodes"
        )


def check_metrics(names: Sequence[str]) -> None:
    """Refuse names of metrics that no installed package has; nothing is imported.

    Raises:
        ValueError: Says which name, and what is allowed.
    """
    known = extensions(METRICS) if names else {}
    for name in names:
        if name not in known:
            allowed = f"allowed are {', '.join(known)}" if known else "no installed package has one"
            raise ValueError(f"metric is {name!r}; {allowed}")
