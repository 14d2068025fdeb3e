"""The arm and the postures that many tests share, and the arm in pinocchio, an oracle of its kinematics and mass."""

import functools

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from kr270_milling.base.parameter_file import find_file
from kr270_milling.physics.robot import Mount
from kr270_milling.physics.robot.analysis import read_arm

__all__ = ["ARM", "ARMS", "ON_BASE", "PAPER", "POSTURES", "SPINDLE", "TURNED", "UNEVEN", "arm_of", "pinocchio_arm"]

ARMS = ("kr270_2", "kr270_r2700_ultra")
PAPER = np.radians([90.0, -50.0, 120.0, 180.0, 25.0, 180.0])  # [Klimchik2014], Table 1
SPINDLE = Mount(xyz=np.array([0.3, 0.0, 0.1]), mass=60.0, mass_centre=np.array([0.1, 0.03, 0.02]))
#: turned about all three axes, with rotary inertia
TURNED = SPINDLE.replace(abc=np.radians([20.0, 70.0, -35.0]), inertia=np.array([0.6, 0.5, 0.3]))


@functools.cache
def arm_of(name: str = ARMS[0]):
    return read_arm(find_file(f"{name}.yaml"))[0]


ARM = arm_of()
#: weights that are not in the middle of the links
UNEVEN = ARM.replace(link_mass_centre=np.array([0.4, 0.3, 0.6, 0.45, 0.5, 0.7]))
#: a base that tilts
ON_BASE = ARM.replace(base_compliance=np.array([0.08e-6, 0.12e-6, 0.03e-6]))
POSTURES = np.random.default_rng(5).uniform(ARM.joint_lower, ARM.joint_upper, (100, 6))  #: [rad], within the limits


def tube(mass: float, vector: np.ndarray, radius: float) -> np.ndarray:
    """Inertia of a thin tube about its middle, by scipy's rotation and the textbook's principal moments."""
    length = np.linalg.norm(vector)
    across = mass * (radius**2 / 2 + length**2 / 12)
    turn = Rotation.align_vectors([vector / length], [[1.0, 0, 0]])[0].as_matrix()
    return turn @ np.diag([mass * radius**2, across, across]) @ turn.T


def pinocchio_arm(arm, mount: Mount, tubes: bool = False):
    """The chain of the data sheet with its weights on the links' lines; tubes: with rotary inertia. Frame: tcp.

    The axes of a base that tilts precede the six joints.
    """
    model, parent, at = pin.Model(), 0, np.zeros(3)
    for k in arm.base_axes.tolist():
        hinge = pin.JointModelRevoluteUnaligned(np.eye(3)[k])
        parent = model.addJoint(parent, hinge, pin.SE3.Identity(), f"base_{k}")
    axes = [(0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0)]
    ends = [(arm.a1, 0, arm.d1), (arm.a2, 0, 0), (0, 0, arm.a3), (arm.d4, 0, 0), (0, 0, 0), (arm.d6, 0, 0)]
    for j, (axis, end) in enumerate(zip(axes, ends, strict=True)):
        joint = pin.JointModelRevoluteUnaligned(np.array(axis, float))
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), at), f"j{j}")
        at = np.array(end, float)
        own = tube(arm.link_mass[j], at, arm.link_section_radius[j]) if tubes and at.any() else np.zeros((3, 3))
        inertia = pin.Inertia(arm.link_mass[j], arm.link_mass_centre[j] * at, own)
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    rider = pin.Inertia(mount.mass, at + mount.mass_centre, np.diag(mount.inertia) if tubes else np.zeros((3, 3)))
    model.appendBodyToJoint(parent, rider, pin.SE3.Identity())
    model.gravity.linear = np.array([0, 0, -9.80665])
    place = pin.SE3(pin.rpy.rpyToMatrix(*mount.abc[::-1]), at + mount.xyz)
    frame = model.addFrame(pin.Frame("tcp", parent, 0, place, pin.FrameType.OP_FRAME))
    return model, model.createData(), frame
