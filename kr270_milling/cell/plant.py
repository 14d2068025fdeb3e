"""The cell that cuts where it is not the cell that plans: other arm, material, imperfections; from a file or drawn."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.imperfections import Imperfections, play
from kr270_milling.physics.motion.milling_pass import PassResult, run_pass
from kr270_milling.physics.robot import jacobian

__all__ = ["Plant", "imperfect_course", "perturbed"]


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
        return run_pass(
            cell.arm_model(reference), cell.cut(), cell.clock, self.target, course, iterations, progress,
            cell.programmed.drilling_at,
        )  # fmt: skip


def imperfect_course(cell: Cell, reference: Trajectory, number: int) -> Trajectory:
    """Return the path of the unloaded tool of a plant that follows ``reference`` in its pass ``number``.

    With the play of the joints straight lines join the ends of the exchange periods.
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


def perturbed(cell: Cell, rng: np.random.Generator) -> Cell:
    """A plant drawn from ``cell.uncertainty``: log-normal factors with median 1, a shifted stock, imperfections.

    Frequencies scatter by the masses that move: stiffness has a separate factor.

    Where the place of the part is wrong, the robot runs its program in the same place, so the stock moves under the
    path; the difference of the postures does not matter. The size of the shift is limited to 3 standard
    deviations. The imperfections are drawn evenly from none to what the uncertainties say, the backlash of all joints
    alike.
    """
    how, law = cell.uncertainty, cell.cutting.active

    def factors(spread: np.ndarray) -> np.ndarray:
        return np.exp(np.sqrt(np.log1p(spread**2)) * rng.standard_normal(spread.size))

    compliance = cell.arm.joint_compliance * factors(how.of_compliances())
    axial = law.axial_names if law.axial else ()
    names = (*law.scattered, *axial)
    scattered = zip(names, factors(how.of_coefficients(len(names), len(axial))), strict=True)
    law = law.replace(**{name: float(getattr(law, name) * f) for name, f in scattered})
    damping = min(0.9, cell.dynamics.damping_ratio * float(factors(np.array([how.damping_ratio]))[0]))
    frequency = float(factors(np.array([how.frequency]))[0])
    moved = bool(rng.random() < how.reference_inertia)
    shift = how.placement * np.clip(rng.standard_normal(3), -3.0, 3.0)
    noise, repeatability, backlash = rng.random(3) * (how.pose_noise, how.repeatability, how.backlash)
    return cell.replace(
        arm=cell.arm.replace(joint_compliance=compliance, link_mass=cell.arm.link_mass / frequency**2),
        mount=cell.mount.replace(mass=cell.mount.mass / frequency**2),
        cutting=cell.cutting.replace(**{cell.cutting.law: law}),
        dynamics=cell.dynamics.replace(damping_ratio=damping, reference_inertia=moved),
        imperfections=Imperfections(noise, repeatability, np.full(6, backlash), int(rng.integers(2**31))),
        stock=cell.stock.replace(min=cell.stock.min + shift, max=cell.stock.max + shift),
    )
