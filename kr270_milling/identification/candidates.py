"""Load tests that could be made: postures that the arm can take beside its load, and loads that a workshop has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from kr270_milling.base.errors import MillingError, ParameterError
from kr270_milling.identification.measurements import Measurements
from kr270_milling.robot.arm import Arm, Mount
from kr270_milling.robot.kinematics import forward, singularity_measures
from kr270_milling.robot.loads import GRAVITY

__all__ = ["Bench", "Candidates", "candidates"]

MARGIN = np.radians(5.0)  #: kept to every joint limit
MOST_TURN = np.radians(180.0)  #: of axes 4 and 6, for the cables
LEAST_MEASURE = 0.1  #: of the singularities of elbow and wrist: nobody drives through them to measure
LOADS = ("hang", "pull outward", "pull sideways", "pull between both")


class NoPostureError(MillingError):
    """No posture has room for a load test."""

    def __init__(self):
        super().__init__("no posture of this arm keeps its tool above the floor and away from its base")


@dataclass(frozen=True, eq=False)
class Bench:
    """What there is to load and to see the arm with."""

    point: np.ndarray  #: flange frame [m], (3,): where the loads act and the reflector sits
    mass: float = 100.0  #: [kg] hung from it
    pull: float = 800.0  #: [N] of a rope with a load cell, horizontal; the vertical axis cannot be turned by a mass
    sigma: float = 20e-6  #: [m] of each measured coordinate
    lowest: float = 0.3  #: [m] over the base, of tool and wrist
    highest: float = 2.2  #: [m], of the tool, where a mass can still be hung
    nearest: float = 0.9  #: [m] from axis 1


@dataclass(frozen=True, eq=False)
class Candidates:
    """m load tests; nothing is measured yet."""

    tests: Measurements
    kind: np.ndarray  #: number in LOADS, (m,)

    def take(self, rows) -> Candidates:
        return Candidates(self.tests.take(rows), self.kind[rows])


def candidates(arm: Arm, mount: Mount, bench: Bench, postures: int, seed: int) -> Candidates:
    """Every load in up to ``postures`` postures spread evenly over those that there is room for (Sobol')."""
    q = _postures(arm, mount, bench, postures, seed)
    force = _forces(q[:, 0], bench)
    kinds = force.shape[1]
    q = np.repeat(q, kinds, axis=0)
    wrench = np.hstack([force.reshape(-1, 3), np.zeros((len(q), 3))])
    place = np.tile(bench.point, (len(q), 1))
    nothing = np.full((len(q), 6), np.nan)
    tests = Measurements(q, wrench, place, place, nothing, np.full((len(q), 6), bench.sigma), True)
    return Candidates(tests, np.tile(np.flatnonzero([bench.mass > 0, *[bench.pull > 0] * 3]), len(q) // kinds))


def _postures(arm: Arm, mount: Mount, bench: Bench, count: int, seed: int) -> np.ndarray:
    """(k, 6) [rad], k up to ``count``."""
    low, high = arm.joint_lower + MARGIN, arm.joint_upper - MARGIN
    low[[3, 5]], high[[3, 5]] = np.maximum(low[[3, 5]], -MOST_TURN), np.minimum(high[[3, 5]], MOST_TURN)
    drawn = qmc.Sobol(6, seed=seed).random_base2(int(np.ceil(np.log2(16 * count))))
    q = low + (high - low) * drawn
    frames = forward(arm, mount, q)
    point = frames.flange.apply(bench.point)
    lowest = np.minimum(point[:, 2], frames.nodes[:, 2:, 2].min(1))
    fits = (lowest > bench.lowest) & (point[:, 2] < bench.highest)
    fits &= np.hypot(point[:, 0], point[:, 1]) > bench.nearest
    fits &= np.hypot(*np.moveaxis(frames.nodes[:, 4, :2], -1, 0)) > bench.nearest
    fits &= (singularity_measures(arm, q)[:, 1:] > LEAST_MEASURE).all(1)
    if not fits.any():
        raise NoPostureError
    return q[fits][:count]


def _forces(a1: np.ndarray, bench: Bench) -> np.ndarray:
    """(k, loads, 3) [N]: what hangs, and pulls outward from axis 1, to its side, and between both."""
    outward = np.stack([np.cos(a1), -np.sin(a1), np.zeros_like(a1)], -1)
    sideways = np.stack([np.sin(a1), np.cos(a1), np.zeros_like(a1)], -1)
    loads: list[np.ndarray] = []
    if not (bench.mass > 0.0 or bench.pull > 0.0):
        raise ParameterError("mass_kg and pull_n", [bench.mass, bench.pull], "above 0, one of them at least")
    if bench.mass > 0.0:
        loads.append(np.tile([0.0, 0.0, -GRAVITY * bench.mass], (len(a1), 1)))
    if bench.pull > 0.0:
        loads += [bench.pull * outward, bench.pull * sideways, bench.pull * (outward + sideways) / np.sqrt(2.0)]
    return np.stack(loads, 1)
