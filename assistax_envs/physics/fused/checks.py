"""Refuses, by name, every feature of a model that the engine would not compute as MuJoCo does."""

from collections.abc import Iterator

import mujoco
import numpy as np

from assistax_envs.physics.fused.collision import CAPSULE, PLANE, SPHERE
from assistax_envs.physics.fused.sensors import (
    CONTACT,
    FORCE,
    FORCE_AND_FRAME,
    SENSORS,
    SITE_SENSORS,
)

MAX_JOINTS = 32  # sets of joints are kept in the bits of a word
DISABLE, ENABLE = mujoco.mjtDisableBit, mujoco.mjtEnableBit
# What these switch is not in our models, or changes how MuJoCo works but not what it computes.
HARMLESS_DISABLE = (
    DISABLE.mjDSBL_EQUALITY,
    DISABLE.mjDSBL_FRICTIONLOSS,
    DISABLE.mjDSBL_WARMSTART,
    DISABLE.mjDSBL_FILTERPARENT,
    DISABLE.mjDSBL_MIDPHASE,
    DISABLE.mjDSBL_EULERDAMP,  # of the Euler integrator alone
    DISABLE.mjDSBL_AUTORESET,
    DISABLE.mjDSBL_NATIVECCD,
    DISABLE.mjDSBL_MULTICCD,
    DISABLE.mjDSBL_ISLAND,
)
HARMLESS_ENABLE = (ENABLE.mjENBL_ENERGY, ENABLE.mjENBL_FWDINV)
# Parts of a model that the engine knows nothing of: they must be absent or zero.
ABSENT_COUNTS = {
    "neq": "equality constraints",
    "ntendon": "tendons",
    "nflex": "flexes",
    "nmocap": "mocap bodies",
    "nplugin": "plugins",
    "na": "actuators with a state",
    "nhistory": "delays",
}
ABSENT_NUMBERS = {
    "jnt_margin": "a limit's margin",
    "jnt_stiffnesspoly": "a spring that is not linear",
    "jnt_actfrclimited": "a limit on a joint's actuator forces",
    "jnt_actgravcomp": "gravity compensation by actuators",
    "dof_frictionloss": "dry friction of joints",
    "dof_dampingpoly": "damping that is not linear",
    "actuator_forcelimited": "a limit on an actuator's force",
    "actuator_damping": "damping of an actuator",
    "actuator_dampingpoly": "damping of an actuator",
    "actuator_armature": "armature of an actuator",
    "pair_margin": "a contact pair's margin",
    "pair_gap": "a contact pair's gap",
    "pair_solreffriction": "solreffriction of a contact pair",
    "pair_adhesion": "adhesion of a contact pair",
    "sensor_cutoff": "a sensor's cutoff",
}


class UnsupportedModelError(ValueError):
    """The model has features that the fused engine does not compute."""


def check_supported(model: mujoco.MjModel) -> None:
    """Raise `UnsupportedModelError` with all that the engine cannot do, if there is anything."""
    parts = _options, _absent, _joints, _actuators, _geoms, _pairs, _sensors
    problems = [problem for part in parts for problem in part(model)]
    if problems:
        raise UnsupportedModelError(
            "backend 'fused' does not support: "
            + "; ".join(dict.fromkeys(problems))
            + ". Use backend='native', or change the model"
        )


def _options(model: mujoco.MjModel) -> Iterator[str]:
    option = model.opt
    if option.integrator != mujoco.mjtIntegrator.mjINT_IMPLICITFAST:
        name = mujoco.mjtIntegrator(int(option.integrator)).name
        yield f"integrator {name} (only implicitfast)"
    if option.cone != mujoco.mjtCone.mjCONE_PYRAMIDAL:
        yield "elliptic friction cones (only pyramidal)"
    if option.noslip_iterations:
        yield "noslip iterations"
    if option.density or option.viscosity or np.any(option.wind):
        yield "a fluid's density, viscosity or wind"
    for name, flags, enum, harmless in (
        ("disabled", option.disableflags, DISABLE, HARMLESS_DISABLE),
        ("enabled", option.enableflags, ENABLE, HARMLESS_ENABLE),
    ):
        flags &= ~sum(int(flag) for flag in harmless)
        for flag in enum.__members__.values():
            if not flag.name.startswith("mjN") and flags & int(flag):
                yield f"flag {flag.name} {name}"
    if option.disableactuator:
        yield "disabled groups of actuators"


def _absent(model: mujoco.MjModel) -> Iterator[str]:
    for name, meaning in ABSENT_COUNTS.items():
        if getattr(model, name, 0):
            yield f"{meaning} ({name})"
    for name, meaning in ABSENT_NUMBERS.items():
        if np.any(getattr(model, name, 0)):
            yield f"{meaning} ({name})"


