"""Learn from measured parts which robot cut them: a Gaussian update of the numbers behind a simulated robot.

A robot of a cell has n numbers z (``cell.plant.robot_of``), with the distribution N(m, P) before the part is measured:
m = 0 and P = I, or what earlier parts left. f(z) are its errors at the measured places, by a full pass; e are the
measured errors, with the covariance R of measurement, repeatability and model.

1. Robots are drawn from N(m, P), and their errors f are explained by a linear map [GarciaFernandez2015]:

    f = b + J (z - m) + r,   J by least squares with ridge, W = cov(r)

2. The numbers follow by a linear update, in which W is an error of the model. Backlash, which makes f jump, and
   vibration behind corners are in W: the places show no lag and no compliance that a robot beside it would not show.

    z' = m + K (e - b),   P' = P - K J P,   K = P J^T (J P J^T + R + W)^-1

3. Robots are drawn again, from N(z', P'), with J of the first round as their expectation; the update starts at N(m, P).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.column import column, counted
from kr270_milling.base.errors import InputError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.plant import coarser, numbers_of, perturbed, robot_of
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.studies.identification.wall import PredictedPlaces, WallPlaces, read_wall, robot_errors

FEWEST, MOST = 6, 200  #: places of a part
SIGMA = 5e-6  #: [m], assumed: of a measured error without sigma_um, a CMM or a dial gauge on the part
#: [m], and share of the errors that the robots of the cell have, assumed: what none of them explains. It has their
#: covariance, so that many places do not show it away
MODEL_ERROR, MODEL_SHARE = 5e-6, 0.1
BESIDE, ALIKE = 2, 0.5  #: neighbours of the same surface; share of its deviation with which one supports a place
#: other meanings of the numbers of a table, and their factors to um
READINGS = {
    "has the opposite sign, so that positive is too much removed": -1.0,
    "is in mm": 1e3,
    "is in nm": 1e-3,
    "is in inches": 25.4e3,
    "is in thousandths of an inch": 25.4,
}
RANGE = (-3.0, 3.0)  #: range of the numbers behind a robot, which has 99.7 % of them
#: robots of each round, and the weight of what is expected of the slopes, in robots: at first that there are none
ROUNDS = ((64, 1.0), (48, 20.0))
SAMPLES, SAMPLE_SEED = 200, 1_000_002  #: robots that show an unknown before and after; no seed of a verdict


@dataclass(frozen=True, eq=False)
class Learned:
    """The cell after the measured parts, and what they show."""

    cell: Cell = column("")
    rows: tuple[dict, ...] = column("learned")  #: name, unit, mean and deviation before and after
    left_out: tuple[str, ...] = column("left_out")  #: sentences on places that contradict the others
    residual: float = column("residual_um", 1e6)  #: root mean square of measured minus explained errors [m]
    #: root mean square of the stated errors of measurement and model [m]
    expected: float = column("expected_um", 1e6)

    @property
    def identified(self) -> list[dict]:
        """Rows of the unknowns that the places show, the best first."""
        # deviation of an unknown after and before, above which the places do not show it
        rows = [row for row in self.rows if row["sigma"] < 0.8 * row["sigma_before"]]
        return sorted(rows, key=lambda row: row["sigma"] / row["sigma_before"])

    def lines(self) -> list[str]:
        """Lines for the terminal and the manifest."""
        shown = self.identified
        rest = [row["name"] for row in self.rows if row["sigma_before"] > 0.0 and row not in shown]
        line = "learned: {name}: {mean_before:.3g} +- {sigma_before:.2g} -> {mean:.3g} +- {sigma:.2g}{unit}"
        lines = [line.format(**row) for row in shown]
        if rest:
            lines.append(f"not shown by these places: {', '.join(rest)}")
        fit = f"{1e6 * self.residual:.1f} um are left (measurement and model: {1e6 * self.expected:.1f} um)"
        return [*lines, f"measured places: {fit}", *self.left_out]


def read_part(path) -> WallPlaces:
    """Read the places of a measured part; raises InputError."""
    places = read_wall(path)
    if not FEWEST <= len(places.error) <= MOST:
        raise InputError(
            path, f"has {counted(len(places.error), 'place')}, but a measured part needs {FEWEST} to {MOST}"
        )
    return places


def learn(
    cell: Cell,
    parts: Sequence[tuple[WallPlaces, Trajectory | None, str]],
    progress: Callable[[int, int], None] = lambda *_: None,
) -> Learned:
    """Learn from parts: their places, the reference that was run (None: as programmed), and a text on the source.

    Raises InputError where a table contradicts the program or itself.
    """
    model, assumed = coarser(cell), cell.uncertainty
    places = [PredictedPlaces(model, measured) for measured, *_ in parts]
    measured = np.concatenate([part.error for part, *_ in parts])
    count = numbers_of(model)
    mean, spread = _state(cell, count)
    total, passes_run = sum(robots for robots, _ in ROUNDS), 0
    same: dict[Cell, np.ndarray] = {}  # errors of robots that cut alike

    def run(numbers: np.ndarray) -> np.ndarray:
        """Errors (k, places) of robots behind numbers (k, n)."""
        nonlocal passes_run
        robots = [robot_of(model, row) for row in numbers]
        robots = [
            robot.replace(imperfections=robot.imperfections.replace(repeatability=0.0, pose_noise=0.0))
            for robot in robots
        ]
        new = list(dict.fromkeys(robot for robot in robots if robot not in same))
        runs = [(reference, at) for (_, reference, _), at in zip(parts, places, strict=True)]
        for robot, row in zip(new, robot_errors(new, model, runs), strict=True):
            same[robot] = row
            progress(passes_run := min(passes_run + 1, total), total)
        return np.array([same[robot] for robot in robots])

    rng = np.random.default_rng(SAMPLE_SEED)
    size, axes = np.linalg.eigh(spread)
    root = axes * np.sqrt(np.maximum(size, 0.0))  # z = mean + root u, u of a standard normal distribution
    u, left, slopes = np.zeros(count), np.eye(count), np.zeros((measured.size, count))
    for robots, weight in ROUNDS:
        size, axes = np.linalg.eigh(left)
        drawn = u + (rng.standard_normal((robots, count)) * np.sqrt(np.maximum(size, 0.0))) @ axes.T
        rows = run(np.clip(mean + drawn @ root.T, *RANGE))
        lived = np.isfinite(rows).all(axis=1)
        if lived.sum() < robots // 2:
            raise InputError(parts[0][0].path, "most robots of the cell do not survive the reference that was run")
        drawn, rows = drawn[lived], rows[lived]
        if not slopes.any():
            noise = _noise(cell, parts, places, rows)
            refuse_contradictions(parts, measured, rows, noise)
        offset, slopes, jumps = linear_map(drawn, rows, slopes, weight)
        agreeing, left_out = strange_places(parts, measured - offset, slopes @ slopes.T + noise + jumps)
        part = np.ix_(agreeing, agreeing)
        some, rest, error = slopes[agreeing], (measured - offset)[agreeing], (noise + jumps)[part]
        shares = np.linalg.solve(some @ some.T + error, np.column_stack([rest, error]))  # of the rest and of its errors
        grown = shares[:, 0] @ error @ shares[:, 0] / np.trace(shares[:, 1:])  # larger than stated [Birge1932]
        u, left = gaussian_update(np.zeros(count), np.eye(count), some, rest, max(1.0, float(grown)) * error)
    z, left = np.clip(mean + root @ u, *RANGE), root @ left @ root.T
    sources = (*assumed.learned_from, *(source for *_, source in parts))
    after = cell.replace(
        uncertainty=assumed.replace(learned_from=sources, learned=z, learned_directions=_directions(left).ravel())
    )
    progress(total, total)
    return Learned(
        after,
        _compared(cell, after),
        left_out,
        float(np.sqrt(np.mean((rest - some @ u) ** 2))),
        float(np.sqrt(np.mean(np.diag(error)))),
    )


def linear_map(
    drawn: np.ndarray, rows: np.ndarray, expected: np.ndarray, weight: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offset (k,), slopes (k, n) of errors by numbers, and the covariance (k, k) of what they leave.

    drawn (N, n): numbers of robots; rows (N, k): their errors; expected (k, n): slopes that count as much as ``weight``
    robots with a deviation of 1. The change of the slopes by number j shrinks by max(0, 1 - 1 / q_j), q_j the mean
    square of the changes in their standard deviations [James1961]: few robots give every number some slope by chance,
    and a place would show lag and damping that it does not show.
    """
    ones = np.ones((len(drawn), 1))
    known = np.hstack([ones, drawn])
    inverse = np.linalg.inv(known.T @ known + weight * np.diag([0.0, *np.ones(drawn.shape[1])]))
    rest = rows - drawn @ expected.T
    change = inverse @ (known.T @ rest)
    used = float(np.trace(inverse @ (known.T @ known)))  # degrees of freedom
    freedom = max(1.0, len(drawn) - used)
    left = rest - known @ change
    chance = np.outer(np.diag(inverse)[1:], np.mean(left**2, axis=0) * len(left) / freedom)
    share = np.maximum(
        0.0, 1.0 - 1.0 / np.maximum(np.mean(change[1:] ** 2 / np.maximum(chance, 1e-300), axis=1), 1e-300)
    )
    change[1:] *= share[:, None]
    left = rest - known @ change
    return change[0], expected + change[1:].T, left.T @ left / freedom


