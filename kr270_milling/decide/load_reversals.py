"""Places of a path where the load on a joint reverses, so that its backlash moves the tool."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.paths import CellPath
from kr270_milling.cell.plant import joint_gaps
from kr270_milling.decide.findings import Finding, violation
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.backlash import tool_jumps
from kr270_milling.physics.robot.arm import ASSUMED_BACKLASH

ARCSEC = math.pi / 648000  # [rad]


def load_reversals(arm: PlacedArm, path: CellPath, run: Trajectory, ran: ScoredPass) -> list[Finding]:
    """Each change of a flank under weight, inertia of the path and the cut of the simulated pass, in the order of time.

    The gaps are those of a plant whose joints have ``arm.backlash``; see ``physics.motion.backlash``.
    """
    width, result = arm.arm.backlash, ran.result
    places = []
    least_jump = 1e-7  # [m], of the tool; a smaller jump shows nowhere
    for step, joint, jump in tool_jumps(joint_gaps(arm, path, run, width, result.every), result.wrench):
        if jump < least_jump:
            continue
        point = int(np.clip(np.searchsorted(run.time_ns, result.time_ns[step]), 0, len(run) - 1)) + 1
        amounts = {"arcsec": float(width[joint] / ARCSEC), "friction_n_m": float(arm.arm.friction_torque[joint])}
        source = " (assumed)" if math.isclose(width[joint], ASSUMED_BACKLASH[joint]) else " (arm.backlash_arcsec)"
        places.append(
            violation("load reversal", jump, 0.0, point, subject=f"axis {joint + 1}", amounts=amounts, source=source)
        )
    return places


def backlash_statement(
    backlash: np.ndarray, shares: tuple[float, float], reversals: Sequence[Finding] | None, drawn: bool
) -> str:
    """Return whether the decision includes the backlash [rad], (6,).

    shares: smallest and largest multiple of it in a plant; drawn: a verdict with plants was made.
    """
    least, most = (share * float(backlash.max()) / ARCSEC for share in shares)
    if not backlash.any():
        return "backlash: none (arm.backlash_arcsec is 0)"
    if drawn and most:
        return f"backlash: in the verdict only, {least:.3g} to {most:.3g} arcsec"
    if not reversals:
        return f"backlash: not included{'' if reversals is None else ', no load reverses'}"
    largest = max(finding.value for finding in reversals)
    places = f"{len(reversals)} place{'s' * (len(reversals) > 1)}"
    return f"backlash: not included, up to {largest:.3g} um where the load on an axis reverses ({places})"
