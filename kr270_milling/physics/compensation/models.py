"""The models of arm and cut that a compensation method may use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.response import ArmResponse
from kr270_milling.physics.compensation.revision import PassRecord
from kr270_milling.physics.motion.dynamics import ArmFactors


@dataclass(frozen=True, eq=False)
class CellModels:
    """Functions of one cell; None: not available."""

    #: target, mean wrenches (k, 6) [N, N m] at its knots -> points that the load moves onto the target, (30)-(32)
    mirror: Callable[[Trajectory, np.ndarray], Trajectory] | None = None
    #: target -> the response of the arm along the target; None: the tool follows the reference at once
    arm: Callable[[Trajectory], ArmResponse] | None = None
    #: reference, factors on the modelled arm or None -> the pass that the model predicts
    predict: Callable[[Trajectory, ArmFactors | None], PassRecord] | None = None
    #: path of a tool that does not deviate -> wrenches of the modelled cut
    cut: Callable[[Trajectory], PassRecord] | None = None
    #: target, reference -> the model first and then drawn robots: response, true pass along the reference
    robots: Callable[[Trajectory, Trajectory], list[tuple[ArmResponse, PassRecord]]] | None = None
