"""The turn of the tool about its own axis along a path: a free number of each pose, chosen for the least error.

Sought is psi(t) in q(t) = IK(target(t) Rz(psi(t))), which makes the least of

    J^2 = 1/T int e(t, psi)^2 + (w dpsi/dt)^2 dt,

e the static error across the feed under the mean cutting force (0 where nothing is cut), under the limits of the
joints and of their speeds. Dynamic programming [Bellman1957] finds the best path through a grid of turns at even
times, for each branch of the arm; then the same over five turns about that path, with half the step each time, until
the steps are small: J falls each time, and the limits hold throughout.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.interpolate import PchipInterpolator

from kr270_milling.base.errors import InputError, MillingError, ModelError
from kr270_milling.base.frames import Pose, quaternion_from_rotation, rotation_from_quaternion
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.path.timing import limit_by_joints
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.robot import inverse_near
from kr270_milling.studies.maps.placements import MARGIN, PathPlaces, about_z, places_at
from kr270_milling.studies.maps.postures import postures


@dataclass(frozen=True, eq=False)
class TurnPath:
    """Turns of the tool at n evenly spaced times."""

    branch: int
    turn: np.ndarray  #: psi [rad], (n,), without jumps
    q: np.ndarray  #: [rad], (n, 6)
    error: np.ndarray  #: e [m], (n,)
    value: float  #: J [m]


@dataclass(frozen=True, eq=False)
class Turns:
    """Cost and joint angles of turns at n times ``step`` [s] apart."""

    arm: PlacedArm
    places: PathPlaces  #: n places, in the order of time
    step: float  #: [s]
    weight: float  #: w [m s/rad]

    def at(self, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return joint angles [rad], (n, s, 8, 6), and errors [m], (n, s, 8), of turns (n, s) [rad]; NaN: no reach."""
        placed, places = self.arm, self.places
        n, s = turn.shape
        tool = placed.place @ Pose(places.position, places.rotation)
        rotation = tool.rotation[:, None] @ about_z(turn)
        place = Pose(np.repeat(tool.position, s, axis=0), rotation.reshape(-1, 3, 3))
        force, feed = (vectors @ placed.place.rotation.T for vectors in (places.force, places.feed))
        q, deflection = postures(placed.arm, placed.mount, place, np.repeat(force, s, axis=0), placed.dynamics.gravity)
        q, deflection = q.reshape(n, s, 8, 6), deflection.reshape(n, s, 8, 3)
        along = np.einsum("nsbi,ni->nsb", deflection, feed)[..., None] * feed[:, None, None]
        return q, np.linalg.norm(deflection - along, axis=-1)

    def searched(self, branch: int, turn, q, error, period: float) -> TurnPath | None:
        """Return the best path through states of turn (n, s), joints (n, s, 6) and errors (n, s), or None."""
        arm = self.arm.arm
        n, room = len(turn), arm.joint_speed_limit * self.step * (1 + 1e-9)  # [rad] from a place to the next
        inside = ((q >= arm.joint_lower + MARGIN) & (q <= arm.joint_upper - MARGIN)).all(-1) & np.isfinite(error)
        cost = np.where(inside, error**2 / n, np.inf)
        slope = self.weight**2 / (self.step**2 * n)
        value, chosen = _least_path(cost, np.nan_to_num(q), turn, room, slope, period)
        if not np.isfinite(value):
            return None
        rows = np.arange(n)
        path = turn[rows, chosen]
        if np.isfinite(period):
            path = np.unwrap(path, period=period)
        return TurnPath(branch, path, q[rows, chosen], error[rows, chosen], float(np.sqrt(value)))


def constant_turn(turns: Turns, grid: np.ndarray, branch: int | None = None) -> TurnPath | None:
    """Return the best turn of the grid that is the same everywhere, within the same limits; None without one.

    branch: of the arm; None: all.
    """
    return _shortest(_least(turns, np.array([turn]), branch=branch) for turn in grid)


