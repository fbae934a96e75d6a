"""Commands of the other installed distributions.

A distribution names them in its entry points: group `assistax_zoo.commands`, where "serve" is a
command and "token.create" one of a group or below another command, and `assistax_zoo.groups`, where
"token" is the text that help shows beside the group.
"""

import itertools
from collections.abc import Collection, Mapping, Sequence
from importlib import util

from assistax_base.extensions import COMMANDS, HEADS, Extension, extensions

# First words of commands that stand in a distribution that may be missing.
ELSEWHERE = {
    "assistax-zoo-board": (
        ("serve",),
        ("worker",),
        ("submit",),
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
    """Return the import path of each command that another distribution brings.

    Raises:
        assistax_base.extensions.ExtensionError: A command has a `taken` name, or that of another
            distribution's.
    """
    return {name: extension.value for name, extension in _extensions(COMMANDS, taken).items()}


def installed_groups(taken: Collection[str] = ()) -> dict[str, str]:
    """Return the text of each group of commands that another distribution brings.

    Raises:
        assistax_base.extensions.ExtensionError: As for commands, or a text cannot be loaded.
    """
    return {name: extension.load() for name, extension in _extensions(HEADS, taken).items()}


def check_installed(words: Sequence[str]) -> None:
    """Refuse a command whose distribution, or its package, is missing or cannot be imported.

    Args:
        words: Words of the command line after the program's name.

    Raises:
        ValueError: It says what to install.
        assistax_base.extensions.ExtensionError: It names the package that cannot be imported.
    """
    if words and words[0].startswith("-") and words[0] not in ("--help", "-h"):
        return  # such as --version, which lists no commands
    named = list(itertools.takewhile(lambda word: not word.startswith("-"), words[:2]))
    for name, extension in _extensions(COMMANDS).items():
        parts = name.split(".")
        if named[: len(parts)] == parts or (len(named) < 2 and parts[: len(named)] == named):
            extension.load()  # the command itself, or one that the help of its group lists
    have = {*installed_commands(), *installed_groups()}
    for distribution, commands in ELSEWHERE.items():
        for command in commands:
            if tuple(words[: len(command)]) == command and ".".join(command) not in have:
                raise ValueError(
                    f"`{' '.join(command)}` belongs to {distribution}, which is not installed, or "
                    "only in part; install it in a clone of assistax-zoo with: "
                    f"{INSTALL[distribution]}"
                )


def _extensions(group: str, taken: Collection[str] = ()) -> Mapping[str, Extension]:
    """Return a group's entry points by name, but for those whose package is missing."""
    found = extensions(group, taken)
    there = {
        package
        for package in {e.module.partition(".")[0] for e in found.values()}
        if util.find_spec(package)
    }
    return {name: e for name, e in found.items() if e.module.partition(".")[0] in there}
