"""The arm: geometry, kinematics, elastostatics (virtual joint springs), mass, limits."""

from kr270_milling.physics.robot.arm import BARE, Arm, Mount
from kr270_milling.physics.robot.elastostatics import compliance, equilibrium, stiffness, wrench_for_pose
from kr270_milling.physics.robot.inverse import inverse_along, inverse_near
from kr270_milling.physics.robot.kinematics import (
    forward,
    jacobian,
    pose,
    rotate_matrix,
    singularity_measures,
    status_turn,
)
from kr270_milling.physics.robot.loads import link_loads
from kr270_milling.physics.robot.mass import beam_mass, cartesian_mass, joint_mass, mode_frequencies, rigid_joint_mass

__all__ = [
    "BARE",
    "Arm",
    "Mount",
    "beam_mass",
    "cartesian_mass",
    "compliance",
    "equilibrium",
    "forward",
    "inverse_along",
    "inverse_near",
    "jacobian",
    "joint_mass",
    "link_loads",
    "mode_frequencies",
    "pose",
    "rigid_joint_mass",
    "rotate_matrix",
    "singularity_measures",
    "status_turn",
    "stiffness",
    "wrench_for_pose",
]
