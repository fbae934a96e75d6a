"""Every feature that the engine does not compute as MuJoCo does is refused by name."""

import mujoco
import numpy as np
import pytest

from assistax_envs.physics.fused import UnsupportedModelError, generate
from assistax_envs.physics.fused.checks import check_supported
from assistax_envs.versions import CARE_TASKS
from tests.envs.fused.scenes import TASKS, scene

# A pendulum of two links that touches a ball; each case plants one feature in it.
MODEL = """
<mujoco>
  <option integrator="implicitfast" {option}><flag {flag}/></option>
  {extension}
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="ball" pos="0 0.3 0.5" {ball}><geom name="ball" type="sphere" size="0.1"/></body>
    <body name="upper" pos="0 0 1">
      <joint name="upper" axis="0 1 0" range="-1 1" limited="true" {joint}/>
      <geom name="upper" type="capsule" fromto="0 0 0 0 0 -0.3" size="0.03" {geom}/>
      <site name="upper"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="lower" axis="1 0 0"/>
        <geom name="lower" type="{shape}" size="0.03 0.1 0.1"/>
      </body>
      {body}
    </body>
  </worldbody>
  <contact>
    <pair name="ball" geom1="ball" geom2="lower" condim="{condim}" {pair}/>
    <pair name="floor" geom1="{first}" geom2="upper"/>
    {contact}
  </contact>
  <equality>{equality}</equality>
  <tendon>{tendon}</tendon>
  <actuator>{actuator}<motor name="motor" joint="upper" {motor}/></actuator>
  <sensor>{sensor}<jointpos joint="upper"/></sensor>
</mujoco>
"""
PLAIN = dict.fromkeys(
    [
        "option",
        "flag",
        "extension",
        "ball",
        "joint",
        "geom",
        "body",
        "pair",
        "contact",
        "equality",
        "tendon",
        "actuator",
        "motor",
        "sensor",
    ],
    "",
) | {"shape": "capsule", "condim": "3", "first": "floor"}
FORCE = '<contact geom1="ball" geom2="lower" data="{}" reduce="{}" num="{}"/>'

CASES = [
    ({"option": 'cone="elliptic"'}, "elliptic"),
    ({"option": 'noslip_iterations="3"'}, "noslip"),
    ({"option": 'density="1"'}, "fluid"),
    ({"option": 'viscosity="1"'}, "fluid"),
    ({"option": 'wind="1 0 0"'}, "fluid"),
    ({"option": 'actuatorgroupdisable="1"'}, "disabled groups"),
    ({"flag": 'contact="disable"'}, "mjDSBL_CONTACT"),
    ({"flag": 'limit="disable"'}, "mjDSBL_LIMIT"),
    ({"flag": 'gravity="disable"'}, "mjDSBL_GRAVITY"),
    ({"flag": 'spring="disable"'}, "mjDSBL_SPRING"),
    ({"flag": 'damper="disable"'}, "mjDSBL_DAMPER"),
    ({"flag": 'clampctrl="disable"'}, "mjDSBL_CLAMPCTRL"),
    ({"flag": 'actuation="disable"'}, "mjDSBL_ACTUATION"),
    ({"flag": 'refsafe="disable"'}, "mjDSBL_REFSAFE"),
    ({"flag": 'constraint="disable"'}, "mjDSBL_CONSTRAINT"),
    ({"flag": 'sensor="disable"'}, "mjDSBL_SENSOR"),
    ({"flag": 'override="enable"'}, "mjENBL_OVERRIDE"),
    ({"flag": 'sleep="enable"'}, "mjENBL_SLEEP"),
    ({"ball": 'mocap="true"'}, "mocap"),
    ({"joint": 'margin="0.1"'}, "margin"),
    ({"joint": 'frictionloss="0.1"'}, "dry friction"),
    ({"joint": 'solimplimit="0.9 0.95 0.001 0.5 3"'}, "solimp power"),
    ({"joint": 'solimplimit="0.9 0.95 0 0.5 2"'}, "solimp width"),
    ({"joint": 'actuatorfrcrange="-1 1" actuatorfrclimited="true"'}, "actuator forces"),
    ({"joint": 'actuatorgravcomp="true"'}, "gravity compensation"),
    ({"joint": 'stiffness="1 2"'}, "spring that is not linear"),
    ({"joint": 'damping="1 2"'}, "damping that is not linear"),
    ({"body": '<body><joint name="s" type="slide"/><geom size=".1"/></body>'}, "mjJNT_SLIDE"),
    ({"body": '<body><joint name="s" type="ball"/><geom size=".1"/></body>'}, "mjJNT_BALL"),
    ({"geom": 'contype="1" conaffinity="1"', "body": '<geom contype="1" size=".1"/>'}, "contype"),
    ({"shape": "box"}, "mjGEOM_BOX"),
    ({"shape": "cylinder"}, "mjGEOM_CYLINDER"),
    ({"condim": "1"}, "condim 1"),
    ({"condim": "4"}, "condim 4"),
    ({"pair": 'margin="0.1"'}, "margin"),
    ({"pair": 'gap="0.1"'}, "gap"),
    ({"pair": 'friction="0.5 0.6"'}, "friction"),
    ({"pair": 'solreffriction="0.5 0.6"'}, "solreffriction"),
    ({"pair": 'solimp="0.9 0.95 0.001 0.5 1"'}, "solimp power"),
    ({"contact": '<pair geom1="ball" geom2="floor"/>'}, "neither moves"),
    ({"equality": '<joint joint1="upper" joint2="lower"/>'}, "equality"),
    ({"tendon": '<fixed name="t"><joint joint="upper" coef="1"/></fixed>'}, "tendons"),
    ({"actuator": '<position joint="upper"/>'}, "no motor"),
    ({"actuator": '<velocity joint="upper"/>'}, "no motor"),
    ({"actuator": '<intvelocity joint="upper" actrange="-1 1"/>'}, "no motor"),
    ({"actuator": '<general joint="upper" dyntype="filter" dynprm="1"/>'}, "with a state"),
    ({"actuator": '<motor site="upper" refsite="upper"/>'}, "transmission"),
    ({"motor": 'forcerange="-1 1" forcelimited="true"'}, "limit on an actuator"),
    ({"motor": 'delay="0.01" nsample="2"'}, "delays"),
    ({"sensor": '<jointactuatorfrc joint="upper"/>'}, "mjSENS_JOINTACTFRC"),
    ({"sensor": '<accelerometer site="upper"/>'}, "mjSENS_ACCELEROMETER"),
    ({"sensor": '<framepos objtype="body" objname="lower"/>'}, "no site"),
    ({"sensor": '<framepos objtype="site" objname="upper" reftype="body" refname="lower"/>'},
     "frame of reference"),
    ({"sensor": '<jointvel joint="upper" cutoff="1"/>'}, "cutoff"),
    ({"sensor": FORCE.format("force", "netforce", 1)}, "other data"),
    ({"sensor": FORCE.format("found force", "maxforce", 1)}, "other data"),
    ({"sensor": FORCE.format("force", "maxforce", 2)}, "other data"),
    ({"sensor": 2 * FORCE.format("force", "maxforce", 1)}, "another sensor"),
    ({"sensor": '<contact body1="ball" body2="lower" data="force" reduce="maxforce"/>'},
     "two geoms"),
]  # fmt: skip


