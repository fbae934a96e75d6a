"""Methods of training robots that installed packages add."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from assistax_base.extensions import METHODS, ExtensionError
from population import hyperparameters
from population.config import MIXED, Member, TrainConfig
from population.hyperparameters import PPOConfig, robot_preset
from population.methods.method import Method, method_class, register
from population.runs.folder import RunFolder

PATIENT = "outside_methods:Patient"
MODULE = """
from population.methods.method import Method

class Patient(Method):
    preset = {"latent": 4, "gamma": 0.5}

class Wrong(Method):
    preset = {"gama": 0.5}
"""


@pytest.fixture
def install(install_package: Callable[..., None], tmp_path: Path) -> Iterator[Callable[..., None]]:
    """Return a function that installs a package with a method, such as a class of `MODULE`."""
    (tmp_path / "outside_methods.py").write_text(MODULE)
    yield lambda name, place: install_package(METHODS, name, place)
    sys.modules.pop("outside_methods", None)


def test_an_installed_method_has_a_preset(install: Callable[..., None]) -> None:
    install("patient", PATIENT)
    config = robot_preset("patient", num_envs=8)
    assert isinstance(config, PPOConfig)
    assert (config.method, config.latent, config.gamma) == ("patient", 4, 0.5)
    assert config.packages == {"outside": "0.3"} and robot_preset("liam").packages == {}
    assert issubclass(method_class("patient"), Method)
    assert hyperparameters.methods()[-1] == "patient"
    with pytest.raises(ValueError, match="there is a method 'patient' already"):
        register("patient", Method)


def test_unknown_methods_list_the_installed_ones(install: Callable[..., None]) -> None:
    install("patient", PATIENT)
    with pytest.raises(ValueError, match=r"algorithm is 'sarsa'; allowed are ppo, .*rma, patient$"):
        robot_preset("sarsa")
    with pytest.raises(ValueError, match=r"method is 'sarsa'; allowed are gru, .*patient, and"):
        PPOConfig(method="sarsa")


@pytest.mark.parametrize(
    ("name", "place", "message"),
    [
        ("liam", "outside_methods:Patient", r"package outside 0\.3 .* method of assistax-zoo"),
        ("wrong", "outside_methods:Wrong", r"outside 0\.3 .* unknown hyperparameter gama"),
        ("pi", "math:pi", r"a subclass of .*Method`, found 3\.14"),
    ],
)
def test_unfit_method_is_refused_with_its_package(
    install: Callable[..., None], name: str, place: str, message: str
) -> None:
    install(name, place)
    with pytest.raises(ExtensionError, match=message):
        robot_preset(name)


def test_a_received_run_names_a_method_without_importing_it(
    install: Callable[..., None], tmp_path: Path
) -> None:
    members = (Member(0, MIXED),)
    config = TrainConfig("toy", "gru", members, 8, robot_preset("gru", num_envs=8))
    run = RunFolder(tmp_path / "run")
    run.open(config, {}, resume=True)
    text = (run.folder / "config.json").read_text()
    (run.folder / "config.json").write_text(text.replace('"method": ""', '"method": "patient"'))
    with pytest.raises(ValueError, match="method is 'patient'; allowed are gru"):
        run.config()
    install("patient", PATIENT)
    trainer = run.config().trainer
    assert isinstance(trainer, PPOConfig) and trainer.method == "patient"
    assert "outside_methods" not in sys.modules
