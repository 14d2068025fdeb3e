"""How far a load moves a reflector on the arm, and how that depends on the compliances: the loaded model (6), (7).

With C = diag(c) of the joint compliances, the springs bend by theta = C tau(q + theta), tau the torque of wrench, link
weights and compensator. Derivation by one compliance gives (1 - C H) dtheta/dc_j = tau_j e_j, H = dtau/dtheta. The
displacement by the load is that of the loaded posture less that of the posture under the weights alone.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import MillingError
from kr270_milling.base.frames import Pose
from kr270_milling.identification.measurements import Measurements
from kr270_milling.robot.arm import Arm, Mount
from kr270_milling.robot.kinematics import LinkFrames, forward, jacobian_at
from kr270_milling.robot.loads import GRAVITY, link_loads, load_hessian, load_torque

__all__ = ["LoadModel", "SoftArmError", "displacements"]

ITERATIONS = 20
PRECISION = 1e-8  #: [rad] of the last Newton step, which leaves its square
MOST_BEND = 0.1  #: [rad] of a joint spring; beyond it no drive is linear


class SoftArmError(MillingError):
    """Compliances with which the arm does not hold its load."""

    def __init__(self, row: int, compliance: np.ndarray):
        self.row, self.compliance = row, compliance
        shown = ", ".join(f"{1e6 * c:.3g}" for c in compliance)
        super().__init__(f"with the compliances {shown} urad/(N m) the arm does not hold the load of row {row + 1}")


@dataclass(frozen=True, eq=False)
class LoadModel:
    """What stays the same while compliances are tried: where the links stand, what is on them, where one looks."""

    arm: Arm
    mount: Mount
    measured: Measurements
    gravity: bool = True

    def predict(self, compliance, derivatives: bool = False):
        """Displacements [m, rad], (n, 6), for joint compliances (6,) [rad/(N m)]; and their derivatives (n, 6, 6)."""
        frames, by_joint = self._bent(np.asarray(compliance, float))
        place = frames.flange.apply(np.tile(self.measured.reflector, (2, 1)))
        full, rest = slice(0, len(self.measured)), slice(len(self.measured), None)
        turn = frames.flange.rotation
        tilt = Rotation.from_matrix(turn[full] @ np.swapaxes(turn[rest], -1, -2)).as_rotvec()
        moved = np.hstack([place[full] - place[rest], tilt])
        if not derivatives:
            return moved
        slopes = jacobian_at(frames, place) @ by_joint
        return moved, slopes[full] - slopes[rest]

    def _bent(self, c: np.ndarray) -> tuple[LinkFrames, np.ndarray]:
        """Newton's method on theta = C tau(q + theta), for the loaded postures and then those without test load.

        Returns the frames of (2 n,) postures and dtheta/dc, (2 n, 6, 6).
        """
        loads = link_loads(self.arm, self.mount, GRAVITY if self.gravity else 0.0)
        q = np.tile(self.measured.q, (2, 1))
        wrench = np.concatenate([self.measured.wrench, np.zeros_like(self.measured.wrench)])
        theta = np.zeros_like(q)
        for _ in range(ITERATIONS):
            frames = self._frames(q + theta)
            torque = load_torque(frames, wrench, loads)
            left = np.eye(6) - c[:, None] * load_hessian(frames, wrench, loads)
            step = np.linalg.solve(left, (c * torque - theta)[..., None])[..., 0]
            theta = theta + step
            far = ~(np.abs(theta).max(1) < MOST_BEND)
            if far.any():
                raise SoftArmError(int(far.argmax()) % len(self.measured), c)
            if np.abs(step).max() < PRECISION:
                by_joint = np.linalg.solve(left, torque[:, :, None] * np.eye(6))
                return self._frames(q + theta), by_joint
        raise SoftArmError(int(np.abs(step).max(1).argmax()) % len(self.measured), c)

    def _frames(self, q: np.ndarray) -> LinkFrames:
        """All frames of (n,) or twice (n,) postures, with the tool point where each row's load acts."""
        frames = forward(self.arm, self.mount, q)
        at = np.tile(self.measured.application, (len(q) // len(self.measured), 1))
        point = Pose(frames.flange.apply(at), frames.tool.rotation)
        return dataclasses.replace(frames, tool=point)

    def torques(self) -> np.ndarray:
        """What the test loads add to the torque of each joint [N m], (n, 6), in the unbent posture."""
        frames = self._frames(self.measured.q)
        return load_torque(frames, self.measured.wrench, link_loads(self.arm, self.mount, 0.0))


def displacements(arm: Arm, mount: Mount, measured: Measurements, gravity: bool = True) -> np.ndarray:
    """What an arm would show in these load tests [m, rad], (n, 6)."""
    return LoadModel(arm, mount, measured, gravity).predict(arm.joint_compliance)
