"""The least squares problem of load tests: which numbers are sought, weighted residuals and their derivatives.

How far a load moves a reflector follows from the loaded model (6), (7). With C = diag(c) of the joint compliances, the
springs bend by theta = C tau(q + theta), tau the torque of wrench, link weights and compensator. Derivation by one
compliance gives (1 - C H) dtheta/dc_j = tau_j e_j, H = dtau/dtheta. The displacement by the load is that of the loaded
posture less that of the posture under the weights alone.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import MillingError, ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.base.record import specs
from kr270_milling.identification.measurements import Measurements
from kr270_milling.robot.arm import Arm, Mount
from kr270_milling.robot.compensator import Compensator
from kr270_milling.robot.kinematics import LinkFrames, forward, jacobian_at
from kr270_milling.robot.loads import GRAVITY, link_loads, load_hessian, load_torque

__all__ = ["COMPENSATOR", "Problem", "SoftArmError"]

COMPENSATOR = tuple(spec.name for spec in specs(Compensator))
STEP = 1e-4  #: share of its scale by which a number of the compensator is changed for its derivative
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
class Problem:
    """Sought: factors x on the arm's six compliances, then on the compensator's numbers that are named.

    All are 1 for the arm as its file has it. A residual is (model - measurement) / sigma, one for each finite number
    that was measured.
    """

    arm: Arm
    mount: Mount
    measured: Measurements
    gravity: bool = True
    compensator: tuple[str, ...] = ()

    def __post_init__(self):
        for name in self.compensator:
            if name not in COMPENSATOR:
                raise ParameterError("compensator", name, "one of " + ", ".join(COMPENSATOR))
        if self.compensator and not (self.arm.compensator.present and self.gravity):
            allowed = "above 0 in the arm file, and gravity on, where a compensator is to be identified"
            raise ParameterError("arm.compensator.stiffness_n_per_mm", self.arm.compensator.stiffness / 1e3, allowed)

    @property
    def names(self) -> list[str]:
        return [f"joint {j}" for j in range(1, 7)] + [f"compensator {name}" for name in self.compensator]

    @property
    def scale(self) -> np.ndarray:
        """What a factor of 1 stands for [SI], (p,)."""
        values = [getattr(self.arm.compensator, name) for name in self.compensator]
        scales = [v if v else 1.0 for v in values]
        return np.concatenate([self.arm.joint_compliance, scales])

    @property
    def start(self) -> np.ndarray:
        """The factors of the arm file, (p,)."""
        values = [float(bool(getattr(self.arm.compensator, name))) for name in self.compensator]
        return np.concatenate([np.ones(6), values])

    def arm_at(self, x) -> Arm:
        """The arm with these factors."""
        values = np.asarray(x) * self.scale
        changes = dict(zip(self.compensator, values[6:].tolist(), strict=True))
        spring = self.arm.compensator.replace(**changes) if changes else self.arm.compensator
        return self.arm.replace(joint_compliance=values[:6], compensator=spring)

    @property
    def finite(self) -> np.ndarray:
        """(n, 6): what was measured."""
        return np.isfinite(self.measured.displacement)

    def residuals(self, x) -> np.ndarray:
        """(m,), in standard deviations."""
        return self._weighted(self.predict(x))

    def _weighted(self, moved: np.ndarray) -> np.ndarray:
        return ((moved - self.measured.displacement) / self.measured.sigma)[self.finite]

    def linearised(self, x) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (m,) and their derivatives by the factors, (m, p); of the compensator's by differences."""
        x = np.asarray(x, float)
        moved, by_compliance = self.linear(x)
        columns = (by_compliance * self.scale[:6] / self.measured.sigma[..., None])[self.finite]
        for k in range(6, len(x)):
            more, less = x.copy(), x.copy()
            more[k] += STEP
            less[k] -= STEP
            columns = np.column_stack([columns, (self.residuals(more) - self.residuals(less)) / (2 * STEP)])
        return self._weighted(moved), columns

    def derivatives(self, x) -> np.ndarray:
        """The second of ``linearised``."""
        return self.linearised(x)[1]

    def take(self, rows) -> Problem:
        """The problem with some of the load tests."""
        return dataclasses.replace(self, measured=self.measured.take(rows))

    # --- the loaded model ---

    def predict(self, x) -> np.ndarray:
        """Displacements [m, rad], (n, 6), with these factors."""
        return self.linear(x)[0]

    def linear(self, x) -> tuple[np.ndarray, np.ndarray]:
        """Displacements [m, rad], (n, 6), and their derivatives by the compliances, (n, 6, 6). Raises SoftArmError."""
        compliance = np.asarray(x, float)[:6] * self.scale[:6]  # on the way to the fit it need not be one of an arm
        frames, by_joint = self._bent(self.arm_at(x) if self.compensator else self.arm, compliance)
        place = frames.flange.apply(np.tile(self.measured.reflector, (2, 1)))
        full, rest = slice(0, len(self.measured)), slice(len(self.measured), None)
        turn = frames.flange.rotation
        tilt = Rotation.from_matrix(turn[full] @ np.swapaxes(turn[rest], -1, -2)).as_rotvec()
        slopes = jacobian_at(frames, place) @ by_joint
        return np.hstack([place[full] - place[rest], tilt]), slopes[full] - slopes[rest]

    def _bent(self, arm: Arm, c: np.ndarray) -> tuple[LinkFrames, np.ndarray]:
        """Newton's method on theta = C tau(q + theta), for the loaded postures and then those without test load.

        Returns the frames of (2 n,) postures and dtheta/dc, (2 n, 6, 6).
        """
        loads = link_loads(arm, self.mount, GRAVITY if self.gravity else 0.0)
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
        return load_torque(self._frames(self.measured.q), self.measured.wrench, link_loads(self.arm, self.mount, 0.0))
