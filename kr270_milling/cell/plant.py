"""The cell that cuts where it is not the cell that plans: other arm, material, imperfections; from a file or drawn."""

from __future__ import annotations

import dataclasses
import math
import os

import numpy as np
from scipy.special import ndtr

from kr270_milling.base.errors import ParameterError
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import arm_model_of, arm_of, cut_of, flat_floors, path_of
from kr270_milling.cell.paths import CellPath
from kr270_milling.path.controller_motion import other_motion
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import Tool
from kr270_milling.physics.cutting.grid import RESOLVED_NODES
from kr270_milling.physics.motion.backlash import Gaps
from kr270_milling.physics.motion.dynamics import ArmModel
from kr270_milling.physics.motion.imperfections import Imperfections
from kr270_milling.physics.motion.milling_pass import MANY, PassResult, run_pass
from kr270_milling.physics.robot.kinematics import forward, jacobian_at
from kr270_milling.physics.robot.loads import GRAVITY, link_loads, load_torque
from kr270_milling.physics.robot.mass import rigid_joint_mass

DIVERGED = 10e-3  #: [m] a plant whose tool strays farther is unstable


class Plant:
    """Runs pass after pass of a plan; the first one is pass 0.

    cell: as the plant's file has it; what is programmed (path, timing, posture at the start) is the model's.
    """

    def __init__(self, model: Cell, cell: Cell, imperfections: Imperfections | None = None):
        programmed = {
            name: getattr(model, name) for name in ("path", "timing", "start_joints", "compensation", "stage", "krl")
        }
        self.cell = cell.replace(imperfections=imperfections or cell.imperfections, **programmed)
        self.target = path_of(model).target
        self.passes = 0  #: run so far

    def run(self, reference: Trajectory, progress=None, heights: bool = False) -> PassResult:
        """Run a pass on a fresh workpiece; heights: the result has the map of the part.

        The result is true, and not what a noisy tracker reports: its ``reference`` is the motion of the motors, with
        repeatability; its deflections contain the backlash.
        """
        cell, number = self.cell, self.passes
        self.passes += 1
        motion = imperfect_course(cell, reference, number, self.target)
        iterations = cell.exchange.iterations
        model, cut = imperfect_arm(cell, reference), cut_of(cell)
        silent = path_of(cell).drilling_at
        result = run_pass(model, cut, path_of(cell).clock, self.target, motion, iterations, progress, silent)
        return dataclasses.replace(result, heights=cut.map_heights()[2]) if heights else result


def imperfect_course(cell: Cell, reference: Trajectory, number: int, target: Trajectory | None = None) -> Trajectory:
    """Return the motion of the motors of a plant that follows ``reference`` in its pass ``number``.

    target: the programmed trajectory; None: that of the cell.
    """
    assumed = cell.imperfections
    target = path_of(cell).target if target is None else target
    if assumed.joining:
        reference = other_motion(reference, target, assumed.joining, cell.krl.blend_distance)
    if assumed.servo_frequency or assumed.servo_delay:
        reference = assumed.lagged(reference, target)
    if not assumed.repeatability:
        return reference
    return reference.with_position(reference.position + assumed.shift(number), reference.velocity)


def imperfect_arm(cell: Cell, reference: Trajectory, model: ArmModel | None = None) -> ArmModel:
    """Return the arm of a plant that follows ``reference``: its model, with the backlash of its joints."""
    model, width = model or arm_model_of(cell, reference), cell.imperfections.backlash
    if not width.any():
        return model
    return dataclasses.replace(model, gaps=joint_gaps(arm_of(cell), path_of(cell), reference, width))


