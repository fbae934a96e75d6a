"""Environments for training with other libraries: hundreds of simulations, partners inside."""

import fnmatch
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack, overload

from assistax_base.errors import SplitError, listing, shorten
from assistax_envs.versions import TASKS
from assistax_zoo.zoos import open_zoo
from zoo.partners.kinds import kinds

if TYPE_CHECKING:
    from pathlib import Path

    from assistax_envs.adapters.gymnasium import AssistaxVectorEnv
    from assistax_envs.adapters.jaxmarl import AssistaxMarlVectorEnv
    from assistax_envs.adapters.partners import Partners
    from assistax_envs.adapters.pettingzoo import AssistaxParallelVectorEnv
    from assistax_envs.adapters.stable_baselines import AssistaxVecEnv
    from assistax_zoo.zoos import Zoo
    from zoo.registry import Registry
    from zoo.schema import Split

FORMS = ("gymnasium", "sb3", "pettingzoo", "jaxmarl")


class _Options(TypedDict, total=False):
    """Arguments of `vector_env` that its forms share."""

    partners: str | Sequence[str] | None
    split: str | None
    preferences: str | Sequence[str]
    arrays: str
    backend: str
    weights: Mapping[str, float] | None
    zoo: "str | Path | Zoo | None"


# One for each form. ty takes `Unpack` for any keywords, where it stands for those of `_Options`.
@overload
def vector_env(  # ty: ignore[inconsistent-overload-implementation]
    task: str, num_envs: int = 512, *, form: Literal["gymnasium"] = ..., **options: Unpack[_Options]
) -> "AssistaxVectorEnv": ...
@overload
def vector_env(  # ty: ignore[inconsistent-overload-implementation]
    task: str, num_envs: int = 512, *, form: Literal["sb3"], **options: Unpack[_Options]
) -> "AssistaxVecEnv": ...
@overload
def vector_env(  # ty: ignore[inconsistent-overload-implementation]
    task: str, num_envs: int = 512, *, form: Literal["pettingzoo"], **options: Unpack[_Options]
) -> "AssistaxParallelVectorEnv": ...
@overload
def vector_env(  # ty: ignore[inconsistent-overload-implementation]
    task: str, num_envs: int = 512, *, form: Literal["jaxmarl"], **options: Unpack[_Options]
) -> "AssistaxMarlVectorEnv": ...
@overload
def vector_env(  # ty: ignore[inconsistent-overload-implementation]
    task: str, num_envs: int = 512, *, form: str = ..., **options: Unpack[_Options]
) -> Any: ...
def vector_env(
    task: str,
    num_envs: int = 512,
    *,
    partners: str | Sequence[str] | None = None,
    split: str | None = None,
    preferences: str | Sequence[str] = (),
    form: str = "gymnasium",
    arrays: str = "numpy",
    backend: str = "auto",
    weights: Mapping[str, float] | None = None,
    zoo: "str | Path | Zoo | None" = None,
) -> Any:
    """Return an environment in which a robot trains with the partners of a split's training side.

    Every episode brings each simulation the next partner, under its own disability setting.
    Partners of the test side are refused.

    Args:
        task: Task, such as "gentle_scratch".
        num_envs: N, simulations; 512 keep two cores busy.
        partners: Teams of the training side, such as ("scratch/ippo-d1-s1",), or patterns of
            them; default all. Or "persons", as a gentle task has them by default: a new one each
            episode.
        split: Split whose training side is meant; default the release's own.
        preferences: Preferences of a gentle task's humans, such as "p2,p3" or ("p2", "p3"), drawn
            for each episode; default those of the split's training side, or all. Persons have their
            own.
        form: "gymnasium", a `VectorEnv`; "sb3", a `VecEnv` of Stable-Baselines3; "pettingzoo", a
            `ParallelEnv` of batches; or "jaxmarl", pure functions of batches.
        arrays: "numpy" or "jax", whose arrays `torch.from_dlpack` takes without a copy.
        backend: Physics, or "auto" for the fastest one here.
        weights: Reward weights that replace those of the task.
        zoo: Where the partners come from, as in `open_zoo`.

    Raises:
        ValueError: An argument is not allowed.
        ZooError: There is no such split, a partner is not of its training side, or cannot be read.
        ImportError: The form's package is not installed.

    Examples:
        >>> env = vector_env("scratch", 4, partners="scratch/ippo-d1-*", backend="native")
        >>> obs, info = env.reset(seed=0)
        >>> obs.shape
        (4, 34)
    """
    if task not in TASKS:
        raise ValueError(f"task is {task!r}; allowed are {', '.join(TASKS)}")
    if form not in FORMS:
        raise ValueError(f"form is {form!r}; allowed are {', '.join(FORMS)}")
    if form in ("sb3", "jaxmarl") and arrays != "numpy":
        raise ValueError(f"arrays is {arrays!r}, but form {form!r} has its own kind of arrays")
    if isinstance(partners, str) and partners in {kind.word for kind in kinds()}:
        if split or preferences:
            raise ValueError(f"{partners} have no split and no preferences; leave these out")
        humans: Partners = _made(task, partners, open_zoo(zoo).registry)
        version = None
    else:
        humans, version = _published(task, partners, split, preferences, zoo)
    how: dict[str, Any] = {
        "backend": backend,
        "weights": dict(weights) if weights else None,
        "version": version,
    }
    if form == "jaxmarl":
        from assistax_envs.adapters.jaxmarl import AssistaxMarlVectorEnv

        return AssistaxMarlVectorEnv(task, num_envs, humans, **how)
    if form == "pettingzoo":
        from assistax_envs.adapters.pettingzoo import AssistaxParallelVectorEnv

        return AssistaxParallelVectorEnv(task, num_envs, humans, arrays=arrays, **how)
    from assistax_envs.adapters.gymnasium import AssistaxVectorEnv

    env = AssistaxVectorEnv(task, num_envs, humans, arrays=arrays, **how)
    if form == "gymnasium":
        return env
    from assistax_envs.adapters.stable_baselines import AssistaxVecEnv

    return AssistaxVecEnv(env)


