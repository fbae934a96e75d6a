"""The collision picture shows exactly what can touch, in its owner's colour."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

from assistax_envs.models import build_model
from assistax_envs.versions import PAPER_TASKS as TASKS
from tools.collisions import COLOURS, collision_model, main, pair_geoms, picture, touches


def shown(model: mujoco.MjModel) -> set[str]:
    """Return the geoms that a renderer is given to draw, by name."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    scene = mujoco.MjvScene(model, maxgeom=1000)
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene
    )
    drawn = [
        geom for geom in scene.geoms[: scene.ngeom] if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM
    ]
    return {model.geom(geom.objid).name for geom in drawn if geom.rgba[3] > 0}


def paired(model: mujoco.MjModel) -> set[frozenset[str]]:
    ends = zip(model.pair_geom1, model.pair_geom2, strict=True)
    return {frozenset(model.geom(int(geom)).name for geom in pair) for pair in ends}


@pytest.mark.parametrize("task", TASKS)
def test_it_shows_exactly_the_geoms_of_the_contact_pairs(task: str) -> None:
    model = build_model(task)
    expected = set().union(*paired(model))
    assert shown(collision_model(model)) == expected == set(pair_geoms(model))
    assert len(shown(model) - expected) > 5  # the scene itself has more to look at


@pytest.mark.parametrize("task", TASKS)
def test_the_caption_has_every_pair_once(task: str) -> None:
    model = build_model(task)
    printed = [
        frozenset((first, other)) for first, others in touches(model).items() for other in others
    ]
    assert len(printed) == model.npair
    assert set(printed) == paired(model)


def test_a_pair_that_is_added_is_shown() -> None:
    """What is drawn follows the model: a geom outside every pair appears with its first one."""
    spec = mujoco.MjSpec.from_string(
        "<mujoco><worldbody><geom name='a' size='.1'/><geom name='b' size='.1'/><geom name='c' "
        "size='.1'/></worldbody><contact><pair geom1='a' geom2='b'/></contact></mujoco>"
    )
    assert shown(collision_model(spec.compile())) == {"a", "b"}
    spec.add_pair(geomname1="a", geomname2="c")
    assert shown(collision_model(spec.compile())) == {"a", "b", "c"}


def test_owners_have_their_colours() -> None:
    owners = pair_geoms(build_model("scratch"))
    assert {owner: sum(name == owner for name in owners.values()) for owner in COLOURS} == {
        "robot": 2, "human": 7, "furniture": 2,
    }  # fmt: skip
    assert (owners["robot_tool"], owners["right_thigh"], owners["right_rail_inner"]) == (
        "robot",
        "human",
        "furniture",
    )


def test_the_picture_puts_the_scene_beside_its_collisions() -> None:
    rows = picture(["scratch"], width=320, height=240)
    assert rows.shape[1:] == (640, 3) and rows.shape[0] > 240
    scene, collisions = rows[:240, :320].astype(int), rows[:240, 320:].astype(int)
    blue = [
        ((pane[..., 2] - pane[..., 0]) > 80).sum() for pane in (scene, collisions)
    ]  # the human's colour
    assert blue[1] > 500 > blue[0]
    assert np.unique(rows[240:].reshape(-1, 3), axis=0).shape[0] > 20  # words, in several colours


@pytest.mark.slow
def test_the_paper_s_tasks_stand_in_one_small_png(tmp_path: Path) -> None:
    out = tmp_path / "collisions.png"
    main(out=out, width=160, height=120)
    with Image.open(out) as image:
        assert image.width == 2 * 160 and image.height > len(TASKS) * 120
        assert image.convert("RGB").getcolors(256) is not None
    with pytest.raises(SystemExit, match=r"x\.gif ends in '\.gif'; collisions are a \.png"):
        main(out=tmp_path / "x.gif")
    with pytest.raises(ValueError, match="width is 3; allowed are 16 to 4096"):
        main(out=out, width=3)
    assert list(tmp_path.iterdir()) == [out]
