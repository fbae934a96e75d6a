"""Commands of the other installed distributions.

A distribution names them in its entry points: group `assistax_zoo.commands`, where "serve" is a
command and "token.create" one of a group or below another command, and `assistax_zoo.groups`, where
"token" is the text that help shows beside the group.
"""

import contextlib
import itertools
from collections.abc import Collection, Sequence
from importlib import util

from assistax_base.extensions import COMMANDS, HEADS, Extension, ExtensionError, usable_extensions

# First words of commands that stand in a distribution that may be missing.
ELSEWHERE = {
    "assistax-zoo-board": (
        ("serve",),
        ("worker",),
        ("submit",),
        ("submission",),
        ("token",),
        ("season",),
        ("receipt",),
        ("ledger",),
        ("service",),
    ),
    "assistax-zoo-workshop": (
        ("publish",),
        ("audit",),
        ("sweep",),
        ("gates",),
        ("train", "population"),
    ),
}
INSTALL = {
    "assistax-zoo-board": "pip install -e . -e ./workshop -e ./board",
    "assistax-zoo-workshop": "pip install -e . -e ./workshop",
}


def installed_commands(taken: Collection[str] = ()) -> dict[str, str]:
    """Return the import path of each command of another distribution, without `taken` names."""
    return {name: extension.value for name, extension in _extensions(COMMANDS, taken)[0].items()}


def installed_groups(taken: Collection[str] = ()) -> dict[str, str]:
    """Return the text of each group of commands of another distribution, if it can be loaded."""
    texts: dict[str, str] = {}
    for name, extension in _extensions(HEADS, taken)[0].items():
        with contextlib.suppress(ExtensionError):
            texts[name] = extension.load()
    return texts


def broken_commands(
    words: Sequence[str], commands: Collection[str], groups: Collection[str]
) -> dict[str, ExtensionError]:
    """Return the errors of other distributions' commands and groups that a help page would list.

    Args:
        words: Words of the command line after the program's name.
        commands: Commands of this distribution, which no package may replace.
        groups: Groups of commands of this distribution.

    Raises:
        ValueError: The command that is named belongs to a distribution that is missing. The error
            says what to install.
        ExtensionError: The command that is named, or its group, cannot be used.
    """
    if words and words[0].startswith("-") and words[0] not in ("--help", "-h"):
        return {}  # such as --version, which lists no commands
    named = list(itertools.takewhile(lambda word: not word.startswith("-"), words[:2]))
    broken: dict[str, ExtensionError] = {}
    have: set[str] = set()
    for group, taken in ((HEADS, groups), (COMMANDS, commands)):
        found, errors = _extensions(group, taken)
        have |= {*found, *errors}
        for name, extension in found.items():
            if _is_named(name, named) or _is_listed(name, named):
                errors |= _load_errors(name, extension)
        for name, error in errors.items():
            if name not in taken and _is_named(name, named):
                raise error
            if _is_listed(name, named):
                broken[name] = error
    _check_present(words, have)
    return broken


def all_errors(commands: Collection[str], groups: Collection[str]) -> list[ExtensionError]:
    """Return the errors of all commands and groups of other distributions that cannot be used.

    The arguments are those of `broken_commands`.
    """
    all_of_them: list[ExtensionError] = []
    for group, taken in ((HEADS, groups), (COMMANDS, commands)):
        found, errors = _extensions(group, taken)
        for name, extension in found.items():
            errors |= _load_errors(name, extension)
        all_of_them += errors.values()
    return all_of_them


def _is_named(name: str, named: Sequence[str]) -> bool:
    """Return whether the words of a command line name a command, such as "plot.forces"."""
    parts = name.split(".")
    return list(named[: len(parts)]) == parts


def _is_listed(name: str, named: Sequence[str]) -> bool:
    """Return whether the help of the named words lists a command."""
    return name.split(".")[:-1] == list(named)


def _load_errors(name: str, extension: Extension) -> dict[str, ExtensionError]:
    """Return the error of an entry point that cannot be loaded, by its name; empty if it can."""
    try:
        extension.load()
    except ExtensionError as error:
        return {name: error}
    return {}


def _check_present(words: Sequence[str], have: Collection[str]) -> None:
    """Refuse a command of a distribution that is missing, or installed only in part.

    Raises:
        ValueError: It says what to install.
    """
    for distribution, commands in ELSEWHERE.items():
        for command in commands:
            if tuple(words[: len(command)]) == command and ".".join(command) not in have:
                raise ValueError(
                    f"`{' '.join(command)}` belongs to {distribution}, which is not installed, or "
                    "only in part; install it in a clone of assistax-zoo with: "
                    f"{INSTALL[distribution]}"
                )


def _extensions(
    group: str, taken: Collection[str] = ()
) -> tuple[dict[str, Extension], dict[str, ExtensionError]]:
    """Return a group's usable entry points by name, and the errors of the others.

    Entry points whose package is missing are left out.
    """
    found, errors = usable_extensions(group, taken)
    there = {
        package
        for package in {e.module.partition(".")[0] for e in found.values()}
        if util.find_spec(package)
    }
    return {name: e for name, e in found.items() if e.module.partition(".")[0] in there}, errors
