"""Settings of a play: documented once, checked once, the same in Python and in a shell."""

import dataclasses
import inspect
from typing import Any

import pytest

import assistax_zoo as az
from evaluation.play.how import PlaySettings
from tests.evaluation.matrix_game import humans, robots
from tests.evaluation.test_series import job_of

DEFAULTS = {field.name: field.default for field in dataclasses.fields(PlaySettings)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"episodes": 0}, "episodes is 0; each pair needs at least 1"),
        ({"seed": -1}, "seed is -1; allowed is 0 or more"),
        ({"series": 0}, "series is 0.*; give 1 or more"),
        ({"episodes": 8, "series": 5}, "series is 5 of 8 episodes; .* a multiple of it"),
    ],
)
def test_invalid_numbers_are_refused_everywhere(changes: dict[str, int], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PlaySettings("scratch", **changes)
    with pytest.raises(ValueError, match=message):
        job_of(robots(0.5), humans(0.5), **changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"task": "cook"}, "task is 'cook'; allowed are scratch"),
        ({"max_envs": 0}, "max_envs is 0; allowed is 1 or more"),
        ({"preferences": "p1"}, "humans of scratch have no preferences"),
    ],
)
def test_wrong_setting_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PlaySettings(**{"task": "scratch", **changes})


def test_pair_plays_whole_series() -> None:
    assert PlaySettings("scratch").episodes_of_pair == 8
    assert PlaySettings("scratch", series=5).episodes_of_pair == 10
    assert PlaySettings("gentle_bath").episodes_of_pair == 18
    assert PlaySettings("gentle_bath", 9).episodes_of_pair == 9


@pytest.mark.parametrize(
    ("function", "lacks"), [(az.evaluate, set()), (az.cross_play, {"series"})], ids=["M", "XP"]
)
def test_python_functions_have_the_same_defaults(function: Any, lacks: set[str]) -> None:
    parameters = inspect.signature(function).parameters
    assert set(DEFAULTS) - set(parameters) == lacks
    for name in set(DEFAULTS) - lacks - {"task"}:
        assert parameters[name].default == DEFAULTS[name], name


def test_commands_have_the_settings_as_options(capsys: pytest.CaptureFixture[str]) -> None:
    from assistax_zoo.shell.main import run

    options = {name: f"--{name.replace('_', '-')} " for name in DEFAULTS}
    for command, lacks in (("evaluate", set()), ("crossplay", {"series"})):
        run([command, "--help"])
        shown = capsys.readouterr().out
        assert {name for name, option in options.items() if option not in shown} == lacks
