"""The arm of a cell at its workpiece: joint positions and modes for places on the part."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.cell.sections import Workpiece
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.revision import mirror
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.physics.cutting import Tool
from kr270_milling.physics.motion.arm_model import Dynamics, modal_models
from kr270_milling.physics.motion.dynamics import ModalModel
from kr270_milling.physics.robot import Arm, Mount, inverse_along


@dataclass(frozen=True)
class PlacedArm:
    """An arm with its tool at a workpiece."""

    arm: Arm
    mount: Mount
    workpiece: Workpiece
    dynamics: Dynamics
    tool: Tool
    near: tuple[float, ...]  #: joint positions [rad] at the start of the path or near them; they choose the branch

    @cached_property
    def place(self) -> Pose:
        """workpiece -> base_link."""
        return self.workpiece.pose

    @cached_property
    def geometry(self) -> PlacedArm:
        """The arm without compliances and masses, in which simulated robots differ: its joint positions are theirs."""
        arm = self.arm.replace(joint_compliance=np.full(6, 1e-6), link_mass=np.ones(6), base_compliance=np.zeros(3))
        still = Dynamics(mass_model="rigid", damping_ratio=0.0)
        mount, any_tool = self.mount.replace(mass=0.0), Tool(diameter=0.01, teeth=1)
        return PlacedArm(arm, mount, self.workpiece, still, any_tool, self.near)

    @property
    def posture(self) -> np.ndarray:
        """``near`` as an array, (6,)."""
        return np.array(self.near)

    def joints(self, trajectory: Trajectory) -> np.ndarray:
        """Joint positions [rad], (n, 6), that command the knots of a trajectory, on the branch of ``posture``."""
        return joints_at_knots(self.geometry, trajectory)

    def joints_at(self, position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
        """Joint positions [rad], (n, 6), for tool positions (n, 3) [m] and orientations (n, 4), workpiece frame."""
        return inverse_along(self.arm, self.mount, self.place, position, quaternion, self.posture)

    def joints_along(self, reference: Trajectory, stamps: np.ndarray) -> np.ndarray:
        """Joint positions [rad], (n, 6), that command a trajectory at stamps (n,) [ns]."""
        return _joints_along(self.geometry, reference, stamps.tobytes())

    def modes_at(self, joints: np.ndarray) -> list[ModalModel]:
        """Modes at postures (n, 6) [rad], in workpiece axes."""
        return modal_models(self.arm, self.mount, self.dynamics, self.place, joints, self.tool.lateral_compliance)


@lru_cache(maxsize=1)  # the check of the arm and the times of the joints need the same, 50 MB a million knots
def joints_at_knots(arm: PlacedArm, trajectory: Trajectory) -> np.ndarray:
    """``PlacedArm.joints``, read-only."""
    joints = arm.joints_at(trajectory.position, trajectory.quaternion)
    joints.setflags(write=False)
    return joints


@lru_cache(maxsize=6)  # simulated robots run two or three programs, with the same stamps of gaps and of postures
def _joints_along(arm: PlacedArm, reference: Trajectory, stamps: bytes) -> np.ndarray:
    time_ns = np.frombuffer(stamps, np.int64)
    joints = arm.joints_at(reference.sample(time_ns), reference.sample_orientation(time_ns))
    joints.setflags(write=False)
    return joints


def mirrored(arm: PlacedArm, relaxation: float, target: Trajectory, wrench: np.ndarray) -> Trajectory:
    """Target points modified by (30)-(32) for wrenches (k, 6) at the knots, in workpiece axes.

    Without the sag under the link weights: who commands the joints deals with that, see ``commanded_joints``.
    """
    turn = arm.place.rotation
    in_base = np.concatenate([wrench[:, :3] @ turn.T, wrench[:, 3:] @ turn.T], axis=1)
    modified = arm.place.inverse() @ _mirror(arm, relaxation, target, in_base, True)[0]
    return Trajectory(target.time_ns, modified.position, modified.quaternion, None, target.frame)


def commanded_joints(arm: PlacedArm, settings: CompensationSettings, reference: Trajectory) -> np.ndarray:
    """The inverse kinetostatic model: joint positions [rad], (k, 6), that bring the tool to the reference points.

    The joint positions include the sag under the link weights where the controller does not compensate it.
    """
    if settings.sag_compensated:
        return arm.joints(reference)
    return _mirror(arm, settings.relaxation, reference, np.zeros((len(reference), 6)), False)[1]


def _mirror(arm: PlacedArm, relaxation: float, target: Trajectory, wrench_in_base: np.ndarray, sag_compensated: bool):
    tool = arm.place @ Pose(target.position, rotation_from_quaternion(target.quaternion))
    return mirror(
        arm.arm,
        arm.mount,
        tool,
        wrench_in_base,
        arm.posture,
        tool_compliance=arm.tool.lateral_compliance,
        relaxation=relaxation,
        sag_compensated=sag_compensated,
    )
