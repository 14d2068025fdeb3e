"""The cell that cuts where it is not the cell that plans: same path and part, other arm, material and imperfections."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.robot import jacobian
from kr270_milling.simulation.imperfections import Imperfections, play
from kr270_milling.simulation.milling_pass import PassResult, run_pass
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Plant", "imperfect_course"]


class Plant:
    """Runs pass after pass of a plan; the first one is pass 0.

    cell: as the plant's file has it; what is programmed (path, timing, posture at the start) is the model's.
    """

    def __init__(self, model: Cell, cell: Cell, imperfections: Imperfections | None = None):
        programmed = {name: getattr(model, name) for name in ("path", "timing", "start_joints", "compensation")}
        self.cell = cell.replace(imperfections=imperfections or cell.imperfections, **programmed)
        self.target = model.target()
        self.passes = 0  #: run so far

    def run(self, reference: Trajectory, progress=None) -> PassResult:
        """One pass on a fresh workpiece.

        It is true, and not what a noisy tracker reports: its ``reference`` is the course that the motors took, with
        repeatability and backlash.
        """
        cell, number = self.cell, self.passes
        self.passes += 1
        course = imperfect_course(cell, reference, number)
        iterations = cell.exchange.iterations
        return run_pass(cell.arm_model(reference), cell.cut(), cell.clock, self.target, course, iterations, progress)


def imperfect_course(cell: Cell, reference: Trajectory, number: int) -> Trajectory:
    """Where a plant without load has the tool that is told to follow ``reference`` in its pass ``number``.

    Behind the play of the joints straight lines join the ends of the exchange periods.
    """
    how = cell.imperfections
    if how.backlash.any():
        stamps = cell.clock.stamp(np.arange(cell.clock.steps(reference.duration_ns) + 1))
        stamps[-1] = max(int(stamps[-2]) + 1, min(int(stamps[-1]), reference.duration_ns))
        joints = cell.joints_along(reference, stamps)
        moves = cell.workpiece.pose.rotation.T @ jacobian(cell.arm, cell.mount, joints)[:, :3]
        lost = play(joints, how.backlash) - joints
        # counted from where the pass begins, where the tool was touched off
        shift = np.einsum("nij,nj->ni", moves, lost - lost[0])
        turns = reference.sample_orientation(stamps)
        reference = Trajectory(stamps, reference.sample(stamps) + shift, turns, None, reference.frame)
    if not how.repeatability:
        return reference
    return reference.with_position(reference.position + how.shift(number), reference.velocity)
