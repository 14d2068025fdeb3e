"""What a cell says about its arm's motion: YAML ``dynamics``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter
from kr270_milling.robot.mass import MODELS

__all__ = ["Dynamics", "MeasuredModes"]


@dataclass(frozen=True, eq=False)
class MeasuredModes(Record):
    """YAML ``dynamics.modes``: a list with one group a mode, or one group of lists; of one posture, at the tool tip.

    A mode of frequency f, ratio zeta and shape phi answers a wrench w on the tool with
    phi (phi . w) / (omega^2 - s^2 + 2 i zeta omega s) at the circular frequency s, omega = 2 pi f; workpiece axes.
    """

    frequency: np.ndarray = parameter([], unit="hz", above=0.0, high=1e4, text="undamped natural frequency of each")
    damping_ratio: np.ndarray = parameter([], low=0.0, high=0.99, text="damping ratio of each mode")
    shape: np.ndarray = parameter(
        [],
        text="x, y, z [kg^-1/2], rx, ry, rz [rad/m kg^-1/2] of each, mass-normalised; six numbers a mode",
    )

    def check(self) -> None:
        n = self.frequency.size
        if not n <= 6:
            raise ParameterError("frequency_hz", self.frequency.tolist(), "at most 6 modes")
        for key, size in (("damping_ratio", n), ("shape", 6 * n)):
            values = getattr(self, key)
            if values.size != size:
                raise ParameterError(key, values.tolist(), f"a list of {size} numbers for {n} modes")
        shapes = self.shape.reshape(n, 6)
        if n and np.linalg.matrix_rank(shapes) < n:
            raise ParameterError("shape", self.shape.tolist(), "shapes of which none is a combination of the others")


@dataclass(frozen=True, eq=False)
class Dynamics(Record):
    """YAML ``dynamics``: how the arm moves under load."""

    mass_model: str = parameter(
        text="M_C of (25): lumped, all links ride with the tool; consistent, the paper's beams; rigid, rigid links",
        choices=MODELS,
    )
    damping_ratio: float = parameter(low=0.0, high=0.99, text="damping ratio of every mode")
    gravity: bool = parameter(True, text="linearise about the equilibrium under the link weights")
    follow_pose: bool = parameter(
        False, text="stiffness and mass follow the posture along the path; false: at its start"
    )
    posture_spacing: float = parameter(5e-3, unit="mm", above=0.0, high=1000.0, text="way between two such postures")
    reference_inertia: bool = parameter(
        True, text="the reference moves the motor side: F - M r'' in (1); false: (1) as the paper prints it"
    )
    modes: MeasuredModes = MeasuredModes()

    def check(self) -> None:
        if self.modes.frequency.size and self.follow_pose:
            raise ParameterError("follow_pose", True, "false where dynamics.modes are given: they are of one posture")
