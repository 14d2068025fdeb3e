"""Passes of plants that differ from the model as the uncertainties say; the trajectories stay those of the model."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.base.record import Record
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.plant import imperfect_course
from kr270_milling.cell.sections import Uncertainty
from kr270_milling.simulation.imperfections import Imperfections
from kr270_milling.simulation.milling_pass import PassResult, run_pass
from kr270_milling.simulation.scores import path_deviation
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["AXIAL", "SCATTERED", "coarser", "deviations", "perturbed", "run_sample"]

#: what scatters of each force law; the ratio of the slopes of the fractional one shapes it and is left alone
SCATTERED = {
    "fractional": ("stiffness", "specific_chip_thickness", "radial_ratio"),
    "linear_edge": ("tangential_cutting", "tangential_edge", "radial_cutting", "radial_edge"),
}
#: and what scatters beside them where there is an axial force
AXIAL = {"fractional": ("axial_ratio",), "linear_edge": ("axial_cutting", "axial_edge")}
LONG_PERIOD, LONG_STEP = 0.3e-3, math.radians(1.0) + 1e-9  #: [s], [rad] of the exchange; longer ones stay as they are
DIVERGED = 10e-3  #: [m] a plant whose tool strays farther is unstable


def perturbed(cell: Cell, rng: np.random.Generator) -> Cell:
    """A plant drawn from ``cell.uncertainty``: log-normal factors with median 1, a shifted stock, imperfections.

    Frequencies scatter by the masses that move: stiffness has a factor of its own.

    Where the part lies otherwise than thought, the robot runs its programme in the same place, so it is the stock that
    moves under the path; by how much the postures differ is no matter. The size of the shift is limited to 3 standard
    deviations.
    """
    how, law = cell.uncertainty, cell.cutting.law

    def factors(spread: np.ndarray) -> np.ndarray:
        return np.exp(np.sqrt(np.log1p(spread**2)) * rng.standard_normal(spread.size))

    compliance = cell.arm.joint_compliance * factors(how.of_compliances())
    axial = AXIAL[law] if cell.cutting.axial else ()
    names = (*SCATTERED[law], *axial)
    coefficients: Record = getattr(cell.cutting, law)
    scattered = zip(names, factors(how.of_coefficients(len(names), len(axial))), strict=True)
    coefficients = coefficients.replace(**{name: float(getattr(coefficients, name) * f) for name, f in scattered})
    damping = min(0.9, cell.dynamics.damping_ratio * float(factors(np.array([how.damping_ratio]))[0]))
    frequency = float(factors(np.array([how.frequency]))[0])
    moved = bool(rng.random() < how.reference_inertia)
    shift = how.placement * np.clip(rng.standard_normal(3), -3.0, 3.0)
    return cell.replace(
        arm=cell.arm.replace(joint_compliance=compliance, link_mass=cell.arm.link_mass / frequency**2),
        mount=cell.mount.replace(mass=cell.mount.mass / frequency**2),
        cutting=cell.cutting.replace(**{law: coefficients}),
        dynamics=cell.dynamics.replace(damping_ratio=damping, reference_inertia=moved),
        imperfections=_imperfect(how, rng),
        stock=cell.stock.replace(min=cell.stock.min + shift, max=cell.stock.max + shift),
    )


def _imperfect(how: Uncertainty, rng: np.random.Generator) -> Imperfections:
    """Evenly from none to what the uncertainties say; the backlash of all joints alike."""
    noise, repeatability, backlash = rng.random(3) * (how.pose_noise, how.repeatability, how.backlash)
    return Imperfections(noise, repeatability, np.full(6, backlash), int(rng.integers(2**31)))


def run_sample(
    plant: Cell, target: Trajectory, references: Sequence[Trajectory], scored_from: float | None
) -> np.ndarray:
    """Largest and static deviation [m], (k, 2), of one plant along k references; NaN where it does not survive one.

    The references are corrections of one target: the arm's model along the target holds for all.
    """
    rows = np.full((len(references), 2), np.nan)
    try:
        model = plant.arm_model(target)
        for k, reference in enumerate(references):
            course = imperfect_course(plant, reference, k)
            ran = run_pass(model, plant.cut(), plant.clock, target, course, plant.exchange.iterations)
            found = deviations(ran, target, scored_from)
            rows[k] = found if found[0] < DIVERGED else np.nan
    except MillingError:
        pass
    return rows


def coarser(cell: Cell) -> Cell:
    """For the many passes along a tool path: a grid step of up to half the feed per tooth, at most three times its own,
    and exchange periods and micro-steps of the spindle twice as long where they are short.

    On the shipped test piece the largest deviation then moves by less than 1 %, far below the bands, and a pass takes
    a quarter of the time.
    """
    turns = cell.tool.spindle_speed / (2.0 * math.pi)
    fed = cell.fed_path
    if fed is None:
        return cell
    feed_per_tooth = float(fed.toolpath.feed.max(initial=0.0)) / (turns * cell.tool.teeth)
    step = min(3.0 * cell.stock.grid_step, max(cell.stock.grid_step, 0.5 * feed_per_tooth))
    how = cell.exchange
    if how.period <= LONG_PERIOD and how.micro_step <= LONG_STEP:
        how = how.replace(period=2.0 * how.period, micro_step=2.0 * how.micro_step)
    return cell.replace(stock=cell.stock.replace(grid_step=step), exchange=how)


def deviations(result: PassResult, target: Trajectory, scored_from: float | None) -> tuple[float, float]:
    """Largest and static path deviation [m] of a pass.

    scored_from [s]: of a straight cut, as in its scores: from there on, and the mean over the last quarter. None: of a
    tool path, while it cuts; static is then the mean magnitude.
    """
    deviation = path_deviation(result.actual, result.target, target.sample_velocity(result.time_ns))
    if scored_from is not None:
        scored = result.time >= scored_from - 1e-9
        scored[-1] = True
        return float(np.abs(deviation[scored]).max()), float(abs(deviation[-max(1, deviation.size // 4) :].mean()))
    cutting = result.volume > 0.0
    if not cutting.any():
        return math.nan, math.nan
    size = np.abs(deviation[cutting])
    return float(size.max()), float(size.mean())
