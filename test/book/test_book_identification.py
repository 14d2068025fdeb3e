"""Checks of the identification: intervals that cover, plans that pay, and models found again in what they show."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from book import check

from kr270_milling.base.record import find_file
from kr270_milling.physics.cutting import LinearEdgeLaw, Tool
from kr270_milling.physics.cutting.materials import find_material
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.arm import GravityCompensator
from kr270_milling.studies.identification import forces
from kr270_milling.studies.identification.compliance import fit_compliance
from kr270_milling.studies.identification.cuts import CutMeasurements, engagement_angles
from kr270_milling.studies.identification.modes import find_modes
from kr270_milling.studies.identification.plan import Bench, Candidates, Planner, candidates, read_test_pose
from kr270_milling.studies.identification.problem import Problem
from kr270_milling.studies.identification.signals import Signals

FILE = find_file("test_piece.yaml")
ARM, MOUNT = read_arm(FILE)
TRUE = ARM.replace(joint_compliance=ARM.joint_compliance * [1.2, 0.8, 1.1, 0.9, 1.3, 0.85])
CAMPAIGNS = 400


def displacements(arm, mount, tests, gravity: bool = True) -> np.ndarray:
    """What an arm would show in these load tests [m, rad], (n, 6)."""
    return Problem(arm, mount, tests, gravity).predict(np.ones(6))


def _campaign(choice: Candidates, rows, rng) -> Problem:
    """These tests, measured on the true arm with the noise that they state."""
    tests = choice.tests.take(rows)
    moved = displacements(TRUE, MOUNT, tests) + tests.sigma * rng.normal(size=tests.sigma.shape)
    moved[:, 3:] = np.nan
    return Problem(ARM, MOUNT, dataclasses.replace(tests, displacement=moved))


@check(
    f"95 % intervals of compliances that cover the truth, {CAMPAIGNS} campaigns",
    "0.95; 12 random load tests each, 20 um of noise; 2 % are allowed, 2 standard deviations are 0.9 % [derived]",
)
def test_coverage():
    rng = np.random.default_rng(11)
    choice = candidates(ARM, MOUNT, Bench(MOUNT.xyz), 500, 1)
    hits = 0
    for _ in range(CAMPAIGNS):
        found = fit_compliance(_campaign(choice, rng.choice(len(choice.tests), 12, replace=False), rng))
        hits += np.sum(np.abs(found.values - TRUE.joint_compliance) <= found.half_widths)
    return 0.95, hits / (6 * CAMPAIGNS), 0.02


@check(
    "error at the test pose, planned campaign / random postures with the same loads",
    "at most 1/2: root mean square of 60 campaigns of 12 load tests each",
    at_most=True,
)
def test_plan():
    """The error is that of the displacement predicted for 100 N along each axis, against the true arm."""
    rng, pose = np.random.default_rng(12), read_test_pose(FILE, MOUNT)
    choice = candidates(ARM, MOUNT, Bench(MOUNT.xyz), 1000, 2)
    planned = Planner(ARM, MOUNT, choice, pose).best(12).rows
    kinds = [np.flatnonzero(choice.kind == kind) for kind in choice.kind[planned]]
    true = displacements(TRUE, MOUNT, pose)[:, :3]

    def error(rows) -> float:
        found = fit_compliance(_campaign(choice, rows, rng))
        return float(np.sum((displacements(found.problem.arm_at(found.factors), MOUNT, pose)[:, :3] - true) ** 2))

    ours = np.mean([error(planned) for _ in range(60)])
    blind = np.mean([error(np.array([rng.choice(rows) for rows in kinds])) for _ in range(60)])
    return 0.5, math.sqrt(ours / blind), 0.0


@check(
    "gravity compensator: its share of the spring of joint 2, upper arm at -50 deg",
    "k a L ((s_0 / s) (a L sin^2 / s^2 - cos) + cos) of [Klimchik2013b], by the angle at axis 2 [derived]",
    "N m/rad",
)
def test_compensator():
    spring = GravityCompensator(stiffness=150e3, preload=15e3, base_x=-0.69, base_z=0.12, arm_length=0.18)
    q2, a = math.radians(-50.0), math.hypot(0.69, 0.12)
    angle = math.atan2(-math.sin(q2), math.cos(q2)) - math.atan2(0.12, -0.69)
    product, cosine = a * 0.18, math.cos(angle)
    s = math.sqrt(a**2 + 0.18**2 - 2 * product * cosine)
    upright = math.sqrt(a**2 + 0.18**2 - 2 * product * math.cos(math.pi / 2 - math.atan2(0.12, -0.69)))
    free = upright - 15e3 / 150e3
    expected = 150e3 * product * (free / s * (product * math.sin(angle) ** 2 / s**2 - cosine) + cosine)
    return expected, -float(spring.moment_slope(math.cos(q2), math.sin(q2))), 1e-6


@check(
    f"95 % intervals of force coefficients that cover the truth, {CAMPAIGNS} campaigns",
    "0.95; slots and half immersion at six feeds, Al7075-T6, noise of 2 N that is not stated (Student's interval)",
)
def test_force_coverage():
    rng, tool = np.random.default_rng(13), Tool(diameter=0.02, teeth=4, spindle_speed=800.0)
    true = find_material("Al7075-T6")[1].values
    ends = np.array([engagement_angles(mode, w, 0.02) for mode, w in [("slot", 0.02)] * 6 + [("up", 0.01)] * 6])
    feed, nothing = np.tile(np.linspace(0.05e-3, 0.2e-3, 6), 2), np.full((12, 3), np.nan)
    cuts = CutMeasurements(tool, feed, np.full(12, 1e-3), *ends.T, nothing, np.ones(12), False)
    force, hits = LinearEdgeLaw(*map(float, true)).mean_forces(cuts), 0
    for _ in range(CAMPAIGNS):
        found = forces.fit_forces(
            "linear_edge", dataclasses.replace(cuts, force=force + 2.0 * rng.normal(size=(12, 3)))
        )
        hits += np.sum(np.abs(found.values - true) <= found.half_widths)
    return 0.95, hits / (6 * CAMPAIGNS), 0.02


@check(
    "damping ratio of a mode at {frequency} Hz between two others, ring-down with 1 % of noise",
    "a milling robot as measured: 7.07 Hz (3.7 %), 10.3 Hz (2.2 %), 16.0 Hz (2.3 %); closed form",
    cases=("frequency index", [(7.07, 0), (10.3, 1), (16.0, 2)]),
)
def test_damping(frequency, index):
    t = 5e-4 * np.arange(4000)
    ratios, rings = (0.037, 0.022, 0.023), []
    for f, zeta, phase in zip((7.07, 10.3, 16.0), ratios, (0.1, 0.7, 1.3), strict=True):
        omega = 2 * math.pi * f
        rings.append(np.exp(-zeta * omega * t) * np.cos(math.sqrt(1 - zeta**2) * omega * t + phase))
    values = np.array(rings).T @ np.array([[1.0, 0.2], [0.3, 1.0], [0.1, 0.5]])
    values += 0.01 * np.random.default_rng(14).normal(size=values.shape)
    found = find_modes(Signals(5e-4, values, ("x", "y")), 2.0, 50.0)
    return ratios[index], found[index].damping_ratio, 0.02 * ratios[index]