def _made(task: str, word: str, registry: "Registry") -> "Partners":
    """Return the training side of the default split of the kind of partner that a word names.

    Raises:
        ValueError: The task has no such partners.
        SplitError: It has no persons.
    """
    from assistax_envs.adapters.partners import Persons
    from evaluation.training_partners import load_partners
    from population.partners.rotating import RotatingPartners

    source = next(source for source in registry.sources if source.word == word)
    if (dealt := source.split(task, word)) is None:
        raise ValueError(f"task {task!r} has no {word}; choose other partners")
    if source.drawn:
        return Persons(task)
    return RotatingPartners(load_partners(registry, dealt))


def _published(
    task: str,
    partners: str | Sequence[str] | None,
    split: str | None,
    preferences: str | Sequence[str],
    zoo: "str | Path | Zoo | None",
) -> "tuple[Partners, int | None]":
    """Return partners of a split's training side, and the version of the environment they play.

    Nothing of the test side is loaded.
    """
    from assistax_envs.adapters.partners import Persons
    from assistax_envs.preferences import PREFERENCES
    from evaluation.training_partners import networks, older_version
    from population.partners.rotating import RotatingPartners

    opened = open_zoo(zoo)
    chosen = opened.registry.split(task, split)
    patterns = [partners] if isinstance(partners, str) else partners
    patterns = None if patterns is None else [opened.registry.full(name) for name in patterns]
    names = chosen.train if patterns is None else _of_training_half(chosen, patterns)
    drawn = tuple(preferences.split(",") if isinstance(preferences, str) else preferences)
    if unknown := [name for name in drawn if name not in PREFERENCES]:
        raise ValueError(f"preference is {unknown[0]!r}; allowed are {', '.join(PREFERENCES)}")
    source = opened.registry.source_of_split(chosen)
    if source.drawn:
        if drawn:
            raise ValueError(f"{source.word} have no preferences to choose; leave these out")
        if patterns is None:
            return Persons(task), None
        kinds = {opened.registry.source_of(name) for name in names}
        if len(kinds) > 1:
            raise ValueError(
                f"{source.word} and teams are named; name partners of one kind, since simulations "
                "meet them in turns"
            )
        if source in kinds:
            rows = [entry.row for entry in source.known(f"{name}/human" for name in names)]
            return Persons(task, rows), None
    humans = [f"{team}/human" for team in names]
    if opened.remote is not None:
        opened.fetch(humans)
    frozen = networks(opened.registry, humans)
    drawn = drawn or tuple(chosen.preferences.get("train", ()))
    return RotatingPartners(frozen, drawn), older_version(opened.registry, chosen)


def _of_training_half(split: "Split", patterns: Sequence[str]) -> list[str]:
    """Return the teams of a split's training side that match.

    Raises:
        SplitError: A pattern matches none, or is the name of a team outside the training side.
    """
    teams: dict[str, None] = {}
    for pattern in patterns:
        team = pattern.removesuffix("/human")
        matching = fnmatch.filter(split.train, team)
        if not matching:
            tested = fnmatch.filter(split.test, team)
            raise SplitError(
                f"partner {shorten(pattern)}",
                f"of the training side of {split.id}, such as {listing(split.train, 2)}",
                "one of its test side" if tested else "none there",
                "name others, or choose another split",
                "nothing was loaded",
            )
        teams |= dict.fromkeys(matching)
    if not teams:
        raise ValueError("no partner is named; leave partners out to have all")
    return list(teams)
