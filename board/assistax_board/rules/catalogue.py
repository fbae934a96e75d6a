"""Tasks, public panels and versions of the scorer."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, Protocol

from assistax_base.digest import json_sha256
from assistax_board.cards import Card

HIDDEN_EPISODES = 16  # at least, with each partner of panels A and B
CHUNK = 25  # partners in a job: 200 to 450 simulations, seconds of two cores
PUBLIC_SEED = 0  # of the public half's episodes, the same for all


@dataclasses.dataclass(frozen=True)
class ZooEntry:
    """A method of the zoo whose robots are declared as one entry."""

    method: str
    card: Card
    seeds: Mapping[str, str]  # sha256 of each robot's parameters by its name in the registry


class Catalogue(Protocol):
    """Tasks of a service. Tests have a small one that needs no registry."""

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks that have a board."""
        ...

    def public_panel(self, task: str) -> tuple[str, ...]:
        """Return the ids of the public test partners, in the order that cuts them into jobs."""
        ...

    def identity(self, task: str) -> dict[str, Any]:
        """Return all that determines a score besides the robot; see `version_id`."""
        ...

    def references(self, task: str) -> dict[str, str]:
        """Return the rows that a board measures by: the method that each robot is a seed of."""
        ...

    def published(self, task: str) -> tuple[ZooEntry, ...]:
        """Return the zoo's methods that are among the references, each with all of its seeds."""
        ...


def version_id(identity: dict[str, Any]) -> str:
    """Return the id of a version: scores of two are never mixed."""
    return json_sha256(identity)


def public_entries(registry: Any, task: str) -> list[Any]:
    """Return the public test partners: one spec after another compiles least."""
    from evaluation.cast.cast import choose_partners

    _, chosen = choose_partners(registry, task, None, None)
    return sorted(chosen, key=lambda entry: (entry.spec.digest, entry.id))


def panel_episodes(task: str, panel: str) -> int:
    """Return how many episodes each partner of a panel plays: all its preferences equally often."""
    from evaluation.play.how import default_episodes

    usual = default_episodes(task)
    return usual if panel == "public" else max(usual, HIDDEN_EPISODES)


class ZooCatalogue:
    """The catalogue of a registry, as it is installed here. Imports no JAX."""

    def __init__(self, registry: Any, backend: str) -> None:
        self._registry, self._backend = registry, backend

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks that have a board."""
        releases = self._registry.data.releases.items()
        return tuple(
            task
            for name, release in releases
            for task in {**release.splits, **release.persons}
            if name == self._registry.release_of(task)
        )

    @functools.cache  # noqa: B019
    def public_panel(self, task: str) -> tuple[str, ...]:
        """Return the ids of the public test partners."""
        return tuple(entry.id for entry in self._entries(task))

    @functools.cache  # noqa: B019
    def identity(self, task: str) -> dict[str, Any]:
        """Return evaluator, environment, engine, public panel, and its humans' preferences."""
        from importlib.metadata import version

        from assistax_envs.persons.rows import PROGRAM_VERSION
        from assistax_envs.preferences import preferences_of
        from assistax_envs.versions import engine
        from evaluation.play.jobs import EVALUATOR_VERSION

        preferences = self._registry.split(task).preferences.get("test") or preferences_of(task)
        optional: dict[str, Any] = {"preferences": list(preferences)} if preferences else {}
        if preferences_of(task):
            optional["persons"] = PROGRAM_VERSION  # whom a season may hide
            optional["m_test"] = "mean of the groups' means"
        return optional | {
            "task": task,
            "env_version": self._registry.env_version(self._entries(task)[0]),
            "evaluator": EVALUATOR_VERSION,
            "engine": engine(self._backend),
            "jax": version("jax"),
            "panel": json_sha256([[entry.id, entry.sha256] for entry in self._entries(task)]),
            "episodes": panel_episodes(task, "public"),
            "hidden_episodes": panel_episodes(task, "A"),
            "starts": "own",  # of each partner, the same for every robot
            "chunk": CHUNK,
            "seed": PUBLIC_SEED,
        }

    def references(self, task: str) -> dict[str, str]:
        """Return the reference egos, self-play where all partners have robots, published egos."""
        from evaluation.figures.normalised import REFERENCE_ROWS, SELF_PLAY

        methods = {name: name for name in REFERENCE_ROWS}
        teams = {entry.team for entry in self._registry.of_task(task, "robot")}
        if not {entry.team for entry in self._entries(task)} <= teams:
            del methods[SELF_PLAY]
        return methods | {_name(ego): _method(ego) for ego in self._egos(task)}

    def published(self, task: str) -> tuple[ZooEntry, ...]:
        """Return the methods of the published egos, with what the registry knows of them."""
        by_method: dict[str, list[Any]] = {}
        for ego in self._egos(task):
            by_method.setdefault(_method(ego), []).append(ego)
        return tuple(
            ZooEntry(method, _card(egos), {_name(ego): ego.sha256 for ego in egos})
            for method, egos in sorted(by_method.items())
        )

    def _egos(self, task: str) -> list[Any]:
        """Return the published egos that did not train with partners of the public panel.

        One that did measures nothing there.
        """
        from zoo.ids import EGO
        from zoo.met.claims import known_humans
        from zoo.met.published import met_in_training

        return [
            ego
            for ego in self._registry.of_task(task, "robot")
            if ego.disability == EGO
            and not known_humans(self._entries(task), met_in_training(self._registry, ego).partners)
        ]

    def _entries(self, task: str) -> list[Any]:
        return public_entries(self._registry, task)


def _name(ego: Any) -> str:
    return ego.team.partition("/")[2]


def _method(ego: Any) -> str:
    return f"{ego.algorithm} ego"


def _card(egos: list[Any]) -> Card:
    """Return the card of a method's robots; of their trainings the registry knows no others."""
    first = egos[0]
    met = f"training side of {first.trained_against.split}" if first.trained_against else "none"
    code = f"assistax-zoo train-ego --task {first.task} --algorithm {first.algorithm}"
    return Card(first.training.steps, met, code, len(egos))
