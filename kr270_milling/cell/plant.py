"""The cell that cuts where it is not the cell that plans: other arm, material, imperfections; from a file or drawn."""

from __future__ import annotations

import dataclasses

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.backlash import Gaps
from kr270_milling.physics.motion.dynamics import ArmModel
from kr270_milling.physics.motion.imperfections import Imperfections
from kr270_milling.physics.motion.milling_pass import PassResult, run_pass
from kr270_milling.physics.robot.kinematics import forward, jacobian_at
from kr270_milling.physics.robot.loads import GRAVITY, link_loads, load_torque
from kr270_milling.physics.robot.mass import rigid_joint_mass

__all__ = ["Plant", "imperfect_arm", "imperfect_course", "joint_gaps", "perturbed"]

MOST_KNOTS = 20_000  #: at which the load on the joints is known along a path


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

        The result is true, and not what a noisy tracker reports: its ``reference`` is the course of the motors, with
        repeatability; its deflections contain the backlash.
        """
        cell, number = self.cell, self.passes
        self.passes += 1
        course = imperfect_course(cell, reference, number)
        iterations = cell.exchange.iterations
        model = imperfect_arm(cell, reference, cell.arm_model(reference))
        silent = cell.programmed.drilling_at
        return run_pass(model, cell.cut(), cell.clock, self.target, course, iterations, progress, silent)


def imperfect_course(cell: Cell, reference: Trajectory, number: int) -> Trajectory:
    """Return the course of the motors of a plant that follows ``reference`` in its pass ``number``."""
    assumed = cell.imperfections
    if not assumed.repeatability:
        return reference
    return reference.with_position(reference.position + assumed.shift(number), reference.velocity)


def imperfect_arm(cell: Cell, reference: Trajectory, model: ArmModel) -> ArmModel:
    """Return the arm of a plant that follows ``reference``: its model, with the backlash of its joints."""
    width = cell.imperfections.backlash
    return dataclasses.replace(model, gaps=joint_gaps(cell, reference, width)) if width.any() else model


def joint_gaps(cell: Cell, reference: Trajectory, width: np.ndarray, periods: int = 1) -> Gaps:
    """Return the gaps of joints with a backlash ``width`` [rad], (6,), along a reference, one knot a controller step.

    periods: exchange periods that count as one step.

    tau = J_G^T G - M_theta q''   weight (6) and inertia of rigid links; q'' from differences of the joint positions
    """
    every = max(cell.steps_of(cell.timing.controller_step), -(-cell.clock.steps(reference.duration_ns) // MOST_KNOTS))
    knots = np.arange(max(3, -(-cell.clock.steps(reference.duration_ns) // every) + 1))
    joints = cell.joints_along(reference, np.minimum(cell.clock.stamp(knots * every), reference.duration_ns))
    frames = forward(cell.arm, cell.mount, joints)
    loads = link_loads(cell.arm, cell.mount, GRAVITY if cell.dynamics.gravity else 0.0)
    inner = np.diff(joints, 2, axis=0) / (every * cell.clock.period) ** 2
    acceleration = np.concatenate([inner[:1], inner, inner[-1:]])
    inertia = np.einsum("nij,nj->ni", rigid_joint_mass(cell.arm, cell.mount, joints), acceleration)
    to_workpiece = np.kron(np.eye(2), cell.workpiece.pose.rotation.T)
    return Gaps(
        torque=load_torque(frames, np.zeros(6), loads) - inertia,
        jacobian=np.ascontiguousarray(to_workpiece @ jacobian_at(frames, frames.tool.position)),
        friction=np.array(cell.arm.friction_torque),
        width=np.array(width, float),
        share=1.0 - float(np.exp(-periods * cell.clock.period * cell.tool.spindle_speed / (2.0 * np.pi))),
        steps_per_knot=every / periods,
    )


def perturbed(cell: Cell, rng: np.random.Generator) -> Cell:
    """A plant drawn from ``cell.uncertainty``: log-normal factors with median 1, a shifted stock, imperfections.

    Frequencies scatter by the masses that move: stiffness has a separate factor.

    Where the place of the part is wrong, the robot runs its program in the same place, so the stock moves under the
    path; the difference of the postures does not matter. The size of the shift is limited to 3 standard
    deviations. The imperfections are drawn evenly from none to what the uncertainties say: the backlash of all joints
    is the same multiple of ``arm.backlash``.
    """
    assumed, law = cell.uncertainty, cell.cutting.active

    def factors(spread: np.ndarray) -> np.ndarray:
        return np.exp(np.sqrt(np.log1p(spread**2)) * rng.standard_normal(spread.size))

    compliance = cell.arm.joint_compliance * factors(assumed.of_compliances())
    axial = law.axial_names if law.axial else ()
    names = (*law.scattered, *axial)
    scattered = zip(names, factors(assumed.of_coefficients(len(names), len(axial))), strict=True)
    law = law.replace(**{name: float(getattr(law, name) * f) for name, f in scattered})
    damping = min(0.9, cell.dynamics.damping_ratio * float(factors(np.array([assumed.damping_ratio]))[0]))
    frequency = float(factors(np.array([assumed.frequency]))[0])
    moved = bool(rng.random() < assumed.reference_inertia)
    shift = assumed.placement * np.clip(rng.standard_normal(3), -3.0, 3.0)
    noise, repeatability, backlash = rng.random(3) * (assumed.pose_noise, assumed.repeatability, assumed.backlash)
    return cell.replace(
        arm=cell.arm.replace(joint_compliance=compliance, link_mass=cell.arm.link_mass / frequency**2),
        mount=cell.mount.replace(mass=cell.mount.mass / frequency**2),
        cutting=cell.cutting.replace(**{cell.cutting.law: law}),
        dynamics=cell.dynamics.replace(damping_ratio=damping, reference_inertia=moved),
        imperfections=Imperfections(noise, repeatability, backlash * cell.arm.backlash, int(rng.integers(2**31))),
        stock=cell.stock.replace(min=cell.stock.min + shift, max=cell.stock.max + shift),
    )
