"""Constants of the constraint rows, as tables of the program (rows.h says what they mean)."""

import mujoco
import numpy as np

from assistax_envs.physics.fused.collision import CAPSULE, Candidate, Geom
from assistax_envs.physics.fused.expressions import literal
from assistax_envs.physics.fused.tree import Tree

MIN_IMPEDANCE, MAX_IMPEDANCE = mujoco.mjMINIMP, mujoco.mjMAXIMP


def softness(solref: np.ndarray, solimp: np.ndarray, timestep: float) -> str:
    """Return the table entry of MuJoCo's `solref` and `solimp`.

    The impedance rises from `start` by `rise` over `width`, along two parabolas that meet at
    `midpoint`; stiffness K and damping B are those of MuJoCo's reference acceleration.
    """
    start, end, midpoint = np.clip(solimp[[0, 1, 3]], MIN_IMPEDANCE, MAX_IMPEDANCE)
    if solref[0] > 0.0:
        time = max(solref[0], 2.0 * timestep)  # MuJoCo's `refsafe`
        stiffness, damping = 1.0 / (end * time * solref[1]) ** 2, 2.0 / (end * time)
    else:
        stiffness, damping = -solref[0] / end**2, -solref[1] / end
    per_width, below, above = 1.0 / solimp[2], 1.0 / midpoint, 1.0 / (1.0 - midpoint)
    return _entry(stiffness, damping, start, end - start, per_width, midpoint, below, above)


def limit_table(model: mujoco.MjModel) -> list[str]:
    """Return the entries of the limited joints."""
    return [
        f"{{{joint}, {literal(model.dof_invweight0[joint])}, {soft}}}"
        for joint in np.flatnonzero(model.jnt_limited)
        for soft in [softness(model.jnt_solref[joint], model.jnt_solimp[joint], model.opt.timestep)]
    ]


def geom_table(geoms: dict[int, Geom]) -> list[str]:
    """Return the entries of the geoms of contact pairs."""
    return [
        f"{{{literal(geom.radius)}, {literal(geom.half_length)}, {_signed(geom.carriers)}}}"
        for geom in geoms.values()
    ]


def candidate_table(
    model: mujoco.MjModel, geoms: dict[int, Geom], places: list[Candidate]
) -> list[str]:
    """Return the entries of the places where geoms may touch."""
    number = {geom: index for index, geom in enumerate(geoms)}
    sensors = force_sensors(model)
    entries = []
    for place in places:
        first, second, pair = place.first.id, place.second.id, place.pair
        weights = model.body_invweight0[model.geom_bodyid[[first, second]], 0]
        capsules = place.first.kind == place.second.kind == CAPSULE
        ids = [{int(model.sensor_objid[s]), int(model.sensor_refid[s])} for s in sensors]
        sensor = ids.index({first, second}) if {first, second} in ids else -1
        same = sensor < 0 or int(model.sensor_objid[sensors[sensor]]) == first
        soft = softness(model.pair_solref[pair], model.pair_solimp[pair], model.opt.timestep)
        numbers = place.end, 1.0 if same else -1.0, model.pair_friction[pair, 0], weights.sum()
        head = f"{number[first]}, {number[second]}, {sensor}, {str(capsules).lower()}"
        entries.append(f"{{{head}, {', '.join(map(literal, numbers))}, {soft}}}")
    return entries


def force_sensors(model: mujoco.MjModel) -> np.ndarray:
    """Return the ids of the sensors of contact forces."""
    return np.flatnonzero(model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT)


def tree_shifts(tree: Tree) -> list[str]:
    """Return the centre of contacts from each tree's origin."""
    return [_entry(*(tree.centre - origin)) for origin in tree.origins]


def _entry(*numbers: float) -> str:
    return f"{{{', '.join(map(literal, numbers))}}}"


def _signed(bits: int) -> int:
    """Return 32 bits as C++'s `int`."""
    return bits - (1 << 32) if bits >> 31 else bits
