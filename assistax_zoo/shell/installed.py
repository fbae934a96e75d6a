"""Commands of the other installed distributions.

A distribution names them in its entry points: group `assistax_zoo.commands`, where "serve" is a
command and "token.create" one of a group or below another command, and `assistax_zoo.groups`, where
"token" is the text that help shows beside the group.
"""

import functools
from collections.abc import Sequence
from importlib import metadata, util

COMMANDS, GROUPS = "assistax_zoo.commands", "assistax_zoo.groups"
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


def installed_commands() -> dict[str, str]:
    """Return the import path of each command that another distribution brings."""
    return {point.name: point.value for point in _points(COMMANDS)}


def installed_groups() -> dict[str, str]:
    """Return the text of each group of commands that another distribution brings."""
    return {point.name: point.load() for point in _points(GROUPS)}


def check_installed(words: Sequence[str]) -> None:
    """Refuse a command whose distribution, or its package, is missing.

    Args:
        words: Words of the command line after the program's name.

    Raises:
        ValueError: It says what to install.
    """
    have = {*installed_commands(), *installed_groups()}
    for distribution, commands in ELSEWHERE.items():
        for command in commands:
            if tuple(words[: len(command)]) == command and ".".join(command) not in have:
                raise ValueError(
                    f"`{' '.join(command)}` belongs to {distribution}, which is not installed, or "
                    "only in part; install it in a clone of assistax-zoo with: "
                    f"{INSTALL[distribution]}"
                )


@functools.cache
def _points(group: str) -> tuple[metadata.EntryPoint, ...]:
    """Return a group's entry points, but for those whose package is missing."""
    return tuple(
        point
        for point in metadata.entry_points(group=group)
        if util.find_spec(point.module.partition(".")[0])
    )
