"""The grammar of references to policies."""

import dataclasses
import re
import urllib.parse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from assistax_envs.versions import TASKS

Kind = Literal["zoo", "file", "onnx", "python", "zero", "random"]

FORMS = (
    f"an id such as {TASKS[0]}/ppo-ego-s0, FILE.safetensors, FILE.onnx, FILE.py (its function "
    "make), python:FILE.py:FACTORY, python:package.module:FACTORY, zero, or random"
)
# An id or glob of a task, with the namespace of an added registry in front, as in lab:scratch/...
_ID = re.compile(rf"(?:[a-z][\w.-]*:)?({'|'.join(TASKS)})/.+")


DEFAULT_FACTORY = "make"  # of a Python file that is named alone


@dataclasses.dataclass(frozen=True)
class PolicyReference:
    """The parts of a reference, not yet looked up."""

    text: str  # the whole reference
    kind: Kind
    source: str = ""  # an id or a glob; a path; or a module, by its name or its file
    factory: str = ""  # the function of a Python module that makes the robot
    # Keyword arguments of the factory.
    arguments: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def check(self, task: str, role: str) -> None:
        """Check that an id is of this task and role, for a better message than "not found".

        Raises:
            ValueError: The id is of another task or role.
        """
        named = _ID.fullmatch(self.source)
        if self.kind != "zoo" or named is None:
            return
        if named[1] != task:
            raise ValueError(
                f"policy {self.text!r} is of task {named[1]}, not of {task}; name a policy of "
                f"{task}, or play {named[1]}"
            )
        other = "human" if role == "robot" else "robot"
        if self.source.endswith(f"/{other}"):
            raise ValueError(
                f"policy {self.text!r} is a {other}, not a {role}; its team's {role} is "
                f"{self.source.removesuffix(other)}{role}"
            )


def task_of(names: Iterable[Any]) -> str:
    """Return the task that the ids or globs among some references name.

    Raises:
        ValueError: No reference is an id, or two ids are of different tasks.
    """
    named = (_ID.fullmatch(str(name).removeprefix("zoo:")) for name in names)
    tasks = sorted({found[1] for found in named if found})
    if len(tasks) == 1:
        return tasks[0]
    found = f"names of {' and '.join(tasks)} are given" if tasks else "no name says it"
    raise ValueError(
        f"which task is played is open, because {found}; name the task: allowed are "
        f"{', '.join(TASKS)}"
    )


def parse_reference(text: str) -> PolicyReference:
    """Return the parts of a reference.

    Raises:
        ValueError: The text has an unknown form; the message suggests the likely one.
    """
    scheme, _, rest = text.partition(":")
    if text in ("zero", "random"):
        return PolicyReference(text, "zero" if text == "zero" else "random")
    if scheme == "python":
        return _python(text, rest)
    if scheme in ("zoo", "onnx"):
        return PolicyReference(text, "zoo" if scheme == "zoo" else "onnx", rest)
    if text.endswith(".py"):
        return PolicyReference(text, "python", text, DEFAULT_FACTORY)
    if text.endswith((".safetensors", ".onnx")):
        return PolicyReference(text, "file" if text.endswith(".safetensors") else "onnx", text)
    if _ID.fullmatch(text):
        return PolicyReference(text, "zoo", text)
    hint = ""
    if ".py:" in text:
        hint = f"; did you mean python:{text}?"
    elif text.endswith((".pt", ".pth", ".zip", ".msgpack", ".pkl", ".npz")):
        hint = f"; write a function that loads it: python:FILE.py:FACTORY?weights={text}"
    elif Path(text).is_dir():
        hint = "; it is a folder: name a file in it"
    raise ValueError(f"policy {text!r} has an unknown form; allowed are {FORMS}{hint}")


def _python(text: str, rest: str) -> PolicyReference:
    body, _, query = rest.partition("?")
    source, _, factory = body.rpartition(":")
    if not source or not factory.isidentifier():
        raise ValueError(
            f"policy {text!r} lacks a part; expected python:package.module:factory or "
            "python:FILE.py:factory, arguments behind it as ?name=value&other=value"
        )
    try:
        pairs = urllib.parse.parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
    except ValueError:
        raise ValueError(
            f"policy {text!r} has unreadable arguments; write them ?name=value&other=value"
        ) from None
    return PolicyReference(text, "python", source, factory, dict(pairs))
