"""The page on which a visitor is the person of a task."""

import base64
import dataclasses
import hashlib
import json
import re
import zlib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from markupsafe import Markup

from assistax_base.digest import sha256
from assistax_base.files import atomic_write
from assistax_envs.drawing.overlay import MEANINGS
from assistax_envs.persons.rows import PARAMETERS
from assistax_envs.physics.base import SUBSTEPS
from assistax_envs.preferences import ASKS, PREFERENCES, PREFERRED, VALUES, WORDS, Preference
from assistax_envs.registered import REGISTERED, TASK_CLASSES
from evaluation.player.episode import PREFERENCE_WORDS
from evaluation.player.scene import scene_content
from evaluation.record.columns import VIOLATIONS
from evaluation.report.page import templates
from evaluation.seat.modules import read_module

if TYPE_CHECKING:
    from zoo.registry import Registry

FORMAT = "assistax-seat 1"
SCRIPTS = ("script", "told-script")  # robots without a network, in every module
PERSON = "you"  # whose clothes the human wears
SHARED = ("player_scene.js",)  # of the player of episodes
OWN = ("engine.js", "pointer.js", "record.js", "study.js", "panel.js", "play.js")
LIBRARY = "three.min.js"


@dataclasses.dataclass(frozen=True)
class Robot:
    """A robot that a page can play.

    Attributes:
        name: Id of a published robot, "script", or "told-script", which is told the wish.
        sha256: Hash of a published robot, as the registry has it.
        params: Its parameters as the module's words; None without a network.
    """

    name: str
    sha256: str | None = None
    params: bytes | None = None


def published(registry: "Registry", robots: Sequence[str], network: str) -> list[Robot]:
    """Return robots by their names: "script", "told-script", or ids of the registry.

    Args:
        registry: Registry that has them.
        robots: Their names.
        network: Digest of the network's shape that the module computes.

    Raises:
        ValueError: A robot has a network of another shape.
    """
    found = []
    for name in robots:
        if name in SCRIPTS:
            found.append(Robot(name))
            continue
        entry = registry.policy(name)
        if entry.spec.digest != network:
            raise ValueError(
                f"{name} has a network of shape {entry.spec.digest}, and pages play {network}; "
                "choose a robot with that shape, as those of the zoo"
            )
        (stack,) = registry.stacks([entry])
        found.append(Robot(entry.id, entry.sha256, _words(stack.row(0))))
    return found


def default_robots(registry: "Registry", task: str, network: str) -> list[str]:
    """Return the two scripts and the first robot of the registry that a page can play."""
    of_task = (one for one in registry.policies if one.task == task and one.role == "robot")
    fitting = [one.id for one in of_task if one.spec.digest == network]
    return [*SCRIPTS, *fitting[:1]]


def network_of(task: str) -> str:
    """Return the digest of the network's shape that a task's module computes."""
    return json.loads(read_module(task)["layout"])["network"]


def page_content(task: str, robots: Sequence[Robot], *, study: bool = False) -> bytes:
    """Return the data of a page: a length, a JSON header and parts, compressed.

    Args:
        task: A task that has a module.
        robots: Robots to choose from, in their order.
        study: Whether robots are played blind, in blocks.
    """
    module, kind = read_module(task), REGISTERED[task]
    layout = json.loads(module["layout"])
    parts = {"wasm": module["wasm"], "starts": module["starts"], "library": _asset(LIBRARY)}
    scene, meshes = _scene(task)
    parts |= meshes
    parts |= {f"robot{k}": one.params for k, one in enumerate(robots) if one.params is not None}
    header: dict[str, Any] = {
        "format": FORMAT,
        "task": task,
        "environment": layout["version"],
        "engine": sha256(module["wasm"]),
        "goal": kind.goal,
        "seat": kind.seat,
        "seconds": 0.005 * SUBSTEPS,
        "memory": layout["memory"],
        "pointer": layout["pointer"],
        "scene": scene,
        "targets": _targets(task),
        "wishes": _wishes(task),
        "cards": [_card(task, one) for one in PREFERENCES.values()],
        "usual": _usual(),
        "words": list(WORDS),
        "asked": _asked(task),
        "violations": list(VIOLATIONS),
        "robots": [{"name": one.name, "sha256": one.sha256} for one in robots],
        "study": study,
    }
    return _packed(header, parts)


