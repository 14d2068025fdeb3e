"""How well the models are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter

__all__ = ["Uncertainty"]


@dataclass(frozen=True, eq=False)
class Uncertainty(Record):
    """YAML ``uncertainty``: relative standard deviations (of log-normal factors) and a standard deviation in mm.

    All defaults are assumed: identified joint compliances scatter by 10 to 20 % between methods and postures, cutting
    coefficients by as much between batches and tool wear, modal damping by a third from mode to mode, frequencies by a
    tenth; a part is touched off within a few hundredths of a millimetre. Repeatability, noise and backlash of a plant
    are drawn evenly from 0 to the value here.
    """

    joint_compliance: float = parameter(0.15, low=0.0, high=1.0, text="of each joint's compliance")
    force_coefficient: float = parameter(0.15, low=0.0, high=1.0, text="of each coefficient of the force law")
    joint_compliances: np.ndarray = parameter(
        [], low=0.0, high=1.0, text="of each joint on its own, as identified; empty: joint_compliance for all"
    )
    force_coefficients: np.ndarray = parameter(
        [], low=0.0, high=1.0, text="of each coefficient of the force law on its own; empty: force_coefficient for all"
    )
    damping_ratio: float = parameter(0.3, low=0.0, high=1.0, text="of the damping ratio of all modes")
    frequency: float = parameter(0.1, low=0.0, high=1.0, text="of the frequencies of all modes, by the moving masses")
    reference_inertia: float = parameter(
        1.0,
        low=0.0,
        high=1.0,
        text="share of the plants whose reference moves the motor side, as every real arm's does",
    )
    # ISO 9283, 0.06 mm: data sheet of the KR 270; noise: a laser tracker at some metres; backlash: half a minute of arc
    repeatability: float = parameter(60e-6, unit="um", low=0.0, high=1e4, text="largest repeatability of a plant")
    pose_noise: float = parameter(10e-6, unit="um", low=0.0, high=1e4, text="largest noise of a measured position")
    backlash: float = parameter(
        np.radians(0.5 / 60.0), unit="deg", low=0.0, high=5.0, text="largest backlash of a joint of a plant"
    )
    placement: float = parameter(
        0.05e-3, unit="mm", low=0.0, high=10.0, text="of the stock's place along each axis of the workpiece frame"
    )
    matters_above: float = parameter(
        10e-6, unit="um", low=0.0, high=1e4, text="deviations below this do not matter to the part"
    )

    def check(self) -> None:
        if self.joint_compliances.size not in (0, 6):
            raise ParameterError("joint_compliances", self.joint_compliances.tolist(), "empty or one number a joint")

    def of_compliances(self) -> np.ndarray:
        """Of the six compliances, (6,)."""
        return self.joint_compliances if self.joint_compliances.size else np.full(6, self.joint_compliance)

    def of_coefficients(self, count: int) -> np.ndarray:
        """Of so many coefficients of the force law in use, (count,); raises ParameterError."""
        if not self.force_coefficients.size:
            return np.full(count, self.force_coefficient)
        if self.force_coefficients.size != count:
            allowed = f"empty or one number for each of the {count} coefficients of the force law in use"
            raise ParameterError("uncertainty.force_coefficients", self.force_coefficients.tolist(), allowed)
        return self.force_coefficients
