"""Kinds of partners of installed packages, by entry points."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assistax_base.digest import sha256
from assistax_base.extensions import PARTNERS, ExtensionError
from assistax_envs.disability import Disability
from assistax_envs.versions import VERSIONS
from population.networks.seat import SeatSizes
from population.networks.stack import PolicyStack
from zoo.exports.card import find_cards
from zoo.ids import compile_pattern
from zoo.partners.kinds import kinds
from zoo.partners.source import PartnerSource, made_entry
from zoo.registry import Registry, read_registry
from zoo.splits import made_split

ROOT, TASK = Path(__file__).parents[2], "scratch"


@dataclasses.dataclass(frozen=True)
class StillSpec(SeatSizes):
    """Humans who do nothing."""


class Still(PartnerSource):
    """Four humans who do nothing, each of another strength."""

    word = "still"

    @classmethod
    def owns(cls, name):
        return "/still-" in name

    def select(self, patterns):
        matches = [compile_pattern(pattern).match for pattern in patterns]
        return [e for e in self._all() if any(m(e.id) or m(e.team) for m in matches)]

    def split(self, task, name, release=None):
        if task != TASK or name is None or "still" not in name:
            return None
        teams = [entry.team for entry in self._all()]
        return made_split(self.word, task, self._release, teams[:2], teams[2:])

    def stacks(self, entries):
        params = {"strength": np.array([[e.setting.strength] for e in entries], np.float32)}
        return (PolicyStack(entries[0].spec, tuple(e.id for e in entries), params),)

    @property
    def _release(self):
        return self.registry.release_of(TASK)

    def _all(self):
        spec: Any = StillSpec("human", 40, 3)
        for number in range(4):
            team = f"{TASK}/still-{number}-{self._release}"
            yield made_entry(
                spec,
                TASK,
                team,
                algorithm="still",
                number=number,
                digest=sha256(team.encode()),
                env_version=VERSIONS[TASK],
                setting=Disability(0.2 + 0.2 * number, 1.0, 0.0),
                disability=f"still{number}",
                release=self._release,
            )


@pytest.fixture
def official() -> Registry:
    registry = read_registry(ROOT / "registry.json")
    return dataclasses.replace(registry)  # which has asked no kind yet


@pytest.fixture(autouse=True)
def forget() -> Iterator[None]:
    kinds.cache_clear()
    yield
    kinds.cache_clear()


def test_package_adds_a_kind(install_package: Callable[..., None], official: Registry) -> None:
    install_package(PARTNERS, "still", f"{__name__}:Still")
    release = official.release_of(TASK)
    entry = official.policy(f"{TASK}/still-1-{release}/human")
    assert official.env_version(entry) == VERSIONS[TASK]
    assert len(official.select(f"{TASK}/still-*")) == 4
    assert not any("still" in entry.id for entry in official.select(f"{TASK}/*"))
    [stack] = official.stacks(official.select(f"{TASK}/still-*"))
    assert len(stack) == 4 and stack.spec.humans(stack.params, ["d1"] * 4, None)
    split = official.split(TASK, "still")
    assert official.source_of_split(split).word == "still"
    source = official.source_asked(None, "still")
    assert source is official.source_of(entry.id) and official.source_asked("still:train", None)
    chosen, entries = source.choose(TASK, None, "still")
    assert chosen == split and [entry.team for entry in entries] == list(split.test)
    [card] = find_cards(official, entry.id)
    assert card["disability"]["strength"] == pytest.approx(0.4)
    with pytest.raises(ValueError, match="still are of another kind, so play them in a separate"):
        official.source_asked(None, ["still", "gentle_scratch/person-00042-v3"])


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("still", f"{__name__}:ROOT", "a subclass of PartnerSource"),
        ("still", "zoo.partners.source:PartnerSource", "the word None"),
        ("other", f"{__name__}:Still", "`word` is 'other'.*the word 'still'"),
        ("persons", "zoo.partners.persons:Persons", "a partner kind of assistax-zoo"),
    ],
)
def test_broken_or_colliding_kind_is_named(
    install_package: Callable[..., None], official: Registry, name: str, value: str, words: str
) -> None:
    install_package(PARTNERS, name, value)
    with pytest.raises(ExtensionError, match=words):
        official.select("scratch/*")