def joint_gaps(arm: PlacedArm, path: CellPath, reference: Trajectory, width: np.ndarray, periods: int = 1) -> Gaps:
    """Return the gaps of joints with a backlash ``width`` [rad], (6,), along a reference, one knot a controller step.

    periods: exchange periods that count as one step.

    tau = J_G^T G - M_theta q''   weight (6) and inertia of rigid links; q'' from differences of the joint positions
    """
    clock = path.clock
    steps = clock.steps(reference.duration_ns)
    most_knots = 20_000  # at which the load on the joints is known along a path
    every = max(path.exchange.steps_of(path.timing.controller_step), -(-steps // most_knots))
    knots = np.arange(max(3, -(-steps // every) + 1))
    joints = arm.joints_along(reference, np.minimum(clock.stamp(knots * every), reference.duration_ns))
    frames = forward(arm.arm, arm.mount, joints)
    loads = link_loads(arm.arm, arm.mount, GRAVITY if arm.dynamics.gravity else 0.0)
    inner = np.diff(joints, 2, axis=0) / (every * clock.period) ** 2
    acceleration = np.concatenate([inner[:1], inner, inner[-1:]])
    inertia = np.einsum("nij,nj->ni", rigid_joint_mass(arm.arm, arm.mount, joints), acceleration)
    to_workpiece = np.kron(np.eye(2), arm.place.rotation.T)
    return Gaps(
        torque=load_torque(frames, np.zeros(6), loads) - inertia,
        jacobian=np.ascontiguousarray(to_workpiece @ jacobian_at(frames, frames.tool.position)),
        friction=np.array(arm.arm.friction_torque),
        width=np.array(width, float),
        share=1.0 - float(np.exp(-periods * clock.period * path.tool.spindle_speed / (2.0 * np.pi))),
        steps_per_knot=every / periods,
    )


class Numbers:
    """The standard normal numbers behind a robot, in place of the random generator that draws it.

    An even number is the normal distribution function of a normal number.
    """

    def __init__(self, values: np.ndarray, seed: int):
        self.values, self.seed, self.used = values, seed, 0

    def standard_normal(self, size: int) -> np.ndarray:
        first, self.used = self.used, self.used + size
        rest = self.values[first : self.used]
        return np.append(rest, np.zeros(size - rest.size))

    def random(self, size: int | None = None):
        even = ndtr(self.standard_normal(size or 1))
        return even if size else even[0]

    def uniform(self, low: float, high: float) -> float:
        return low + (high - low) * self.random()

    def integers(self, _: int) -> int:
        return self.seed


def numbers_of(cell: Cell) -> int:
    """Return how many numbers make a robot of a cell."""
    source = Numbers(np.zeros(0), 0)
    _drawn(cell, source)
    return source.used


def robot_of(cell: Cell, numbers: np.ndarray, seed: int = 0) -> Cell:
    """The robot behind numbers (n,) that ``perturbed`` draws from a standard normal distribution.

    seed: of its noise and repeatability.
    """
    source = Numbers(numbers, seed)
    robot = _drawn(cell, source)
    if source.used != numbers.size:
        allowed = f"{source.used} numbers for this force law and these uncertainties: learn from the parts again"
        raise ParameterError("uncertainty.learned", numbers.tolist(), allowed)
    return robot


def perturbed(cell: Cell, rng: np.random.Generator) -> Cell:
    """A robot drawn from ``cell.uncertainty``, or from what was learned of it from measured parts.

    z = m + sqrt(I - D^T D) e   numbers of the robot, e standard normal; m, D: ``learned``, ``learned_directions``
    """
    learned = cell.uncertainty.learned
    if not learned.size:
        return _drawn(cell, rng)
    directions = cell.uncertainty.learned_directions.reshape(-1, learned.size)
    size, axes = np.linalg.eigh(np.eye(learned.size) - directions.T @ directions)
    drawn = rng.standard_normal(learned.size)
    return robot_of(cell, learned + axes @ (np.sqrt(np.maximum(size, 0.0)) * drawn), int(rng.integers(2**31)))


def _drawn(cell: Cell, rng: np.random.Generator | Numbers) -> Cell:
    """Log-normal factors with median 1, a shifted stock, imperfections.

    Frequencies scatter by the masses that move: stiffness has a separate factor.

    Where the place of the part is wrong, the robot runs its program in the same place, so the stock moves under the
    path; the difference of the postures does not matter. The size of the shift is limited to 3 standard
    deviations. The imperfections are drawn evenly from none to what the uncertainties say: the backlash of all joints
    is the same multiple of ``arm.backlash``. Wear multiplies all forces. A base and a tool that the cell takes as rigid
    get a compliance; those of a cell that has them scatter.
    """
    assumed, law = cell.uncertainty, cell.cutting.active

    def factors(spread: np.ndarray) -> np.ndarray:
        return np.exp(np.sqrt(np.log1p(spread**2)) * rng.standard_normal(spread.size))

    stated = assumed.joint_compliances
    compliance = cell.arm.joint_compliance * factors(stated if stated.size else np.full(6, assumed.joint_compliance))
    axial = law.axial_names if law.axial else ()
    names = (*law.scattered, *axial)
    scattered = zip(names, factors(assumed.of_coefficients(len(names), len(axial))), strict=True)
    law = law.replace(**{name: float(getattr(law, name) * f) for name, f in scattered})
    damping = min(0.9, cell.dynamics.damping_ratio * float(factors(np.array([assumed.damping_ratio]))[0]))
    frequency = float(factors(np.array([assumed.frequency]))[0])
    moved = bool(rng.random() < assumed.reference_inertia)
    shift = assumed.placement * np.clip(rng.standard_normal(3), -3.0, 3.0)
    widest = assumed.backlash - assumed.least_backlash
    noise, repeatability, backlash = rng.random(3) * (assumed.pose_noise, assumed.repeatability, widest)
    backlash += assumed.least_backlash
    seed = int(rng.integers(2**31))
    law = law.grown(1.0 + assumed.tool_wear * float(rng.random()))
    servo = float(rng.uniform(*assumed.servo_frequency)) if assumed.servo_frequency.size else 0.0
    delay = cell.imperfections.servo_delay + float(rng.random()) * assumed.servo_delay
    base, tool = _softer(cell, rng, factors(np.full(4, assumed.tool_compliance)))
    later = rng if isinstance(rng, Numbers) else np.random.default_rng(seed)  # the draws of earlier versions stay
    joining = assumed.joining * float(later.random())
    share = float(later.uniform(*assumed.end_share)) if assumed.end_share.size else cell.cutting.end_share
    return cell.replace(
        arm=cell.arm.replace(
            joint_compliance=compliance, link_mass=cell.arm.link_mass / frequency**2, base_compliance=base
        ),
        tool=tool,
        mount=cell.mount.replace(mass=cell.mount.mass / frequency**2),
        cutting=cell.cutting.replace(**{cell.cutting.law: law}, end_share=share),
        dynamics=cell.dynamics.replace(damping_ratio=damping, reference_inertia=moved),
        imperfections=cell.imperfections.replace(
            pose_noise=noise,
            repeatability=repeatability,
            backlash=backlash * cell.arm.backlash,
            servo_frequency=servo,
            servo_delay=delay,
            joining=joining,
            seed=seed,
            first_pass=0,
        ),
        stock=cell.stock.replace(min=cell.stock.min + shift, max=cell.stock.max + shift),
    )


def _softer(cell: Cell, rng: np.random.Generator | Numbers, factors: np.ndarray) -> tuple[np.ndarray, Tool]:
    """Compliances of the base (3,) [rad/(N m)] and the tool of a plant; factors (4,): on those that the cell has."""
    assumed, own, tool = cell.uncertainty, cell.arm.base_compliance, cell.tool.replace(holder=np.zeros(0))
    drawn = assumed.base_compliance * np.append(rng.random(2), 0.0)
    base = np.where(own > 0.0, own * factors[:3], drawn)
    longest = tool.replace(stiffness=0.0, stick_out=min(0.5, assumed.tool_stick_out * tool.diameter))
    share = float(rng.random())
    soft = tool.lateral_compliance * float(factors[3]) or share * longest.lateral_compliance
    stiffest = 1e10  # [N/m] of a tool: a stiffer one is rigid
    stiffness = min(1.0 / soft, stiffest) if soft > 0.0 else 0.0
    return base, tool.replace(stiffness=stiffness, stick_out=0.0)


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def coarser(cell: Cell) -> Cell:
    """Return the cell for the many passes of simulated robots along a tool path: quick passes.

    Postures are 20 mm apart. The map of the mean-force model stays: on 1.5 times its step two of twelve robots of the
    test piece swing 53 and 153 um farther. In a long program a flat end exchanges every 6 ms in place of 4 ms: errors
    of 60 to 120 um then differ by 1 to 3 um. A sweep of the teeth has a grid step of up to the feed per tooth, at most
    five times its own, on which a tooth at the slow feed meets five nodes in a micro-step: a slot has 95 % of its
    force. Short exchange periods become twice as long, and their micro-steps of the spindle twice or four times. The
    errors of robots then differ by some percent; ``monte_carlo`` states the difference for two robots.
    """
    if path_of(cell).fed is None:
        return cell
    spacing = 20e-3  # [m] of postures: at 5 mm the errors of robots differ by 1 to 2 %
    cell = cell.replace(dynamics=cell.dynamics.replace(posture_spacing=max(spacing, cell.dynamics.posture_spacing)))
    if cell.stage:
        earlier = tuple(removal.quick for removal in cell.stage.earlier)
        cell = cell.replace(stage=dataclasses.replace(cell.stage, earlier=earlier))
    exchange, steps = cell.exchange, path_of(cell).clock.micro_steps
    if cell.cutting.by_engagement:
        longest = 5e-3  # [s] of a period; longer ones do not change
        steps = path_of(cell).clock.steps(path_of(cell).target.duration_ns)
        if not flat_floors(cell) or steps < MANY or exchange.period > longest:
            return cell
        return cell.replace(exchange=exchange.rounded(1.5 * exchange.period, cell.tool.spindle_speed))
    long_period, long_step = 0.3e-3, math.radians(1.0) + 1e-9  # [s], [rad] of the exchange; longer ones do not change
    if exchange.period <= long_period and exchange.micro_step <= long_step:
        larger = 4.0 if steps % 2 == 0 else 2.0
        exchange = exchange.replace(period=2.0 * exchange.period, micro_step=larger * exchange.micro_step)
    tooth = 2.0 * math.pi / (cell.tool.spindle_speed * cell.tool.teeth)  # [s]
    largest, slow, _ = cell.path.feeds
    swept = (slow or largest) * tooth * float(cell.tool.radii.max()) * exchange.micro_step
    own = cell.stock.grid_step
    step = max(own, min(5.0 * own, largest * tooth, math.sqrt(2.0 * swept / RESOLVED_NODES)))
    return cell.replace(stock=cell.stock.replace(grid_step=step), exchange=exchange)
