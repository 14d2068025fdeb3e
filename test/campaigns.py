"""Load tests of a known arm."""

from __future__ import annotations

import dataclasses

import numpy as np

from kr270_milling.base.record import find_file
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.studies.identification.measurements import Measurements
from kr270_milling.studies.identification.problem import Problem

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