def gaussian_update(
    mean: np.ndarray, spread: np.ndarray, slopes: np.ndarray, rest: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n,) and covariance (n, n) after measured errors; rest (k,): measured minus predicted at the mean.

    m' = m + K r,   P' = P - K J P,   K = P J^T (J P J^T + R)^-1
    """
    across = slopes @ spread
    gain = np.linalg.solve(across @ slopes.T + noise, across).T
    after = spread - gain @ across
    return mean + gain @ rest, 0.5 * (after + after.T)


def _state(cell: Cell, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n,) and covariance (n, n) of the numbers behind a robot of the cell."""
    assumed = cell.uncertainty
    if not assumed.learned.size:
        return np.zeros(count), np.eye(count)
    robot_of(cell, assumed.learned)  # refuses numbers of another cell
    directions = assumed.learned_directions.reshape(-1, count)
    return np.array(assumed.learned), np.eye(count) - directions.T @ directions


def _directions(spread: np.ndarray) -> np.ndarray:
    """D (k, n) of the covariance I - D^T D."""
    size, axes = np.linalg.eigh(np.eye(len(spread)) - spread)
    least_share = 0.01  # share of a variance; directions that lose less are not stored
    some = size > least_share
    return (axes[:, some] * np.sqrt(np.minimum(size[some], 1.0 - 1e-9))).T


