"""Which uncertainty limits the part, and which measurement would take it away.

One unknown at a time is drawn, all others are known, and the robot runs the corrected program. D_k is the deviation
that makes walls and floors while the tool cuts. The share of unknown k in the band is

    s_k = var D_k / sum_j var D_j   first-order shares of independent unknowns [Sobol1993]

The mean of D_k is no spread: ``robust`` plans for it, and an identified unknown has a narrow range and no share.

A robot whose unknown k is measured keeps the share 1 - s_k of the square of its error.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from kr270_milling.base.column import column
from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import at_once
from kr270_milling.cell.models import path_of
from kr270_milling.cell.plant import Plant, coarser, numbers_of, robot_of
from kr270_milling.decide.part.surface import SLOPE
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.imperfections import Imperfections
from kr270_milling.physics.motion.milling_pass import PassResult

SEED = 1_000_001  #: of these robots, beyond the seeds of verdicts and of ``robust``
SHOWN = 3  #: unknowns in a line
#: name of each unknown: its keys of ``uncertainty``, and the measurement with its instrument and minutes (assumed)
UNKNOWNS: dict[str, tuple[tuple[str, ...], str]] = {
    "servo lag": (("servo_frequency", "servo_delay"), "a test move with a tracker (identify servo), 20 min"),
    "base": (("base_compliance",), "3 load tests with a dial gauge (identify compliance --base), 30 min"),
    "backlash": (
        ("backlash", "least_backlash"),
        "push and pull at the tool with a dial gauge (identify backlash), 30 min",
    ),
    "joint compliance": (("joint_compliance", "joint_compliances"), "12 load tests with a tracker, 90 min"),
    "force coefficients": (("force_coefficient", "force_coefficients"), "5 slots with a force sensor, 60 min"),
    "end edges": (("end_share",), "a plunge with a force sensor, 15 min"),
    "tool wear": (("tool_wear",), "a fresh tool, 5 min"),
    "tool": (("tool_stick_out", "tool_compliance"), "a load at the tool with a dial gauge, 15 min"),
    "frequency": (("frequency",), "a hammer test with an accelerometer, 30 min"),
    "damping": (("damping_ratio",), "a hammer test with an accelerometer, 30 min"),
    "joining": (("joining",), "a test move with a tracker, 20 min"),
    "place of the part": (("placement",), "touching off again with a probe, 10 min"),
}


@dataclass(frozen=True)
class Limit:
    """One unknown."""

    name: str = column("unknown")
    share: float = column("share")  #: of the band
    measurement: str = column("measurement")

    def within(self, shares: np.ndarray) -> int:
        """Robots within tolerance if this is measured; shares: errors of the robots as shares of the tolerance."""
        return int(np.sum(shares * np.sqrt(1.0 - self.share) <= 1.0))


def limits(cell: Cell, reference: Trajectory, count: int) -> tuple[Limit, ...]:
    """The unknowns of a cell along the reference of a program, the largest share first.

    count: robots for each unknown, at least two.
    """
    model, assumed = coarser(cell), cell.uncertainty
    if assumed.learned.size:  # a measured part ties the unknowns to each other
        return ()
    ran = Plant(model, model, Imperfections()).run(reference)
    scored = _across(model, ran), np.any(ran.wrench != 0.0, axis=1)
    values = {key: getattr(assumed, key) for keys, _ in UNKNOWNS.values() for key in keys}
    nothing = {key: np.array([]) if isinstance(value, np.ndarray) else 0.0 for key, value in values.items()}
    known = assumed.replace(repeatability=0.0, **nothing)
    drawn = []
    for name, (keys, _) in UNKNOWNS.items():
        left = {key: values[key] for key in keys}
        if any(np.any(value) for value in left.values()):
            other = model.replace(uncertainty=known.replace(**left))
            drawn += [(name, robot_of(other, row)) for row in _hypercube(count, numbers_of(other))]
    with ThreadPoolExecutor(at_once(path_of(model))) as pool:
        ran_rows = list(pool.map(lambda one: _deviation(model, one[1], reference, scored), drawn))
    size = {}
    for name in dict.fromkeys(name for name, _ in drawn):
        some = [row for (other, _), row in zip(drawn, ran_rows, strict=True) if other == name and row is not None]
        size[name] = float(np.mean(np.var(some, axis=0))) if len(some) > 1 else 0.0
    total = sum(size.values())
    rows = (Limit(name, value / total, UNKNOWNS[name][1]) for name, value in size.items() if total > 0.0)
    return tuple(sorted(rows, key=lambda row: -row.share))


def _hypercube(count: int, numbers: int) -> np.ndarray:
    """Numbers behind robots that cover each number evenly, (count, numbers): a Latin hypercube [McKay1979].

    Each number takes the middles of equally probable ranges, scaled to a variance of 1, in a random order that is
    hardly correlated with those of the six numbers before it: the numbers of an unknown are neighbours. So few robots
    know a variance that as many drawn ones know to a half.
    """
    rng, levels = np.random.default_rng(SEED), ndtri((np.arange(count) + 0.5) / count)
    columns, orders, near = [levels / levels.std()], 100, 6
    while len(columns) < numbers:
        tried = rng.permuted(np.tile(columns[0], (orders, 1)), axis=1)
        columns.append(tried[np.argmin(np.square(tried @ np.transpose(columns[-near:])).sum(axis=1))])
    return np.column_stack(columns)


def _across(model: Cell, ran: PassResult) -> np.ndarray:
    """Weights (n, 2, 3) of the deviation that makes walls and floors, at the samples of a pass."""
    feed = path_of(model).target.sample_velocity(ran.time_ns)
    level = np.abs(feed[:, 2]) <= SLOPE * np.linalg.norm(feed, axis=1)
    weights = np.zeros((len(feed), 2, 3))
    weights[:, 0, :2] = np.column_stack([-feed[:, 1], feed[:, 0]])
    weights[:, 0] /= np.maximum(np.linalg.norm(feed[:, :2], axis=1), 1e-300)[:, None]
    weights[:, 1, 2] = level
    return weights


def _deviation(model: Cell, robot: Cell, reference: Trajectory, scored: tuple[np.ndarray, np.ndarray]):
    """Deviation [m] that makes walls and floors where the tool cuts, (k, 2); None where the robot fails.

    scored: weights of ``_across`` and the samples that cut, of the pass of the model.
    """
    weights, cutting = scored
    try:
        actual = Plant(model, robot).run(reference).actual
    except MillingError:
        return None
    return np.einsum("nij,nj->ni", weights[cutting], actual[cutting])


def limit_line(rows: tuple[Limit, ...]) -> str:
    """One line: the unknowns with the largest shares."""
    return "limits: " + ", ".join(f"{row.name} ({100 * row.share:.0f} %)" for row in rows[:SHOWN])


def measurements(rows: tuple[Limit, ...], shares: np.ndarray | None) -> list[str]:
    """Lines: what to measure, and how many more of the robots would meet the tolerance then; the best first.

    shares: errors of the simulated robots as shares of the tolerance, (n,); None: no tolerance is given.
    """
    if shares is None:
        return [f"measure: {row.name}, {row.measurement}" for row in rows[:SHOWN]]
    now = int(np.sum(shares <= 1.0))
    best = sorted(rows[:SHOWN], key=lambda row: -row.within(shares))
    return [
        f"measure: {row.name}, {row.measurement}: from {now} to about {row.within(shares)} of {shares.size} robots"
        for row in best
        if row.within(shares) > now
    ] or ["no measurement of one unknown alone brings more robots within the tolerance"]
