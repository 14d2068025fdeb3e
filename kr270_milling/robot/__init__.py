"""The arm: geometry, kinematics, elastostatics (virtual joint springs), mass, limits."""

from kr270_milling.robot.arm import BARE, Arm, Mount
from kr270_milling.robot.elastostatics import compliance, loaded_stiffness, rotate_matrix, stiffness
from kr270_milling.robot.equilibrium import Equilibrium, equilibrium, wrench_for_pose
from kr270_milling.robot.inverse import inverse, inverse_near
from kr270_milling.robot.kinematics import LinkFrames, forward, jacobian, pose, singularity_measures, status_turn
from kr270_milling.robot.loads import LinkLoads, link_loads
from kr270_milling.robot.mass import beam_mass, cartesian_mass, joint_mass, mode_frequencies
from kr270_milling.robot.rigid_mass import rigid_joint_mass

__all__ = [
    "BARE", "Arm", "Equilibrium", "LinkFrames", "LinkLoads", "Mount", "beam_mass", "cartesian_mass", "compliance",
    "equilibrium", "forward", "inverse", "inverse_near", "jacobian", "joint_mass", "link_loads",
    "loaded_stiffness", "mode_frequencies", "pose", "rigid_joint_mass", "rotate_matrix", "singularity_measures",
    "status_turn", "stiffness", "wrench_for_pose",
]  # fmt: skip
