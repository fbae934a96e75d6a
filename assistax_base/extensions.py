"""Additions of other installed packages: tasks, partners, methods, metrics and commands.

A package names each addition in an entry point of its `pyproject.toml`, in one of these groups.
Reading a group imports nothing. An addition is imported when it is used.
"""

import dataclasses
import functools
import importlib.util
import re
from collections.abc import Collection, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from assistax_base.digest import json_sha256, sha256
from assistax_base.errors import ZooError, printable

TASKS, PARTNERS = "assistax_zoo.tasks", "assistax_zoo.partners"
METHODS, METRICS = "assistax_zoo.methods", "assistax_zoo.metrics"
FAMILIES = "assistax_zoo.families"
COMMANDS, HEADS = "assistax_zoo.commands", "assistax_zoo.groups"
# Groups, and what one of their entries is called in an error.
GROUPS = {
    **{TASKS: "task", PARTNERS: "partner kind", METHODS: "method", METRICS: "metric"},
    FAMILIES: "family of persons",
    **{COMMANDS: "command", HEADS: "group of commands"},
}
NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")  # of an addition, as a part of ids has it
WORDS = re.compile(r"[a-z][a-z0-9-]*(\.[a-z][a-z0-9-]*)?")  # of a command: "plot.forces"
OURS = "assistax-zoo"
MOST_FILES, MOST_BYTES = 500, 8 * 1024 * 1024  # of a package whose files are read


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

    def files(self) -> dict[str, bytes]:
        """Return the files of the package that holds the module, by path; nothing is imported.

        These are all files below the module's first package, without those that Python makes.

        Raises:
            ExtensionError: There is no such package, or it has too many or too large files.
        """
        first = self.module.partition(".")[0]
        spec = importlib.util.find_spec(first)
        paths: dict[str, Path] = {}
        folders = spec.submodule_search_locations if spec is not None else None
        for folder in map(Path, folders or ()):
            for path in folder.rglob("*"):
                if path.is_file() and "__pycache__" not in path.parts:
                    paths[f"{first}/{path.relative_to(folder).as_posix()}"] = path
        if spec is not None and spec.origin and not paths:
            paths[f"{first}.py"] = Path(spec.origin)
        size = sum(path.stat().st_size for path in paths.values())
        if not paths or len(paths) > MOST_FILES or size > MOST_BYTES:
            expected = f"a package of 1 to {MOST_FILES} files and at most {MOST_BYTES} bytes"
            raise self.error(expected, f"{len(paths)} files of {size} bytes in {first!r}")
        return {path: paths[path].read_bytes() for path in sorted(paths)}

    def error(self, expected: str, found: str) -> ExtensionError:
        """Return an error of this entry point, which names its package."""
        return ExtensionError(
            f"the {GROUPS[self.group]} {self.name!r} of the package {self.package} {self.version} "
            f"({self.value})",
            expected,
            found,
        )


def files_sha256(files: Mapping[str, bytes]) -> str:
    """Return the sha256 of files and their paths, as of a package."""
    return json_sha256({path: sha256(data) for path, data in files.items()})


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
