"""Every step of recorded episodes of people, for datasets of trajectories."""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import numpy as np

from assistax_envs.own_settings import own_settings
from evaluation.film import Act
from evaluation.people.grouping import PEOPLE, Placed
from evaluation.people.playing import begun, drawn, environment, visitors
from evaluation.record.manifest import describe_machine


class Recordings:
    """Episodes of people with one robot, played as `evaluation.film.Pair` plays a pair's."""

    def __init__(self, placed: Sequence[Placed]) -> None:
        self._logs = [one.replayed.recorded for one in placed]
        first = placed[0].replayed
        self.env = environment(self._logs[0].log.task)
        self.references = {"robot": first.robot.name, "human": PEOPLE}
        self._card = first.robot.card
        self._partners = [one.partner for one in placed]

    @property
    def about(self) -> dict[str, Any]:
        """Metadata of a recording: robot, people, task and machine."""
        return {
            "task": self.env.task,
            "environment_version": self.env.version,
            "backend": self.env.backend,
            "engine": self.env.engine,
            "robot": {
                "policy": self.references["robot"],
                "sha256": self._card.sha256 if self._card else None,
            },
            "human": {"policy": PEOPLE, "sha256": None},
            "seed": None,  # each episode has a start of its own
            "episodes": [
                {"partner": partner, "log": one.sha256, "start": one.log.start}
                for partner, one in zip(self._partners, self._logs, strict=True)
            ],
            "machine": describe_machine(),
        }

    def play(
        self,
        check: Callable[[], None],
        on_step: Callable[[], None] | None = None,
        episode: int = 0,
        heard: Callable[[str, Act], Act] = lambda role, act: act,
    ) -> Iterator[Any]:
        """Yield the states of an episode; see `evaluation.film.Pair.play`."""
        one = self._logs[episode]
        begin, step = _programs(self.env.task)
        state = begin(*drawn(one.log.task, [one.log.start]), visitors(one.log.task, [one.log.wish]))
        yield state
        for robot, human, word in zip(one.robot, one.human, one.words, strict=True):
            given = {"robot": robot, "human": human}
            acted = {
                role: heard(role, lambda obs, role=role, given=given: given[role])(human)[None]
                for role in given
            }
            state = step(state, acted | {"word": np.array([word], np.int32)})
            check()
            if on_step is not None:
                on_step()
            yield state


@functools.cache
def _programs(task: str) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the compiled begin and step of a task."""
    env, own = environment(task), own_settings()
    return own(jax.jit(functools.partial(begun, env))), own(jax.jit(env.step))
