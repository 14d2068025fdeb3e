"""Checks of the compensation: the static mirror (30)-(32), the revision of the trajectory at the controller step."""

from __future__ import annotations

import functools

import numpy as np
from book import check
from posture import PAPER, SPINDLE, arm_of
from scipy.signal import lsim
from splines import spline

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.lifted import KnotConditions, Lifted
from kr270_milling.physics.compensation.methods import METHODS
from kr270_milling.physics.compensation.mirror import mirror
from kr270_milling.physics.compensation.response import ArmResponse, Segments, cubic_coefficients
from kr270_milling.physics.compensation.revision import PassRecord, corrected, sampled_correction
from kr270_milling.physics.robot import equilibrium, pose

WRENCH = np.array([800.0, -600.0, 400.0, 60.0, -90.0, 40.0])  # [N, N m]
ALPHA = 0.9


@functools.cache
def _mirrored():
    target = pose(arm_of(), SPINDLE, PAPER[None])
    return target, mirror(arm_of(), SPINDLE, target, WRENCH, PAPER, relaxation=ALPHA, sag_compensated=False)


@check("mirror (31): loaded tool where the target is", "(31) solved: the target; 1 kN, moments, link weights", "m")
def test_mirror_target():
    target, found = _mirrored()
    loaded = equilibrium(arm_of(), SPINDLE, found.joints, WRENCH).pose
    return 0.0, np.abs(loaded.position - target.position).max(), 1e-9


@check("mirror (32): error of an iteration / of the one before", "1 - alpha for a nearly linear arm, alpha = 0.9")
def test_mirror_rate():
    history = np.array(_mirrored()[1].history)
    return 1 - ALPHA, float(np.exp(np.diff(np.log(history))[1:].mean())), 0.01


@check(
    "order of the interpolation, {method}", "interpolation theory: 2 for straight lines, 4 for a cubic C2 spline",
    cases=("method expected", [("linear", 2.0), ("spline", 4.0)]),
)  # fmt: skip
def test_interpolation_order(method, expected):
    """Remaining error of a revised reference for a displacement that is a sine of time."""
    steps, errors = [20, 40, 80, 160], []
    time = np.arange(0, 1_200_000_001, 100_000)
    wave = 50e-6 * np.sin(2 * np.pi * 1.7 * time * 1e-9)
    for n in steps:
        knots = np.round(np.linspace(0, 1.2e9, n + 1)).astype(np.int64)
        target = Trajectory(knots, np.outer(knots * 1e-9, [0.07, 0.0, 0.0]), np.array([1.0, 0, 0, 0]))
        ran = target.sample(time) + np.outer(wave, [0.0, 1.0, 0.0])
        offset = sampled_correction(target, target, PassRecord(time, ran))
        revised, _ = corrected(target, offset, METHODS[method].smooth)
        inner = slice(len(time) // 4, -len(time) // 4)  # a natural spline is of lower order at its ends
        errors.append(np.abs(revised.sample(time)[inner, 1] + wave[inner]).max())
    return expected, -np.polyfit(np.log(steps), np.log(errors), 1)[0], 0.2


@check(
    "order in the controller step of the pass compensated by lines", "2: interpolation; the teeth's ripple taken off"
)
def test_controller_order():
    """What a spline at the shortest step leaves is the vibration at tooth passing, which no reference can follow."""
    steps, errors = np.array([50.0, 25.0, 12.5]), []
    for step in steps:
        cell = read_cell(find_file("paper.yaml"), (f"timing.controller_step_ms={step}",))
        original = simulate(cell)
        errors.append(compensated(cell, original, "linear").scores.max_deviation)
    ripple = compensated(cell, original, "spline").scores.max_deviation
    return 2.0, np.polyfit(np.log(steps), np.log(np.array(errors) - ripple), 1)[0], 0.4


OMEGA, ZETA = 2 * np.pi * 6.69, 0.04


def _one_mode(segments: int) -> ArmResponse:
    """A mode across the feed alone."""
    axis, tile = np.array([0.0, 1.0, 0.0]), np.ones((segments, 1, 1))
    modal = np.full((segments, 1), OMEGA), np.full((segments, 1), ZETA)
    push = tile * np.append(axis, np.zeros(3))
    return ArmResponse(*modal, tile * axis, tile * axis[:, None], push, tile.copy())


@check(
    "lifted model: tool along a corrected reference, zeta 0.04",
    "scipy.signal.lsim of (2 z w s + w^2) / (s^2 + 2 z w s + w^2)",
    "m",
)
def test_lifted_response():
    """A spline correction of 50 um, knots every 50 ms; largest difference."""
    knots = np.arange(25) * 50_000_000
    smooth = spline(knots, np.random.default_rng(1).normal(0, 50e-6, (25, 3)))
    segments, time = Segments.of(knots), np.arange(0, knots[-1] + 1, 50_000)
    shift = smooth.sample(time)[:, 1]
    top, bottom = [2 * ZETA * OMEGA, OMEGA**2], [1.0, 2 * ZETA * OMEGA, OMEGA**2]
    moved = lsim((top, bottom), shift - shift[0], time * 1e-9)[1] + shift[0]
    found = _one_mode(24).follow(segments, cubic_coefficients(knots, smooth.position, smooth.velocity))[..., 1]
    return 0.0, np.abs(found.ravel() - np.interp(segments.middle_ns.ravel(), time, moved)).max(), 2e-9


@check(
    "lifted model: deviation left of one that knots can make",
    "least squares reach 0, however slowly the arm rings",
    "m",
)
def test_lifted_inverse():
    """The deviation is the response of the arm to a spline on the same knots."""
    knots = np.arange(25) * 50_000_000
    smooth = spline(knots, np.random.default_rng(1).normal(0, 50e-6, (25, 3)))
    segments, arm = Segments.of(knots), _one_mode(24)
    deviation = arm.follow(segments, cubic_coefficients(knots, smooth.position, smooth.velocity))
    conditions = KnotConditions(True, np.zeros(25, bool), np.zeros(24, bool))
    weight = np.broadcast_to(np.eye(3), (24, segments.parts, 3, 3))
    return 0.0, np.abs(Lifted(arm, segments, conditions).least_squares(deviation, weight, 1e-12).left).max(), 1e-9


@check(
    "pass with reference inertia, zeta 0.04, linear / none",
    "97 um / 79 um; here the sampled displacement is a mean over a revolution",
)
def test_linear_excites_the_arm():
    """The paper's method makes the part worse."""
    cell = read_cell(find_file("paper.yaml"), ("dynamics.reference_inertia=true", "dynamics.damping_ratio=0.04"))
    original = simulate(cell)
    linear = compensated(cell, original, "linear")
    return 97.0 / 79.2, linear.scores.max_deviation / original.scores.max_deviation, 0.1
