"""Draws docs/images/collisions.png: what can touch what.

    python -m tools.collisions --width 360 --height 250 --out docs/images/collisions.png

Each scene beside the geoms of its contact pairs, coloured by owner, with the pairs in words.
"""

import copy
import sys
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from cyclopts import App
from PIL import Image, ImageDraw, ImageFont

from assistax_base.files import atomic_path
from assistax_envs.gl import functions_from, open_context
from assistax_envs.models import build_dressed, build_model
from assistax_envs.render import check_size
from assistax_envs.tasks import TASK_CLASSES
from assistax_envs.tasks.base import TOUCHABLE
from assistax_envs.versions import PAPER_TASKS

COLOURS = {  # shares of red, green, blue
    "robot": (0.90, 0.45, 0.05),
    "human": (0.05, 0.20, 0.55),
    "furniture": (0.10, 0.55, 0.35),
}
LEGS = ("right_thigh", "left_thigh")  # of the human, though welded to what it sits or lies on
PLANE_SIZE = (1.0, 0.55, 0.1)  # m: what is drawn of an infinite plane, from its middle
PLANE_OPACITY = 0.45
INK, PAPER = (25, 30, 38), (255, 255, 255)


def main(*, out: Path, width: int = 480, height: int = 360) -> None:
    """Draw the scene of each of the paper's tasks beside the shapes that can touch.

    Args:
        out: Picture to write, .png.
        width: Pixels of a scene.
        height: Pixels of a scene.
    """
    if out.suffix.lower() != ".png":
        sys.exit(f"error: {out.name} ends in {out.suffix or 'nothing'!r}; collisions are a .png")
    pixels = picture(PAPER_TASKS, width, height)
    with atomic_path(out) as temporary:
        Image.fromarray(pixels).quantize(256, Image.Quantize.FASTOCTREE).save(
            temporary, format="png", optimize=True
        )


def pair_geoms(model: mujoco.MjModel) -> dict[str, str]:
    """Return who owns each geom of a contact pair, by its name: robot, human or furniture."""
    ids = sorted({int(geom) for geom in (*model.pair_geom1, *model.pair_geom2)})
    return {model.geom(geom).name: _owner(model.geom(geom).name) for geom in ids}


def touches(model: mujoco.MjModel) -> dict[str, list[str]]:
    """Return what each geom can touch, every contact pair once.

    The robot's geoms first, then the human's arm.
    """
    against: dict[str, list[str]] = {}
    for pair in zip(model.pair_geom1, model.pair_geom2, strict=True):
        first, second = sorted((model.geom(int(geom)).name for geom in pair), key=_rank)
        against.setdefault(first, []).append(second)
    return {name: against[name] for name in sorted(against, key=_rank)}


def collision_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy that draws the geoms of contact pairs alone, in their owner's colour."""
    shown, owners = copy.copy(model), pair_geoms(model)
    shown.geom_matid[:] = -1
    for index in range(model.ngeom):
        owner = owners.get(model.geom(index).name)
        opacity = PLANE_OPACITY if model.geom_type[index] == mujoco.mjtGeom.mjGEOM_PLANE else 1.0
        shown.geom_rgba[index] = (*COLOURS[owner], opacity) if owner else 0.0
        if owner and opacity < 1.0:
            shown.geom_size[index] = PLANE_SIZE
    return shown


def picture(tasks: Sequence[str], width: int = 480, height: int = 360) -> np.ndarray:
    """Draw a row for each task.

    Its scene, the geoms of its contact pairs alone, and the pairs in words.

    Returns:
        uint8 [rows, 2 * width, 3].

    Raises:
        ValueError: the size is not one that can be drawn, or this machine lacks EGL and OSMesa.
    """
    check_size(width, height)
    rows = []
    for task in tasks:
        model = build_model(task)
        qpos = TASK_CLASSES[task](model).pose.angle
        shown = build_dressed(task), collision_model(model)
        for field in ("cam_pos", "cam_quat", "cam_fovy"):  # both from where the picture is taken
            getattr(shown[1], field)[0] = getattr(shown[0], field)[0]
        panes = [_draw(shown_model, qpos, width, height) for shown_model in shown]
        rows += [np.concatenate(panes, axis=1), _caption(task, model, 2 * width)]
    return np.concatenate(rows)


def _rank(geom: str) -> int:
    """Order geoms for reading.

    Tool, robot's hand, human's arm, the rest of the human, furniture.
    """
    groups = (
        geom == "robot_tool",
        _owner(geom) == "robot" and geom != "robot_hand",
        geom == "robot_hand",
        geom.removeprefix("human_") in TOUCHABLE,
        _owner(geom) == "human",
    )
    return groups.index(True) if any(groups) else len(groups)


def _owner(geom: str) -> str:
    if geom.startswith("robot_"):
        return "robot"
    return "human" if geom.startswith("human_") or geom in LEGS else "furniture"


def _draw(model: mujoco.MjModel, qpos: np.ndarray, width: int, height: int) -> np.ndarray:
    """Draw one pose from the scene's first camera, in a context of its own."""
    model = copy.copy(model)
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
    scene = mujoco.MjvScene(model, maxgeom=1000)
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene
    )
    platform, context = open_context(width, height)
    context.make_current()
    with functions_from(platform):
        gl = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, gl)
    viewport = mujoco.MjrRect(0, 0, width, height)
    pixels = np.empty((height, width, 3), np.uint8)
    mujoco.mjr_render(viewport, scene, gl)
    mujoco.mjr_readPixels(pixels, None, viewport, gl)
    gl.free()
    context.free()
    return pixels[::-1]


def _caption(task: str, model: mujoco.MjModel, width: int) -> np.ndarray:
    """Write the owners' colours and every contact pair, uint8 [lines, width, 3]."""
    size = max(10, width // 64)
    font, step = ImageFont.load_default(size), round(1.45 * size)
    lines = [
        [
            (f"{task}, {model.npair} contact pairs:", INK),
            *((owner, _ink(owner)) for owner in COLOURS),
        ]
    ]
    for first, others in touches(model).items():
        words = [
            (f"{_words(other)}{',' * (other != others[-1])}", _ink(_owner(other)))
            for other in others
        ]
        lines.append([(_words(first), _ink(_owner(first))), ("-", INK), *words])
    image = Image.new("RGB", (width, len(lines) * step + size), PAPER)
    draw = ImageDraw.Draw(image)
    for i, line in enumerate(lines):
        x = size / 2
        for text, colour in line:
            draw.text((x, size // 2 + i * step), text, font=font, fill=colour)
            x += draw.textlength(f"{text} ", font=font)
    return np.array(image)


def _words(geom: str) -> str:
    return (
        "robot's hand"
        if geom == "robot_hand"
        else geom.removeprefix("human_").removeprefix("robot_").replace("_", " ")
    )


def _ink(owner: str) -> tuple[int, ...]:
    return tuple(round(255 * channel) for channel in COLOURS[owner])


if __name__ == "__main__":
    app = App(name="python -m tools.collisions")
    app.default(main)
    app()