def turned_cell(cell: Cell) -> Cell:
    """Return the cell with the best constant turn of the tool about its axis on the branch of its posture.

    Without a better turn by 10 % it is the cell itself. Raises InputError where the program states no orientation that
    may change.
    """
    path, content = path_of(cell), cell.path.loaded().content
    if not isinstance(content, Toolpath):
        raise InputError("compensation.turn", "best needs a program without times in path.file")
    ran = simulate(cell).result
    places = 60  # along the path, as map --along has by default
    chosen = np.linspace(0, len(ran.time) - 1, places).astype(int)
    step = float(ran.time[-1] - ran.time[0]) / (places - 1)
    turns = Turns(arm_of(cell), places_at(path, ran, chosen), step, 0.0)
    q, _ = turns.at(np.zeros((places, 1)))
    near = np.abs(np.exp(1j * q[0, 0]) - np.exp(1j * arm_of(cell).joints_along(path.target, ran.time_ns[:1])[0]))
    branch = int(np.nanargmin(near.max(axis=-1)))
    grid = np.radians(np.linspace(-180.0, 175.0, 72))
    best, own = constant_turn(turns, grid, branch), constant_turn(turns, np.zeros(1), branch)
    if best is None or own is None or best.value > 0.9 * own.value:
        return cell
    rotation = rotation_from_quaternion(content.quaternion) @ about_z(best.turn[0])
    other = dataclasses.replace(content, quaternion=quaternion_from_rotation(rotation))
    posture = "start_joints" if cell.start_joints.size else "posture_hint"
    turned = cell.replace(path=cell.path.loaded().replace(content=other), **{posture: best.q[0]})
    with contextlib.suppress(MillingError):
        if path_of(turned).target.duration_ns <= 1.1 * path.target.duration_ns:  # else a joint slows the path
            return turned
    return cell


def own_turn(cell: Cell) -> float:
    """Return the turn [rad] of the tool of a cell about its axis from that of its program; 0 without a program."""
    content = cell.path.content
    if not isinstance(content, Toolpath):
        return 0.0
    read = cell.path.replace().read()
    if not isinstance(read, Toolpath) or np.array_equal(read.quaternion[0], content.quaternion[0]):
        return 0.0
    before, after = (rotation_from_quaternion(each.quaternion[0]) for each in (read, content))
    turn = before.T @ after
    return float(np.arctan2(turn[1, 0], turn[0, 0]))


def _shortest(paths: Iterable[TurnPath | None]) -> TurnPath | None:
    return min(filter(None, paths), key=lambda path: path.value, default=None)


def best_turns(turns: Turns, grid: np.ndarray) -> TurnPath:
    """Return the best path of all branches over a grid of turns (s,) [rad], then refined. Raises ModelError.

    A grid of a whole turn has no ends: the path may pass from the last to the first.
    """
    step = float(grid[1] - grid[0]) if len(grid) > 1 else 0.0
    period = 2 * np.pi if np.ptp(grid) + 1.5 * step > 2 * np.pi else np.inf
    best = _least(turns, grid, period)
    if best is None:
        raise ModelError(
            f"no turns of the tool at {len(turns.places.position)} places keep every joint within its range and its "
            "speed: lower the feed, or move the workpiece"
        )
    return _refined(turns, best, step, (-np.inf, np.inf) if np.isfinite(period) else (grid[0], grid[-1]))


