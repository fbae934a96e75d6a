from collections.abc import Callable
from pathlib import Path

import pytest

from assistax_base import extensions
from assistax_base.extensions import METHODS, ExtensionError


def test_an_entry_point_is_found_and_loaded(install_package: Callable[..., None]) -> None:
    install_package(METHODS, "mean", "statistics:fmean")
    found = extensions.extensions(METHODS, taken=["gru"])["mean"]
    assert (found.value, found.package, found.version) == ("statistics:fmean", "outside", "0.3")
    assert found.load()([1.0, 3.0]) == 2.0
    assert "mean" not in extensions.extensions(extensions.TASKS)


@pytest.mark.parametrize("metadata", [None, "", "Metadata-Version: 2.1\nName: outside\n"])
def test_a_damaged_installation_is_read(
    install_package: Callable[..., None], tmp_path: Path, metadata: str | None
) -> None:
    install_package(METHODS, "mean", "statistics:fmean")
    file = tmp_path / "outside-0.3.dist-info/METADATA"
    file.unlink() if metadata is None else file.write_text(metadata)
    found = extensions.extensions(METHODS)["mean"]
    assert (found.package, found.version) == ("outside" if metadata else "unknown", "unknown")


def test_reading_imports_nothing(install_package: Callable[..., None]) -> None:
    install_package(METHODS, "absent", "no_such_module:Thing")
    assert extensions.extensions(METHODS)["absent"].value == "no_such_module:Thing"


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        ("no_such_module:Thing", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("statistics:no_such_name", "module 'statistics' has no attribute 'no_such_name'"),
        ("broken_outside:Thing", "ZeroDivisionError: division by zero"),
    ],
)
def test_a_broken_entry_names_its_package(
    install_package: Callable[..., None], tmp_path: Path, value: str, problem: str
) -> None:
    install_package(METHODS, "thing", value)
    (tmp_path / "broken_outside.py").write_text("1 / 0\n")
    with pytest.raises(ExtensionError) as caught:
        extensions.extensions(METHODS)["thing"].load()
    message = str(caught.value)
    assert message.startswith(f"the method 'thing' of the package outside 0.3 ({value}): expected ")
    assert problem in message and "uninstall the package" in message


def test_a_package_cannot_take_a_name_in_use(install_package: Callable[..., None]) -> None:
    install_package(METHODS, "mean", "statistics:fmean")
    with pytest.raises(ExtensionError, match=r"package outside 0\.3 .* method of assistax-zoo"):
        extensions.extensions(METHODS, taken=["mean"])
    install_package(METHODS, "mean", "statistics:mean", package="second")
    with pytest.raises(ExtensionError, match=r"package second 0\.3 .* of a method of outside 0\.3"):
        extensions.extensions(METHODS)


@pytest.mark.parametrize("name", ["Mean", "the-mean", "_mean", "mean_", "1mean", "a.b"])
def test_a_malformed_name_is_refused(install_package: Callable[..., None], name: str) -> None:
    install_package(METHODS, name, "statistics:fmean")
    with pytest.raises(ExtensionError, match="a name of lower-case letters, digits and underscore"):
        extensions.extensions(METHODS)
