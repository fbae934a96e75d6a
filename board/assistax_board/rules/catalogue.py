"""Tasks, public panels and versions of the scorer."""

import functools
from typing import Any, Protocol

from assistax_base.digest import json_sha256

HIDDEN_EPISODES = 16  # at least, with each partner of panels A and B
CHUNK = 25  # partners in a job: 200 to 450 simulations, seconds of two cores
PUBLIC_SEED = 0  # of the public half's episodes, the same for all


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
        """Return the reference egos, self-play where all partners have robots, published egos.

        An ego that was trained with partners of the panel measures nothing there.
        """
        from evaluation.figures.normalised import REFERENCE_ROWS, SELF_PLAY
        from zoo.ids import EGO
        from zoo.met.claims import known_humans
        from zoo.met.published import met_in_training

        robots = self._registry.of_task(task, "robot")
        methods = {name: name for name in REFERENCE_ROWS}
        if not {entry.team for entry in self._entries(task)} <= {entry.team for entry in robots}:
            del methods[SELF_PLAY]
        egos = [
            entry
            for entry in robots
            if entry.disability == EGO
            and not known_humans(
                self._entries(task), met_in_training(self._registry, entry).partners
            )
        ]
        return methods | {ego.team.partition("/")[2]: f"{ego.algorithm} ego" for ego in egos}

    def _entries(self, task: str) -> list[Any]:
        return public_entries(self._registry, task)
