"""The least squares problem of a load test: which numbers are sought, weighted residuals and their derivatives."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import specs
from kr270_milling.identification.load_model import LoadModel
from kr270_milling.identification.measurements import Measurements
from kr270_milling.robot.arm import Arm, Mount
from kr270_milling.robot.compensator import Compensator

__all__ = ["COMPENSATOR", "Problem"]

COMPENSATOR = tuple(spec.name for spec in specs(Compensator))
STEP = 1e-4  #: share of its scale by which a number of the compensator is changed for its derivative


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

    def model(self, x) -> LoadModel:
        """What predicts the displacements with these factors; the compliances are handed to it."""
        return LoadModel(self.arm_at(x) if self.compensator else self.arm, self.mount, self.measured, self.gravity)

    @property
    def finite(self) -> np.ndarray:
        """(n, 6): what was measured."""
        return np.isfinite(self.measured.displacement)

    def residuals(self, x) -> np.ndarray:
        """(m,), in standard deviations."""
        moved = self.model(x).predict(np.asarray(x)[:6] * self.scale[:6])
        return ((moved - self.measured.displacement) / self.measured.sigma)[self.finite]

    def linearised(self, x) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (m,) and their derivatives by the factors, (m, p); of the compensator's by differences."""
        x = np.asarray(x, float)
        moved, by_compliance = self.model(x).predict(x[:6] * self.scale[:6], derivatives=True)
        left = ((moved - self.measured.displacement) / self.measured.sigma)[self.finite]
        columns = (by_compliance * self.scale[:6] / self.measured.sigma[..., None])[self.finite]
        for k in range(6, len(x)):
            more, less = x.copy(), x.copy()
            more[k] += STEP
            less[k] -= STEP
            columns = np.column_stack([columns, (self.residuals(more) - self.residuals(less)) / (2 * STEP)])
        return left, columns

    def derivatives(self, x) -> np.ndarray:
        """The second of ``linearised``."""
        return self.linearised(x)[1]

    def take(self, rows) -> Problem:
        """The problem with some of the load tests."""
        return dataclasses.replace(self, measured=self.measured.take(rows))