def _noise(cell: Cell, parts, places: Sequence[PredictedPlaces], predicted: np.ndarray) -> np.ndarray:
    """Covariance of measured minus predicted errors [m^2], (k, k).

    The shift of a pass: a third of the square of the largest repeatability, over that of one deviation of ISO 9283.
    """
    iso = np.sqrt(8.0 / np.pi) + 3.0 * np.sqrt(3.0 - 8.0 / np.pi)  # as in ``Imperfections.shift``
    shift = cell.uncertainty.repeatability**2 / 3.0 / iso**2
    sigma = np.concatenate([np.where(part.sigma > 0.0, part.sigma, SIGMA) for part, *_ in parts])
    noise = np.diag(sigma**2 + MODEL_ERROR**2) + MODEL_SHARE**2 * predicted.T @ predicted / len(predicted)
    first = 0
    for place in places:
        part = slice(first, first := first + len(place.normal))
        noise[part, part] += shift * place.normal @ place.normal.T
    return noise


def refuse_contradictions(parts, measured: np.ndarray, rows: np.ndarray, noise: np.ndarray) -> None:
    """Raise InputError where another sign or unit explains a table far better than its own numbers.

    rows (N, k): errors of drawn robots [m], noise (k, k): covariance of measured minus predicted errors. The density of
    a table is that of Student's t with 4 degrees of freedom: robots have jumps, so few of them are far from the others.
    """
    middle, covariance, first = rows.mean(axis=0), np.cov(rows.T) + noise, 0
    freedom = 4.0  # assumed
    sure_enough = 10.0  # logarithm of the likelihood ratio with which another reading of a table is its meaning
    for part, *_ in parts:
        here = slice(first, first := first + len(part.error))
        e, f, root = measured[here], middle[here], np.linalg.cholesky(covariance[here, here])

        readings = [(f"error_um {text}", factor * np.ones(e.size), None) for text, factor in READINGS.items()]
        for name, side in _sides(part):
            text = f"the errors {name} have the opposite sign: is the wall measured from its other side?"
            readings.append((text, np.where(side, -1.0, 1.0), part.lines[int(np.argmax(side))]))
        tried = np.ones(e.size), *(factors for _, factors, _ in readings)
        left = [np.linalg.solve(root, factors * e - f) for factors in tried]  # in standard deviations
        square = np.array([rest @ rest for rest in left])
        scale = np.array([0.0, *(np.sum(np.log(np.abs(factors))) for _, factors, _ in readings)])
        density = scale - 0.5 * (freedom + e.size) * np.log1p(square / freedom)
        better = [k for k in range(len(readings)) if density[k + 1] > density[0] + sure_enough]
        if better:
            text, _, line = readings[max(better, key=lambda k: (scale - 0.5 * square)[k + 1])]  # normal: without tails
            raise InputError(part.path, f"no robot of the cell leaves these errors; they fit if {text}", line)


