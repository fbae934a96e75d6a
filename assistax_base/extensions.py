"""What other installed packages add: tasks, partner kinds, methods, metrics and commands.

A package names each addition in an entry point of its `pyproject.toml`, in one of these groups.
Reading a group imports nothing. An addition is imported when it is used.
"""

import dataclasses
import functools
import importlib
import re
from collections.abc import Collection, Mapping
from importlib import metadata
from typing import Any

from assistax_base.errors import ZooError, printable

TASKS, PARTNERS = "assistax_zoo.tasks", "assistax_zoo.partners"
METHODS, METRICS = "assistax_zoo.methods", "assistax_zoo.metrics"
COMMANDS, HEADS = "assistax_zoo.commands", "assistax_zoo.groups"
# Groups, and what one of their entries is called in an error.
GROUPS = {
    **{TASKS: "task", PARTNERS: "partner kind", METHODS: "method", METRICS: "metric"},
    **{COMMANDS: "command", HEADS: "group of commands"},
}
NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")  # of an addition, as a part of ids has it
WORDS = re.compile(r"[a-z][a-z0-9-]*(\.[a-z][a-z0-9-]*)?")  # of a command: "plot.forces"
OURS = "assistax-zoo"


class ExtensionError(
    ZooError,
    done="nothing was loaded",
    next_step="uninstall the package, or ask its author for a corrected version",
):
    """An entry point of an installed package that cannot be used."""


@dataclasses.dataclass(frozen=True)
class Extension:
    """An entry point of an installed package."""

    group: str
    name: str
    value: str  # "MODULE:ATTRIBUTE"
    package: str  # its distribution's name
    version: str

    @property
    def module(self) -> str:
        """The module that the entry point names."""
        return self.value.partition(":")[0]

    def load(self) -> Any:
        """Return the object that the entry point names, importing its module.

        Raises:
            ExtensionError: The module cannot be imported, or lacks the attribute.
        """
        try:
            found: Any = importlib.import_module(self.module)
            for part in filter(None, self.value.partition(":")[2].split(".")):
                found = getattr(found, part)
        except (Exception, SystemExit) as error:
            raise self.error("MODULE:ATTRIBUTE that can be imported", _described(error)) from error
        return found

    def error(self, expected: str, found: str) -> ExtensionError:
        """Return an error of this entry point, which names its package."""
        return ExtensionError(
            f"the {GROUPS[self.group]} {self.name!r} of the package {self.package} {self.version} "
            f"({self.value})",
            expected,
            found,
        )


def extensions(group: str, taken: Collection[str] = ()) -> Mapping[str, Extension]:
    """Return the entry points of a group by name, in the order of their names.

    Args:
        group: One of `GROUPS`.
        taken: Names of assistax-zoo's own that no package may take.

    Raises:
        ExtensionError: A name is malformed, taken, or that of two packages.
    """
    found, errors = usable_extensions(group, taken)
    for error in errors.values():
        raise error
    return found


def usable_extensions(
    group: str, taken: Collection[str] = ()
) -> tuple[dict[str, Extension], dict[str, ExtensionError]]:
    """Return the entry points of a group that have a name of their own, and the others' errors.

    If two packages name the same addition, neither is usable.

    Args:
        group: One of `GROUPS`.
        taken: Names of assistax-zoo's own that no package may take.

    Returns:
        The usable entry points by name, and an error for each name that is malformed, taken, or
        that of two packages.
    """
    found: dict[str, Extension] = {}
    errors: dict[str, ExtensionError] = {}
    for extension in _read(group):
        name = extension.name
        pattern, joint = (WORDS, "hyphens") if group in (COMMANDS, HEADS) else (NAME, "underscores")
        if not pattern.fullmatch(name):
            expected = f"a name of lower-case letters, digits and {joint}"
            errors[name] = extension.error(expected, printable(name))
        elif name in taken or name in found:
            other = f"{found[name].package} {found[name].version}" if name in found else OURS
            problem = f"that of a {GROUPS[group]} of {other}"
            errors[name] = extension.error("a name of its own", problem)
        else:
            found[name] = extension
    return {name: e for name, e in found.items() if name not in errors}, errors


@functools.cache
def _read(group: str) -> tuple[Extension, ...]:
    """Return a group's entry points, read once in a process."""
    return tuple(
        sorted(
            (
                Extension(group, point.name, point.value, *_package(point.dist))
                for point in metadata.entry_points(group=group)
                if point.dist is not None
            ),
            key=lambda extension: (extension.name, extension.package),
        )
    )


def _package(distribution: metadata.Distribution) -> tuple[str, str]:
    """Return a distribution's name and version, or "unknown" where its metadata is damaged."""
    try:
        about = distribution.metadata
        fields = {field: about[field] for field in about}
    except TypeError:  # there is no file METADATA
        fields = {}
    return fields.get("Name", "unknown"), fields.get("Version", "unknown")


def _described(error: BaseException) -> str:
    return printable(f"{type(error).__name__}: {str(error).partition(chr(10))[0]}")[:300]
