"""After a cast is made, a study asks no registry."""

import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import assistax_zoo as az
from evaluation.cast.cast import Cast
from tests import untrained
from zoo import splits
from zoo.registry import Registry

ZOO = str(Path(splits.__file__).parent)
TEAMS = ["scratch/ippo-d1-s0-v0", "scratch/ippo-d1-s1-v0"]
OPTIONS: Any = {"task": "scratch", "episodes": 1, "backend": "native", "progress": False}


@pytest.fixture
def zoo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> az.Zoo:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 2)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return az.open_zoo(untrained.published(untrained.teams_of(4), tmp_path / "zoo"))


@pytest.fixture
def entered(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Functions of `zoo` that any thread enters after a cast is made; all registries are gone."""
    names: list[str] = []

    def watch(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(ZOO):
            names.append(frame.f_code.co_qualname)

    make: Callable[..., Cast] = Cast.of

    def refuse(registry: Registry, name: str) -> Any:
        pytest.fail(f"the registry was asked for {name}")

    def made(*args: Any, **options: Any) -> Cast:
        cast = make(*args, **options)
        gone.setattr(Registry, "__getattribute__", refuse)
        threading.setprofile(watch)
        sys.setprofile(watch)
        return cast

    monkeypatch.setattr(Cast, "of", made)
    with pytest.MonkeyPatch.context() as gone:
        yield names, gone
    sys.setprofile(None)
    threading.setprofile(None)


def cross_play(zoo: az.Zoo, tmp_path: Path) -> Any:
    return az.cross_play(TEAMS, TEAMS, zoo=zoo, **OPTIONS)


def evaluate(zoo: az.Zoo, tmp_path: Path) -> Any:
    robots = ["scratch/ippo-d1-s0-v0/robot", lambda obs: obs[:, :7]]
    return az.evaluate(robots, split="both", out=tmp_path / "out", zoo=zoo, **OPTIONS)


@pytest.mark.slow
@pytest.mark.parametrize("study", [cross_play, evaluate])
def test_cast_needs_no_registry_afterwards(
    study: Callable[[az.Zoo, Path], Any], zoo: az.Zoo, tmp_path: Path, entered: Any
) -> None:
    (names, gone), registry = entered, zoo.registry
    result = study(zoo, tmp_path)
    assert names == []
    assert result.episodes.height > 0
    with pytest.raises(pytest.fail.Exception, match="was asked for policies"):
        registry.policies  # noqa: B018
    gone.undo()
    registry.root("v0")
    assert "Registry.root" in names, "the watch sees who asks"


def test_a_cast_without_baselines_plays_none(zoo: az.Zoo, tmp_path: Path) -> None:
    from evaluation.cast.cast import choose_partners
    from evaluation.evaluate import cast_robots, evaluate
    from evaluation.play.how import PlaySettings

    partners = choose_partners(zoo.registry, "scratch", None, None)
    cast = cast_robots(zoo.registry, ["scratch/ippo-d1-s0-v0/robot"], partners)
    how = PlaySettings("scratch", 1, backend="native")
    with pytest.raises(ValueError, match="make it with `cast_robots`"):
        evaluate(cast, how, tmp_path / "out", references=tmp_path / "kept")