def _least(turns: Turns, grid: np.ndarray, period: float = np.inf, branch: int | None = None) -> TurnPath | None:
    """Return the best path of all branches over a grid, or of one.

    States: every turn of the grid with every whole turn of the joints that their limits may leave room for.
    """
    arm, n = turns.arm.arm, len(turns.places.position)
    first = np.ceil((arm.joint_lower - np.pi) / (2 * np.pi)).astype(int)
    last = np.floor((arm.joint_upper + np.pi) / (2 * np.pi)).astype(int)
    wholes = 2 * np.pi * np.array(list(itertools.product(*map(range, first, last + 1))))
    q, error = turns.at(np.tile(grid, (n, 1)))
    turn, errors = np.tile(grid, (n, len(wholes))), np.tile(error, (1, len(wholes), 1))
    states = ((q[:, None, :, b] + wholes[:, None]).reshape(n, -1, 6) for b in range(8))
    paths = (
        turns.searched(b, turn, q_b, errors[..., b], period) for b, q_b in enumerate(states) if branch in (None, b)
    )
    return _shortest(paths)


def _refined(turns: Turns, path: TurnPath, step: float, ends: tuple[float, float]) -> TurnPath:
    """Refine the path with ever smaller steps [rad] about it, within ``ends``."""
    finest = 1e-4  # [rad] of the last grid
    near = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])  # steps about a path
    rounds = 60
    for _ in range(rounds):
        if step < finest:
            break
        turn = np.clip(path.turn[:, None] + step * near, *ends)
        q, error = turns.at(turn)
        q = path.q[:, None] + (q[:, :, path.branch] - path.q[:, None] + np.pi) % (2 * np.pi) - np.pi
        better = turns.searched(path.branch, turn, q, error[:, :, path.branch], np.inf)
        if better is None or not better.value < path.value * (1 - 1e-6):
            step /= 2
        path = path if better is None or better.value > path.value else better
    return path


def turned_run(
    placed: PlacedArm, run: Trajectory, time_ns: np.ndarray, path: TurnPath
) -> tuple[Trajectory, np.ndarray]:
    """A target trajectory with the turns of a way at times [ns], (n,), and its joint angles [rad] at the knots.

    Between two places the turn is a monotone cubic, without overshoot. Knots come later where a joint would run too
    fast or accelerate too hard. Raises ReachError, JointLimitError.
    """
    turn = PchipInterpolator(time_ns, path.turn)(run.time_ns)
    rotation = rotation_from_quaternion(run.quaternion) @ about_z(turn)
    q = inverse_near(placed.arm, placed.mount, placed.place @ Pose(run.position, rotation), path.q[0])
    run = Trajectory(run.time_ns, run.position, quaternion_from_rotation(rotation), run.velocity)
    return limit_by_joints(run, q, placed.arm.joint_speed_limit, placed.arm.joint_acceleration_limit), q


@njit(cache=True, nogil=True)
def _least_path(cost, q, turn, room, slope, period):
    """Return the least sum of cost (n, s) and slope (psi' - psi)^2 along n places, and the chosen states (n,).

    No joint of q (n, s, 6) may go farther than ``room`` (6,) from a place to the next. psi is ``turn`` (n, s), its
    differences are taken modulo ``period``.
    """
    n, s = cost.shape
    value, before = cost[0].copy(), np.zeros((n, s), np.int32)
    for k in range(1, n):
        new = np.full(s, np.inf)
        order = np.argsort(value)  # none behind one that is too dear by itself can be the best
        for j in range(s):
            if not np.isfinite(cost[k, j]):
                continue
            for i in order:
                if not value[i] < new[j]:
                    break
                away = turn[k, j] - turn[k - 1, i]
                if np.isfinite(period):
                    away -= period * np.round(away / period)
                total = value[i] + slope * away * away
                if not total < new[j]:
                    continue
                fits = True
                for h in range(6):
                    if abs(q[k, j, h] - q[k - 1, i, h]) > room[h]:
                        fits = False
                        break
                if fits:
                    new[j], before[k, j] = total, i
            new[j] += cost[k, j]
        value = new
    chosen = np.zeros(n, np.int64)
    chosen[n - 1] = np.argmin(value)
    for k in range(n - 1, 0, -1):
        chosen[k - 1] = before[k, chosen[k]]
    return value[chosen[n - 1]], chosen