def plant(**parts: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(MODEL.format(**(PLAIN | parts)))


def test_plain_model_is_supported() -> None:
    check_supported(plant())
    check_supported(plant(sensor=FORCE.format("force", "maxforce", 1)))


@pytest.mark.parametrize(("parts", "name"), CASES, ids=[name for _, name in CASES])
def test_refused_by_name(parts: dict[str, str], name: str) -> None:
    with pytest.raises(UnsupportedModelError, match=name) as error:
        generate(plant(**parts))
    assert "backend='native'" in str(error.value)


@pytest.mark.parametrize("integrator", ["Euler", "RK4", "implicit"])
def test_other_integrators_are_refused(integrator: str) -> None:
    text = MODEL.replace("implicitfast", integrator).format(**PLAIN)
    with pytest.raises(UnsupportedModelError, match="integrator"):
        generate(mujoco.MjModel.from_xml_string(text))


@pytest.mark.parametrize(
    ("field", "value", "name"),
    [("jnt_solref", [0.02, -1.0], "solref"), ("pair_solref", [-0.1, 1.0], "solref"),
     ("pair_adhesion", 1.0, "adhesion"), ("actuator_damping", 1.0, "damping of an actuator"),
     ("actuator_armature", 0.1, "armature of an actuator")],
)  # fmt: skip
def test_fields_that_are_set_later(field: str, value, name: str) -> None:
    model = plant()
    getattr(model, field)[0] = value
    with pytest.raises(UnsupportedModelError, match=name):
        generate(model)


def test_all_problems_are_named_at_once() -> None:
    with pytest.raises(UnsupportedModelError, match=r"elliptic.*tendons.*condim"):
        generate(
            plant(
                option='cone="elliptic"',
                condim="4",
                tendon='<fixed name="t"><joint joint="upper" coef="1"/></fixed>',
            )
        )


@pytest.mark.parametrize("task", TASKS)
def test_our_scenes_are_supported(task: str) -> None:
    program = generate(scene(task))
    assert program.nq == program.nv == program.njnt == (14 if task in CARE_TASKS else 16)
    assert program.nsensordata == scene(task).nsensordata
    assert np.isfinite(program.max_rows)
