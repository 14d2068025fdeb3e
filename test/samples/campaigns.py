"""Measurements of a known arm, of known force coefficients and of known modes."""

import dataclasses
import math

import numpy as np

from kr270_milling.base.parameter_file import find_file
from kr270_milling.physics.cutting import LinearEdgeLaw, Tool
from kr270_milling.physics.cutting.laws import find_material
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.studies.identification.compliance import Measurements, Problem, fit_compliance
from kr270_milling.studies.identification.forces import CutMeasurements, agreeing_cuts, engagement_angles, fit_forces
from kr270_milling.studies.identification.modes import Mode, split_modes
from kr270_milling.studies.identification.plan import candidates
from kr270_milling.studies.identification.signals import Signals

ARM, MOUNT = read_arm(find_file("test_piece.yaml"))
#: an arm that differs from its file by 10 to 30 %
TRUE = ARM.replace(joint_compliance=ARM.joint_compliance * [1.2, 0.8, 1.1, 0.9, 1.3, 0.85])
SIGMA = 20e-6  #: [m] of a laser tracker


def displacements(arm, mount, tests: Measurements, gravity: bool = True) -> np.ndarray:
    """What an arm would show in these load tests [m, rad], (n, 6)."""
    return Problem(arm, mount, tests, gravity).predict(np.ones(6))


def loads(rng, n: int = 20, point=None) -> Measurements:
    """Random postures, pulls of about 500 N in random directions at the tool point; nothing is measured yet."""
    q = ARM.joint_lower + (ARM.joint_upper - ARM.joint_lower) * rng.uniform(0.2, 0.8, (n, 6))
    q[:, 1] = np.radians(rng.uniform(-120.0, -40.0, n))
    wrench = np.hstack([500.0 * rng.normal(size=(n, 3)), np.zeros((n, 3))])
    place = np.tile(MOUNT.xyz if point is None else point, (n, 1))
    return Measurements(q, wrench, place, place, np.full((n, 6), np.nan), np.full((n, 6), SIGMA), True)


def measured(tests: Measurements, arm=TRUE, rng=None, sigma: float = SIGMA, known: bool = True) -> Measurements:
    """Translations that ``arm`` shows in these tests, with noise if a generator is given."""
    moved = displacements(arm, MOUNT, tests)
    if rng is not None:
        moved = moved + sigma * rng.normal(size=moved.shape)
    moved[:, 3:] = np.nan
    scale = tests.sigma if known else np.ones_like(tests.sigma)
    return dataclasses.replace(tests, displacement=moved, sigma=scale, sigma_known=known)


def covered_compliances(seed: int, count: int, tests: int, robust: bool = False) -> np.ndarray:
    """Which intervals of ``count`` campaigns of random load tests cover the truth, (count, 6)."""
    rng, hits = np.random.default_rng(seed), []
    choice = candidates(ARM, MOUNT, 500, 1, MOUNT.xyz)
    for _ in range(count):
        some = choice.tests.take(rng.choice(len(choice.tests), tests, replace=False))
        fitted = fit_compliance(Problem(ARM, MOUNT, measured(some, rng=rng, sigma=some.sigma[0])), robust)
        hits.append(np.abs(fitted.values - TRUE.joint_compliance) <= fitted.half_widths)
    return np.array(hits)


# --- Cuts with known force coefficients ---
TOOL = Tool(diameter=0.02, teeth=4, spindle_speed=8000 * 2 * math.pi / 60)
COEFFICIENTS = np.array([767.01e6, 27.7e3, 168.8e6, 26.6e3, 222e6, 0.7e3])
FEEDS = (0.05e-3, 0.1e-3, 0.15e-3, 0.2e-3)


def cuts(mode="slot", width=0.02, feeds=FEEDS, tool=TOOL) -> CutMeasurements:
    """Nothing is measured yet; 1 mm deep."""
    n, (entry, leave) = len(feeds), engagement_angles(mode, width, tool.diameter)
    angles, nothing = (np.full(n, entry), np.full(n, leave)), np.full((n, 3), np.nan)
    return CutMeasurements(tool, np.array(feeds), np.full(n, 1e-3), *angles, nothing, np.ones(n), False)


def measured_cuts(some: CutMeasurements) -> CutMeasurements:
    return dataclasses.replace(some, force=LinearEdgeLaw(*map(float, COEFFICIENTS)).mean_forces(some))


def covered_forces(seed: int, count: int, robust: bool = False) -> np.ndarray:
    """Which intervals of ``count`` campaigns of 12 cuts with a noise of 2 N that is not stated cover the truth."""
    rng, tool = np.random.default_rng(seed), Tool(diameter=0.02, teeth=4, spindle_speed=800.0)
    true = find_material("Al7075-T6")[1].values
    ends = np.array([engagement_angles(mode, w, 0.02) for mode, w in [("slot", 0.02)] * 6 + [("up", 0.01)] * 6])
    feed, nothing = np.tile(np.linspace(0.05e-3, 0.2e-3, 6), 2), np.full((12, 3), np.nan)
    some = CutMeasurements(tool, feed, np.full(12, 1e-3), *ends.T, nothing, np.ones(12), False)
    force, hits = LinearEdgeLaw(*map(float, true)).mean_forces(some), []
    for _ in range(count):
        noisy = dataclasses.replace(some, force=force + 2.0 * rng.normal(size=(12, 3)))
        fitted = fit_forces("linear_edge", noisy.take(agreeing_cuts(noisy)) if robust else noisy)
        hits.append(np.abs(fitted.values - true) <= fitted.half_widths)
    return np.array(hits)


# --- Ring-downs of known modes ---
#: a milling robot as measured: 7.07 Hz (3.7 %), 10.3 Hz (2.2 %), 16.0 Hz (2.3 %) [shared facts of the project]
MODES = [(7.07, 0.037, [1.0, 0.2, 0.0]), (10.3, 0.022, [0.3, 1.0, 0.1]), (16.0, 0.023, [0.0, 0.4, 1.0])]


def ring_down(modes=MODES, noise=0.0, n=4000, step=5e-4, seed=2) -> Signals:
    """Closed form: sum of exp(-zeta omega t) cos(omega_d t + phase)."""
    t = np.arange(n) * step
    y = np.zeros((n, 3))
    for f, zeta, shape in modes:
        omega = 2 * np.pi * f
        y += np.outer(np.exp(-zeta * omega * t) * np.cos(omega * np.sqrt(1 - zeta**2) * t + 0.3), shape)
    return Signals(step, y + noise * np.random.default_rng(seed).normal(size=y.shape), ("x", "y", "z"))


def find_modes(signals: Signals, low: float, high: float) -> list[Mode]:
    """The modes without the faint ones."""
    return split_modes(signals, low, high)[0]