def _joints(model: mujoco.MjModel) -> Iterator[str]:
    if not model.njnt:
        yield "a model without joints"
    for joint in range(model.njnt):
        kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
        if kind != mujoco.mjtJoint.mjJNT_HINGE:
            yield f"joint {model.joint(joint).name!r} of type {kind.name} (only hinges)"
        elif model.jnt_limited[joint]:
            name = f"joint {model.joint(joint).name!r}"
            yield from _softness(name, model.jnt_solref[joint], model.jnt_solimp[joint])
    if model.njnt > MAX_JOINTS:
        yield f"{model.njnt} joints (at most {MAX_JOINTS})"


def _softness(name: str, solref: np.ndarray, solimp: np.ndarray) -> Iterator[str]:
    if (solref[0] > 0) != (solref[1] > 0):
        yield f"solref {solref} of {name} (both numbers above 0, or both at most 0)"
    if solimp[4] != 2.0:
        yield f"solimp power {solimp[4]} of {name} (only 2)"
    if solimp[2] < 1e-6:
        yield f"solimp width {solimp[2]} of {name} (at least 1e-6)"


def _actuators(model: mujoco.MjModel) -> Iterator[str]:
    for actuator in range(model.nu):
        name = f"actuator {model.actuator(actuator).name!r}"
        if model.actuator_trntype[actuator] != mujoco.mjtTrn.mjTRN_JOINT:
            yield f"transmission of {name} (only joints)"
        plain = (
            model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_NONE
            and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
        )
        if not plain:
            yield f"{name}, which is no motor"


def _geoms(model: mujoco.MjModel) -> Iterator[str]:
    types = np.stack([model.geom_contype, model.geom_conaffinity])
    meets = (types[0][:, None] & types[1][None]) != 0
    np.fill_diagonal(meets, False)
    if meets.any():
        first, second = (model.geom(int(i)).name for i in np.argwhere(meets)[0])
        yield (
            f"contacts by contype and conaffinity, as of geoms {first!r} and {second!r} "
            "(only explicit contact pairs)"
        )


def _pairs(model: mujoco.MjModel) -> Iterator[str]:
    for pair in range(model.npair):
        ids = [int(model.pair_geom1[pair]), int(model.pair_geom2[pair])]
        names = " and ".join(repr(model.geom(i).name) for i in ids)
        kinds = [int(model.geom_type[i]) for i in ids]
        for i, kind in zip(ids, kinds, strict=True):
            if kind not in (PLANE, SPHERE, CAPSULE):
                shape = mujoco.mjtGeom(kind).name
                yield f"contacts of geom {model.geom(i).name!r} of type {shape}"
        static = [model.body_weldid[model.geom_bodyid[i]] == 0 for i in ids]
        if kinds.count(PLANE) == 2 or all(static):
            yield f"the pair {names}, of which neither moves"
        if model.pair_dim[pair] != 3:
            yield f"condim {model.pair_dim[pair]} of the pair {names} (only 3)"
        friction = model.pair_friction[pair]
        if friction[0] != friction[1]:
            yield f"friction {friction[:2]} of the pair {names} (both directions alike)"
        yield from _softness(f"the pair {names}", model.pair_solref[pair], model.pair_solimp[pair])


def _sensors(model: mujoco.MjModel) -> Iterator[str]:
    strongest = 2  # reduce="maxforce"
    pairs = [{int(a), int(b)} for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)]
    seen = []
    for sensor in range(model.nsensor):
        name = f"sensor {model.sensor(sensor).name!r}"
        kind = mujoco.mjtSensor(int(model.sensor_type[sensor]))
        if int(kind) not in SENSORS:
            yield f"{name} of type {kind.name}"
        elif int(kind) in SITE_SENSORS:
            if model.sensor_objtype[sensor] != mujoco.mjtObj.mjOBJ_SITE:
                yield f"{name} of an object that is no site"
            if model.sensor_refid[sensor] >= 0:
                yield f"{name} in a frame of reference"
        elif int(kind) == CONTACT:
            geoms = {int(model.sensor_objid[sensor]), int(model.sensor_refid[sensor])}
            types = {int(model.sensor_objtype[sensor]), int(model.sensor_reftype[sensor])}
            what, *reduced = model.sensor_intprm[sensor][:3].tolist()
            if what not in (FORCE, FORCE_AND_FRAME) or reduced != [strongest, 1]:
                yield f"{name} of other data than the strongest contact's force, or force and frame"
            if types != {int(mujoco.mjtObj.mjOBJ_GEOM)}:
                yield f"{name} of others than two geoms"
            elif geoms in seen:
                yield f"{name} of the geoms of another sensor"
            elif pairs.count(geoms) > 1:
                yield f"{name} of geoms that are in several pairs"
            seen.append(geoms)
