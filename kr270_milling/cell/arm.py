"""The arm of a cell at its workpiece: joint positions and modes for places on the part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.frames import Pose
from kr270_milling.cell.sections import Workpiece
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import Tool
from kr270_milling.physics.motion.arm_model import Dynamics, modal_models
from kr270_milling.physics.motion.dynamics import ModalModel
from kr270_milling.physics.robot import Arm, Mount, inverse_along

__all__ = ["PlacedArm"]


@dataclass(frozen=True)
class PlacedArm:
    """An arm with its tool at a workpiece."""

    arm: Arm
    mount: Mount
    workpiece: Workpiece
    dynamics: Dynamics
    tool: Tool
    near: tuple[float, ...]  #: joint positions [rad] at the start of the path or near them; they choose the branch

    @property
    def place(self) -> Pose:
        """workpiece -> base_link."""
        return self.workpiece.pose

    @property
    def posture(self) -> np.ndarray:
        """``near`` as an array, (6,)."""
        return np.array(self.near)

    def joints(self, trajectory: Trajectory) -> np.ndarray:
        """Joint positions [rad], (n, 6), that command the knots of a trajectory, on the branch of ``posture``."""
        return self.joints_at(trajectory.position, trajectory.quaternion)

    def joints_at(self, position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
        """Joint positions [rad], (n, 6), for tool positions (n, 3) [m] and orientations (n, 4), workpiece frame."""
        return inverse_along(self.arm, self.mount, self.place, position, quaternion, self.posture)

    def joints_along(self, reference: Trajectory, stamps: np.ndarray) -> np.ndarray:
        """Joint positions [rad], (n, 6), that command a trajectory at stamps (n,) [ns]."""
        return self.joints_at(reference.sample(stamps), reference.sample_orientation(stamps))

    def modes_at(self, joints: np.ndarray) -> list[ModalModel]:
        """Modes at postures (n, 6) [rad], in workpiece axes."""
        return modal_models(self.arm, self.mount, self.dynamics, self.place, joints, self.tool.lateral_compliance)
