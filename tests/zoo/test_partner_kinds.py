"""Kinds of partners of installed packages, by entry points."""

import dataclasses
import re
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
from zoo.partners.kinds import OWN_KINDS, broken_kinds, kinds
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
        official.source_asked(None, ["still", "gentle_scratch/person-00042-v1"])


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("still", f"{__name__}:ROOT", "a subclass of PartnerSource"),
        ("still", "zoo.partners.source:PartnerSource", "the word None"),
        ("other", f"{__name__}:Still", "`word` is 'other'.*the word 'still'"),
        ("validation", f"{__name__}:Still", "a word that is not a side of splits"),
    ],
)
def test_broken_kind_fails_only_queries_for_it(
    install_package: Callable[..., None], official: Registry, name: str, value: str, words: str
) -> None:
    before = official.split(TASK), official.split("gentle_scratch", "persons")
    kinds.cache_clear()
    installed = dataclasses.replace(official)
    install_package(PARTNERS, name, value)
    for pattern in (f"{TASK}/{name}-*", f"{TASK}/{name}-1-v1/human"):
        with pytest.raises(ExtensionError, match=words):
            installed.select(pattern)
    source = installed.source_asked(None, name)
    assert source is not None
    with pytest.raises(ExtensionError, match=words):
        source.choose(TASK, None, name)
    assert len(installed.select("scratch/*")) == len(official.select("scratch/*"))
    assert (installed.split(TASK), installed.split("gentle_scratch", "persons")) == before
    assert installed.source_asked("validation", None) is None
    assert re.search(words, str(broken_kinds()[0]))


@pytest.mark.parametrize("name", ["persons", "Still"])
def test_words_of_kinds_cannot_be_taken(
    install_package: Callable[..., None], official: Registry, name: str
) -> None:
    install_package(PARTNERS, name, f"{__name__}:Still")
    assert kinds() == OWN_KINDS
    [error] = broken_kinds()
    assert f"the partner kind '{name}' of the package outside 0.3" in str(error)


def test_two_packages_of_one_kind_are_refused(
    install_package: Callable[..., None], official: Registry
) -> None:
    install_package(PARTNERS, "still", f"{__name__}:Still")
    install_package(PARTNERS, "still", f"{__name__}:Still", package="twin")
    with pytest.raises(ExtensionError, match=r"package twin 0\.3 .* of outside 0\.3"):
        official.select("scratch/still-*")