def write_page(task: str, robots: Sequence[Robot], path: Path, *, study: bool = False) -> None:
    """Write the page of a task, atomically; it loads nothing from elsewhere.

    Args:
        task: A task that has a module.
        robots: Robots to choose from, in their order.
        path: The page.
        study: Whether robots are played blind, in blocks.
    """
    scripts = [_text("evaluation.report", name) for name in SHARED]
    scripts += [_text("evaluation.seat", name) for name in OWN]
    style, program = _text("evaluation.seat", "seat.css"), "\n".join(scripts)
    data = base64.b64encode(page_content(task, robots, study=study)).decode()
    text = (
        templates()
        .get_template("seat.html")
        .render(
            title="Be the person",
            task=task.removeprefix("gentle_"),
            style=Markup(style),
            program=Markup(program),
            data=data,
            policy=_policy(style, program),
        )
    )
    atomic_write(path, text.encode())


def _policy(style: str, program: str) -> str:
    """Return the page's content security policy: its own style and program, and nothing else."""
    parts = {
        "default-src": "'none'",
        "style-src": f"'sha256-{_base64_sha256(style)}'",
        "script-src": f"'sha256-{_base64_sha256(program)}' blob: 'wasm-unsafe-eval'",
        "img-src": "data:",
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return "; ".join(f"{name} {value}" for name, value in parts.items())


def _base64_sha256(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _packed(header: dict[str, Any], parts: dict[str, bytes]) -> bytes:
    """Return a header with the places of parts, and the parts, compressed."""
    places, offset = {}, 0
    for name, content in parts.items():
        places[name] = [offset, len(content)]
        offset += len(content) + -len(content) % 4
    text = json.dumps(header | {"parts": places}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    padded = (content + bytes(-len(content) % 4) for content in parts.values())
    return zlib.compress(b"".join([len(text).to_bytes(4, "little"), text, *padded]), 9)


def _scene(task: str) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Return a scene for the header, with the sizes of its meshes, and the meshes as parts.

    Points are differences along each coordinate, faces differences between indices.
    """
    scene = scene_content(TASK_CLASSES[task].scene, PERSON)
    points = [np.reshape(mesh["points"], (-1, 3)).T for mesh in scene["meshes"]]
    faces = [np.array(mesh["faces"]) for mesh in scene["meshes"]]
    sizes = [[one.shape[1], len(two)] for one, two in zip(points, faces, strict=True)]
    parts = {"points": _differences(points), "faces": _differences(faces)}
    return scene | {"meshes": sizes}, parts


def _differences(rows: Sequence[np.ndarray]) -> bytes:
    """Return differences along rows of whole numbers: all low bytes, then all high bytes."""
    steps = np.concatenate([np.diff(row, axis=-1, prepend=0).ravel() for row in rows])
    return steps.astype("<i2").view(np.uint8).reshape(-1, 2).T.tobytes()


def _targets(task: str) -> list[dict[str, str]]:
    """Return the targets of a task: names, words, and colours as CSS has them."""
    colours = TASK_CLASSES[task].target_colours
    return [
        {
            "name": name,
            "label": MEANINGS.get(name, name),
            "colour": "#" + "".join(f"{round(255 * x):02x}" for x in colour[:3]),
        }
        for name, colour in colours.items()
    ]


def _wishes(task: str) -> list[dict[str, Any]]:
    """Return each wish: its name, range, unit, and words for its card."""
    ranges = {number.name: (number.low, number.high) for number in PARAMETERS[task]}
    wishes = []
    for name in PREFERRED[task]:
        factor, unit, words = PREFERENCE_WORDS[name]
        low, high = ranges[f"liked_{name}"]
        asks = list(ASKS.get(name, ()))
        wishes.append(
            {
                **{"name": name, "low": low, "high": high, "factor": factor},
                **{"unit": unit, "words": words, "asks": asks},
            }
        )
    return wishes


def _card(task: str, one: Preference) -> dict[str, float]:
    return {name: getattr(one, name) for name in PREFERRED[task]}


def _usual() -> dict[str, float]:
    """Return the values of quantities that a task has no wish about, and the tolerance."""
    usual = {name: values[1] for name, values in VALUES.items()}
    return usual | {"tolerance": next(iter(PREFERENCES.values())).tolerance}


def _asked(task: str) -> list[str]:
    """Return the words that persons of a task say."""
    own = {word for name in PREFERRED[task] for word in ASKS.get(name, ())}
    return [word for word in WORDS if word in own or word in ("stop", "good")]


def _words(params: Any) -> bytes:
    """Return parameters as a module's words, in the order of their tree."""
    leaves = [np.asarray(leaf, "<f4").ravel() for leaf in jax.tree.leaves(params)]
    return np.concatenate(leaves).tobytes()


def _asset(name: str) -> bytes:
    return (resources.files("evaluation.report") / "assets" / name).read_bytes()


def _text(package: str, name: str) -> str:
    text = (resources.files(package) / "assets" / name).read_text("utf-8")
    if found := re.search(r"</script|<!--", text, re.IGNORECASE):
        raise ValueError(f"{name} has {found[0]!r}, which would end the page's program")
    return text
