"""One milling pass, Fig. 7: the arm predicts the tool's pose, the cut answers with the wrench, the arm corrects.

The functions that the compiled loop calls are the same that a robot node and a cutting node call one by one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.simulation.dynamics import ArmModel, advance

__all__ = ["CompliantArm", "PassResult", "run_pass"]

CHUNK = 200  # exchange periods between two reports of progress


@dataclass(frozen=True, eq=False)
class PassResult:
    """Series of one pass at the ends of its n exchange periods (first row: the start), workpiece axes."""

    time_ns: np.ndarray  #: [ns], (n + 1,)
    target: np.ndarray  #: programmed tool centre [m], (n + 1, 3)
    reference: np.ndarray  #: what the controller was told [m], (n + 1, 3)
    tool: np.ndarray  #: tool centre that the cut was given: predicted [m], (n + 1, 3)
    deflection: np.ndarray  #: corrected displacement of the arm [m, rad], (n + 1, 6)
    wrench: np.ndarray  #: mean over each period, on the tool [N, N m], (n + 1, 6)
    correction: np.ndarray  #: corrected minus predicted tool centre [m], (n + 1,)
    micro_steps: int  #: of the spindle in the whole pass
    removed_area: float  #: [m^2]
    removed_volume: float  #: [m^3]
    wall_time: float  #: [s], of the pass alone

    @property
    def time(self) -> np.ndarray:
        """[s]"""
        return self.time_ns * 1e-9

    @property
    def actual(self) -> np.ndarray:
        """Tool centre [m], (n + 1, 3)."""
        return self.reference + self.deflection[:, :3]


class CompliantArm:
    """The arm's half of the exchange: state of eq. (1), stepped by ``predict`` and ``correct``."""

    def __init__(self, model: ArmModel):
        self.model = model
        self.step = 0  #: exchange periods done
        self.state = np.zeros(model.order)
        self.wrench = np.zeros(6)
        self._scratch = np.zeros(model.order)

    def predict(self, wrench: np.ndarray | None = None) -> np.ndarray:
        """Deflection (6,) at the end of the next period under ``wrench``, or under that of the last period."""
        deflection = np.zeros(6)
        advance(
            self.step,
            self.state,
            self.wrench if wrench is None else wrench,
            self.model.arrays,
            self._scratch,
            deflection,
        )
        return deflection

    def correct(self, wrench: np.ndarray) -> np.ndarray:
        """Integrate the period with the wrench (6,) that acted in it; returns the deflection (6,) at its end."""
        deflection = np.zeros(6)
        advance(self.step, self.state, wrench, self.model.arrays, self._scratch, deflection)
        self.state, self._scratch = self._scratch, self.state
        self.wrench = np.array(wrench, float)
        self.step += 1
        return deflection