def _sides(part: WallPlaces):
    """Yield names and places (k,) bool of the sides of a part, about the middle of its places."""
    middle = 0.5 * (part.place.min(axis=0) + part.place.max(axis=0))
    reach = np.maximum(np.ptp(part.place, axis=0), 1e-9)
    for axis, letter in enumerate("xy"):
        for sign, word in ((1.0, "largest"), (-1.0, "least")):
            side = ~part.floor & (sign * (part.place[:, axis] - middle[axis]) > 0.45 * reach[axis])
            if 1 < side.sum() < len(side):
                yield f"at the {word} {letter}_mm", side
    if 1 < part.floor.sum() < len(part.floor):
        yield "of the floor", part.floor


def strange_places(parts, rest: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return the places that agree with the others, (k,) bool, and a sentence on each of the rest.

    r_B = (S^-1)_BB^-1 (S^-1 r)_B   deviation of places B from what the others predict, with the covariance (S^-1)_BB^-1

    A place with a neighbour that deviates in the same way is no mistake: no robot of the cell explains that stretch.
    Raises InputError where too many contradict.
    """
    agreeing, tried = np.ones(rest.size, bool), np.zeros(rest.size, bool)
    sentences: list[str] = []
    where = [(number, part, k) for number, (part, *_) in enumerate(parts) for k in range(len(part.error))]
    spot = np.array([(*part.place[k], part.floor[k], number) for number, part, k in where])
    # deviations from what the other places predict: 1 of 80 parts with 200 places has such a place by chance
    strange = 4.0
    most_strange = 0.2  # share of the places; more contradict the program
    while True:
        rows = np.flatnonzero(agreeing)
        inverse = np.linalg.inv(covariance[np.ix_(rows, rows)])
        lonely = np.where(tried[rows], 0.0, np.abs(inverse @ rest[rows]) / np.sqrt(np.diag(inverse)))
        worst = int(np.argmax(lonely))
        if lonely[worst] <= strange:
            return agreeing, tuple(sentences)
        tried[rows[worst]] = True
        off = spot[rows] - spot[rows[worst]]
        apart = np.where(off[:, 2:].any(axis=1), 1.0, np.hypot(off[:, 0], off[:, 1]))
        apart[worst] = np.inf
        blocks = [np.array([worst, beside]) for beside in np.argsort(apart)[:BESIDE]]
        joint = [np.linalg.solve(inverse[np.ix_(pair, pair)], (inverse @ rest[rows])[pair]) for pair in blocks]
        if any(beside / own > ALIKE for own, beside in joint):
            continue
        agreeing[rows[worst]] = False
        away, deviation = (inverse @ rest[rows])[worst] / inverse[worst, worst], inverse[worst, worst] ** -0.5
        _, part, k = where[rows[worst]]
        sentences.append(_strange(part, k, part.error[k] - away, deviation))
        if np.sum(~agreeing) > most_strange * agreeing.size:
            reason = (
                f"{np.sum(~agreeing)} of {agreeing.size} places contradict the others or the program: {sentences[0]}"
            )
            raise InputError(part.path, reason)


def _strange(part: WallPlaces, k: int, expected: float, deviation: float) -> str:
    """Return the sentence on a place that is left out, with the reading that would fit."""
    error, (x, y) = part.error[k], 1e3 * part.place[k]
    fits = (text for text, f in READINGS.items() if abs(f * error - expected) <= 2.0 * deviation < abs(f * error))
    hint = next((f"; it would fit if it {text}" for text in fits), "")
    return (
        f"left out: {part.path}, line {part.lines[k]}: {1e6 * error:.3g} um at {x:g}, {y:g} mm contradicts the other "
        f"places, which expect {1e6 * expected:.3g} +- {1e6 * deviation:.2g} um{hint}"
    )


def quantities(cell: Cell, robot: Cell) -> dict[str, tuple[str, float]]:
    """Unit and value of each unknown of a robot, by its name; factors are on the values of the cell."""
    law, own, assumed = robot.cutting.active, cell.cutting.active, robot.imperfections
    soft = robot.arm.joint_compliance / cell.arm.joint_compliance
    width = cell.arm.backlash
    moved = 1e3 * (robot.stock.min - cell.stock.min)
    known = np.flatnonzero(width)
    return {
        "base x": (" urad/(N m)", 1e6 * float(robot.arm.base_compliance[0])),
        "base y": (" urad/(N m)", 1e6 * float(robot.arm.base_compliance[1])),
        **{f"compliance of A{k}": (" x", float(value)) for k, value in enumerate(soft, 1)},
        **{
            name.replace("_", " "): (" x", getattr(law, name) / getattr(own, name))
            for name in (*law.scattered, *law.axial_names)
            if getattr(own, name)
        },
        "tool": (" um/kN", 1e9 * robot.tool.lateral_compliance),
        "end share": ("", robot.cutting.end_share),
        "servo lag": (" Hz", assumed.servo_frequency),
        "dead time": (" ms", 1e3 * assumed.servo_delay),
        "backlash": (" x", float(assumed.backlash[known[0]] / width[known[0]]) if known.size else 0.0),
        "joining": ("", assumed.joining),
        "damping ratio": ("", robot.dynamics.damping_ratio),
        "frequency": (" x", float(np.sqrt(cell.mount.mass / robot.mount.mass)) if cell.mount.mass else 1.0),
        **{f"stock {axis}": (" mm", float(value)) for axis, value in zip("xyz", moved, strict=True)},
    }


def _compared(before: Cell, after: Cell) -> tuple[dict, ...]:
    """Mean and deviation of each unknown before and after, from drawn robots; without those that do not scatter."""
    tables = []
    for cell in (before, after):
        rng = np.random.default_rng(SAMPLE_SEED)
        tables.append([quantities(before, perturbed(cell, rng)) for _ in range(SAMPLES)])
    rows = []
    for name, (unit, _) in tables[0][0].items():
        drawn = [np.array([row[name][1] for row in table]) for table in tables]
        if drawn[0].std() > 1e-9 * max(1.0, abs(float(drawn[0].mean()))):
            row: dict = {"name": name, "unit": unit}
            for suffix, values in zip(("_before", ""), drawn, strict=True):
                row |= {f"mean{suffix}": float(values.mean()), f"sigma{suffix}": float(values.std())}
            rows.append(row)
    return tuple(rows)


def learned_keys(cell: Cell) -> dict:
    """Return the keys that keep what was learned, for a file to include."""
    assumed = cell.uncertainty
    return {
        "uncertainty": {
            "learned_from": list(assumed.learned_from),
            "learned": assumed.learned,
            "learned_directions": assumed.learned_directions,
        }
    }
