"""Ids of teams, egos and policies: one grammar, with `parse_team` and `str` inverse to each other.

    team    task/algorithm-dN-sM-vR         scratch/ippo-d3-s5-v1
    ego     task/algorithm-ego-sM-vR        scratch/ppo-ego-s0-v1    a robot without a human
    policy  task/algorithm-dN-sM-vR/role    scratch/ippo-d3-s5-v1/human
    partner task/NAME-...-vR                gentle_scratch/person-00042-v1    of any kind

The release may be left out, and the role too where the place says it. Then the task's default
release is meant. Everything that is written down has whole ids.

All lower case. Task and algorithm start with a letter and hold letters, digits and underscores; d
is the disability setting, s the training seed, v the release; numbers have no leading zeros. A
namespace and a colon stand before the ids of another zoo: lab:scratch/ippo-d3-s5-v1.
"""

import dataclasses
import fnmatch
import re
from collections.abc import Callable

from assistax_base.errors import IdError, shorten
from assistax_envs.versions import TASKS
from population.networks.spec import ROLES

_NUMBER = r"(?:0|[1-9][0-9]{0,9})"
_SEED = r"(?:0|[1-9][0-9]{0,18})"
_NAME = r"[a-z][a-z0-9_]{0,31}"
_PATTERNS = {
    "task": re.compile(_NAME),
    "algorithm": re.compile(_NAME),
    "disability": re.compile(r"d[1-9][0-9]{0,3}|ego"),
    "release": re.compile(rf"v{_NUMBER}"),
    "namespace": re.compile(rf"(?:{_NAME})?"),
}
_TEAM = re.compile(
    rf"(?:(?P<namespace>{_NAME}):)?(?P<task>{_NAME})/(?P<algorithm>{_NAME})"
    rf"-(?P<disability>d[1-9][0-9]{{0,3}}|ego)-s(?P<seed>{_SEED})-(?P<release>v{_NUMBER})"
)
# Of partners of every kind: a kind's own grammar says more.
_PARTNER = re.compile(
    rf"(?:{_NAME}:)?(?P<task>{_NAME})/{_NAME}(?:-[a-z0-9_]{{1,32}}){{0,4}}-(?P<release>v{_NUMBER})"
)
_PLACE = re.compile(rf"(?:(?P<namespace>{_NAME}):)?(?P<task>{_NAME})/[^/]+")
_NAMES_RELEASE = re.compile(r"-v[0-9\[?*][^-/]*$|\*$")
_MAX_SEED = 2**63  # a season's seeds have as many bits as fit a table's column
EGO = "ego"  # stands for the disability setting where no human was trained


@dataclasses.dataclass(frozen=True, slots=True)
class TeamId:
    """A robot and a human trained together, or a robot alone; `str` gives the id."""

    task: str  # "scratch"
    algorithm: str  # "ippo"
    disability: str  # "d3": the human's setting, numbered as in `assistax_envs.disability`
    seed: int  # training seed
    release: str  # "v1"
    namespace: str = ""  # of the added zoo; empty for this zoo's own teams

    def __post_init__(self) -> None:
        for name, pattern in _PATTERNS.items():
            value = getattr(self, name)
            if not isinstance(value, str) or not pattern.fullmatch(value):
                raise IdError(
                    f"{name} of a team id", f"text like {_EXAMPLES[name]!r}", shorten(value)
                )
        if type(self.seed) is not int or not 0 <= self.seed < _MAX_SEED:
            raise IdError(
                "seed of a team id", f"an integer from 0 to {_MAX_SEED - 1}", shorten(self.seed)
            )

    def __str__(self) -> str:
        own = f"{self.task}/{self.algorithm}-{self.disability}-s{self.seed}-{self.release}"
        return f"{self.namespace}:{own}" if self.namespace else own

    @property
    def is_ego(self) -> bool:
        """Whether it is a robot trained with frozen partners: no team, hence no partner."""
        return self.disability == EGO

    @property
    def order(self) -> tuple[str, str, str, int, int, int]:
        """Sort key: d9 comes before d10, and s9 before s10; egos come after teams."""
        return (
            self.namespace,
            self.task,
            self.algorithm,
            10**4 if self.is_ego else int(self.disability[1:]),
            self.seed,
            release_number(self.release),
        )


_EXAMPLES = {
    "task": TASKS[0],
    "algorithm": "ippo",
    "disability": "d3",
    "release": "v1",
    "namespace": "lab",
}


def parse_team(text: str) -> TeamId:
    """Return the team id that the text spells; `str` of it gives the text back."""
    match = _TEAM.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        expected = f"task/algorithm-dN-sM-vR, for example {TASKS[0]}/ippo-d3-s5-v1"
        raise IdError("team id", expected, shorten(text))
    return TeamId(
        task=match["task"],
        algorithm=match["algorithm"],
        disability=match["disability"],
        seed=int(match["seed"]),
        release=match["release"],
        namespace=match["namespace"] or "",
    )


def task_and_release(partner: str) -> tuple[str, str]:
    """Return the task and the release of a partner of any kind, by its id without a role."""
    match = _PARTNER.fullmatch(partner)
    if match is None:
        expected = f"task/NAME-vR, for example {TASKS[0]}/ippo-d3-s5-v1"
        raise IdError("partner id", expected, shorten(partner))
    return match["task"], match["release"]


def same_team(team: str, other: str) -> bool:
    """Return whether two team ids differ in their release at most.

    A release may take over a team of an earlier one.
    """
    return team.rpartition("-")[0] == other.rpartition("-")[0]


def release_number(name: str) -> int:
    """Return the number by which releases are ordered: v9 comes before v10."""
    return int(name.rpartition(":")[2][1:])


def check_name(what: str, text: str) -> str:
    """Return a release's name, or a namespace, unchanged if the grammar accepts it."""
    if not isinstance(text, str) or not text or not _PATTERNS[what].fullmatch(text):
        raise IdError(what, f"text like {_EXAMPLES[what]!r}", shorten(text))
    return text


def with_release(name: str, release_of: Callable[[str, str], str]) -> str:
    """Return an id, or a glob over ids, with the task's default release where it names none.

    Args:
        name: Such as "scratch/ippo-d3-s5", "scratch/ippo-d3-s[01]/human", "lab:scratch/*".
        release_of: Returns a task's default release in the zoo of a namespace, "" for this one.

    Returns:
        The name unchanged if it names a release, if it can match one, or if its task is a glob.
    """
    role = next((f"/{role}" for role in ROLES if name.endswith(f"/{role}")), "")
    stem = name.removesuffix(role)
    place = _PLACE.fullmatch(stem)
    if place is None or _NAMES_RELEASE.search(stem):
        return name
    release = release_of(place["task"], place["namespace"] or "")
    return f"{stem}-{release.rpartition(':')[2]}{role}"


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """Return a regular expression for a glob over whole ids; `*` may cross a `/`."""
    return re.compile(fnmatch.translate(pattern))
