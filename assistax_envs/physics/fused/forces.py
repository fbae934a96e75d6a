"""Forces at the joints that are known before constraints act: springs, dampers and motors."""

import mujoco

from assistax_envs.physics.fused.expressions import Block, Scalar, maximum, minimum, multiply_add


def joint_forces(block: Block, model: mujoco.MjModel, bias: list[Scalar]) -> list[Scalar]:
    """Return the torque on each joint, less what Coriolis forces and gravity take (`bias`)."""
    forces = []
    for dof in range(model.nv):
        angle, rate = block.input(f"q[{dof}]"), block.input(f"qd[{dof}]")
        stiffness = float(model.jnt_stiffness[dof])
        force = multiply_add(-float(model.dof_damping[dof]), rate, -bias[dof])
        force = multiply_add(-stiffness, angle, force + stiffness * float(model.qpos_spring[dof]))
        forces.append(force)
    for actuator in range(model.nu):
        joint = int(model.actuator_trnid[actuator, 0])
        gain = float(model.actuator_gear[actuator, 0] * model.actuator_gainprm[actuator, 0])
        forces[joint] = multiply_add(gain, _control(block, model, actuator), forces[joint])
    return forces


def _control(block: Block, model: mujoco.MjModel, actuator: int) -> Scalar:
    control = block.input(f"u[{actuator}]")
    if not model.actuator_ctrllimited[actuator]:
        return control
    low, high = (float(x) for x in model.actuator_ctrlrange[actuator])
    return minimum(maximum(control, low), high)
