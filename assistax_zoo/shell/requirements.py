"""Comparison of the declared requirements with the installed packages."""

import contextlib
import dataclasses
from importlib.metadata import PackageNotFoundError, metadata, requires, version

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from assistax_zoo.shell.installed import ELSEWHERE

NAME = "assistax-zoo"


@dataclasses.dataclass(frozen=True)
class Missing:
    """A package that is missing, or installed in a version that is not allowed."""

    name: str
    requirement: str  # as pip takes it
    installed: str | None

    @property
    def told(self) -> str:
        """The problem in a few words."""
        return f"{self.name} {self.installed}" if self.installed else self.name


def version_of(name: str) -> str | None:
    """Return the version of a package; None if it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def required_python() -> SpecifierSet | None:
    """Return the versions of Python that this package allows; None if it does not declare them."""
    try:
        text = metadata(NAME)["Requires-Python"]
    except PackageNotFoundError:
        return None
    return SpecifierSet(text) if text else None


def extras() -> list[str]:
    """Return the names of the extras. A checkout that is not installed has no extras."""
    try:
        return metadata(NAME).get_all("Provides-Extra") or []
    except PackageNotFoundError:
        return []


def missing_of(extra: str) -> list[Missing]:
    """Return an extra's packages that are missing or too old.

    "" is what is always needed, by the workshop and the board too where they are installed.

    Raises:
        ValueError: This is a checkout that is not installed, and nothing says what it needs.
    """
    try:
        needs = [*(requires(NAME) or ())]
    except PackageNotFoundError:
        raise ValueError(f"{NAME} is not installed; install it with: pip install -e .") from None
    for other in () if extra else ELSEWHERE:
        with contextlib.suppress(PackageNotFoundError):
            needs += requires(other) or ()
    missing = []
    for text in dict.fromkeys(needs):
        requirement = Requirement(text)
        always = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        needed = always if not extra else _only_with(requirement, extra)
        have = version_of(requirement.name)
        if needed and (have is None or not requirement.specifier.contains(have, prereleases=True)):
            missing.append(
                Missing(requirement.name, f"{requirement.name}{requirement.specifier}", have)
            )
    return missing


def _only_with(requirement: Requirement, extra: str) -> bool:
    marker = requirement.marker
    return marker is not None and marker.evaluate({"extra": extra}) > marker.evaluate({"extra": ""})
