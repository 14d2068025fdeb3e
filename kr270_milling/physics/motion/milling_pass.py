"""Milling pass, Fig. 7: the arm predicts the tool's pose, the cut answers with the wrench, the arm corrects.

The functions that the compiled loop calls are the same that a robot node and a cutting node call one by one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.compiled import compiled, inner
from kr270_milling.base.errors import MillingError
from kr270_milling.base.frames import tool_axis
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import CutModel
from kr270_milling.physics.cutting.cut_step import cut_undo, engage
from kr270_milling.physics.cutting.state import LEVEL_SUM
from kr270_milling.physics.cutting.sweep import NO_FORCES, sweep
from kr270_milling.physics.motion.dynamics import ArmModel, advance, drive, swing_freely
from kr270_milling.physics.motion.periods import Clock

WINDOW = 65_536  # exchange periods whose reference is sampled at once, some 600 bytes each
#: shape of a row of each series of a pass
SERIES: dict[str, tuple[int, ...]] = {
    "time_ns": (), "target": (3,), "reference": (3,), "tool": (3,), "deflection": (6,), "wrench": (6,),
    "correction": (), "torque": (), "volume": (),
}  # fmt: skip
MANY = 100_000  #: exchange periods of a long pass, 7 min at 4 ms
#: exchange periods that a quick pass of the mean force makes at once while the cut is steady: the tool is less than
#: ``STEADY`` [m] from the chord of its way, the change of the force moves it by less than that, and it sinks or rises
#: by less than six times as much
TOGETHER, STEADY = 8, 0.4e-6
FLIGHT = 0.05  # [m]; an arm that is linear about its posture is no model of one that is pushed so far


class PassError(MillingError):
    """A pass whose numbers mean nothing: the deflection [m] at a time [s]."""

    def __init__(self, deflection: float, at: float):
        self.deflection, self.at = deflection, at
        super().__init__(
            f"the cut would push the tool {deflection:.3g} m away at {at:.6g} s, for which the linear model of the arm "
            "does not hold: check the force law, the feed per tooth, the compliances and the masses"
        )


@dataclass(frozen=True, eq=False)
class PassResult:
    """Series of one pass at the ends of its n exchange periods (first row: the start), workpiece axes.

    A long pass may combine ``every`` periods in a row: the place and the deflection where the deflection is largest,
    the mean wrench, the largest correction and torque, the removed volume.
    """

    time_ns: np.ndarray  #: [ns], (n + 1,)
    target: np.ndarray  #: programmed tool centre [m], (n + 1, 3)
    reference: np.ndarray  #: reference of the controller [m], (n + 1, 3)
    tool: np.ndarray  #: tool centre that the cut was given: predicted [m], (n + 1, 3)
    deflection: np.ndarray  #: corrected displacement of the arm [m, rad], (n + 1, 6)
    wrench: np.ndarray  #: mean over each period, on the tool [N, N m], (n + 1, 6)
    correction: np.ndarray  #: corrected minus predicted tool centre [m], (n + 1,)
    torque: np.ndarray  #: mean of the spindle over each period [N m], (n + 1,)
    volume: np.ndarray  #: removed in each period [m^3], (n + 1,)
    micro_steps: int  #: micro-steps of the spindle in the whole pass
    removed_area: float  #: [m^2]
    removed_volume: float  #: [m^3]
    wall_time: float  #: [s], of the pass alone
    heights: np.ndarray | None = None  #: ``Cut.map_heights`` of the finished workpiece [m], (a, b); None: not stored
    every: int = 1  #: exchange periods of a row
    undercut_volume: float = 0.0  #: part of the removed volume that was above a leaning tool [m^3]

    @property
    def time(self) -> np.ndarray:
        """[s]"""
        return self.time_ns * 1e-9

    @property
    def actual(self) -> np.ndarray:
        """Tool centre [m], (n + 1, 3)."""
        return self.reference + self.deflection[:, :3]


class CompliantArm:
    """The arm's half of the exchange: state of eq. (1), stepped by ``predict`` and ``correct``.

    pushes: of the reference that it follows, ``ArmModel.push``; None: a reference that does not move.
    """

    def __init__(self, model: ArmModel, pushes: np.ndarray | None = None):
        self.model = model
        self.pushes = np.zeros((0, model.order)) if pushes is None else pushes
        self.step = 0  #: exchange periods done
        self.state = np.zeros(model.states)
        self.wrench = np.zeros(6)
        self._scratch = np.zeros(model.states)

    @property
    def _push(self) -> np.ndarray:
        return self.pushes[self.step] if self.step < len(self.pushes) else np.zeros(0)

    def predict(self, wrench: np.ndarray | None = None) -> np.ndarray:
        """Deflection (6,) at the end of the next period under ``wrench``, or under that of the last period."""
        deflection = np.zeros(6)
        wrench = self.wrench if wrench is None else wrench
        advance(self.step, self.state, wrench, self._push, self.model.arrays, self._scratch, deflection)
        return deflection

    def correct(self, wrench: np.ndarray) -> np.ndarray:
        """Integrate the period with the wrench (6,) that acted in the period; returns the final deflection (6,)."""
        deflection = np.zeros(6)
        advance(self.step, self.state, wrench, self._push, self.model.arrays, self._scratch, deflection)
        self.state, self._scratch = self._scratch, self.state
        self.wrench = np.array(wrench, float)
        self.step += 1
        return deflection


def follow(model: ArmModel, pushes: np.ndarray, wrenches: np.ndarray) -> np.ndarray:
    """Deflections (n + 1, 6) of a pass whose wrenches (n + 1, 6) are known; pushes: see ``CompliantArm``.

    ``CompliantArm.correct`` returns the same bits, one by one.
    """
    deflections = np.zeros((len(wrenches), 6))
    states = np.zeros((2, model.states))
    _follow(np.ascontiguousarray(wrenches, float), states, pushes, model.arrays, deflections)
    return deflections


@compiled
def _follow(wrenches, states, pushes, arrays, deflections):
    for n in range(len(wrenches) - 1):
        before, after = states[n % 2], states[(n + 1) % 2]
        push = pushes[n] if len(pushes) else after[:0]
        advance(n, before, wrenches[n + 1], push, arrays, after, deflections[n + 1])


def _refuse_flight(stamps: np.ndarray, deflections: np.ndarray) -> None:
    near = np.abs(deflections[:, :3]) <= FLIGHT  # NaN is far
    if not near.all():
        first = int(np.argmin(near.all(axis=1)))
        raise PassError(float(np.linalg.norm(deflections[first, :3])), float(stamps[first]) * 1e-9)


@inner
def _swing(first, count, state, wrench, pushes, row, arrays, states, free, deflections):
    """Fill the deflections of ``count`` periods under a wrench, after ``row``; the first of ``states`` is the end."""
    for j in range(state.size):
        states[count % 2, j] = state[j]
    for i in range(count):
        before, after = states[(count - i) % 2], states[(count - i + 1) % 2]
        push = pushes[row + i] if len(pushes) else free[:0]
        swing_freely(first + i, before, arrays, free)
        drive(first + i, free, before, wrench, push, arrays, after, deflections[row + i + 1])


@compiled
def _exchange(
    window,
    first,
    last,
    iterations,
    most,
    reference,
    silent,
    arm,
    state,
    wrench,
    cut,
    teeth,
    mean,
    micro_steps,
    scratch,
    out,
):
    """Exchange periods first+1..last of a pass, Fig. 7; state and wrench are carried on. False: a sweep too large.

    window: the period from which ``reference``, ``silent``, the pushes and ``out`` begin; cut: state
    and params; teeth, mean: see ``cut_undo``; most: periods of an exchange of a steady cut, see ``TOGETHER``.
    """
    tool, deflections, wrenches, corrections, torques, volumes = out
    pushes, arrays = arm
    s, p = cut
    per_node = p.spacing * p.spacing
    states, free, span, turned, taken, answers, given, no_forces = scratch
    answer = answers[1]
    for j in range(6):
        answer[j] = wrench[j]
    for j in range(tool.shape[1]):
        given[0, j] = tool[first - window, j]
    n, count, cuts = first, 1, False
    while n < last:
        count, row = min(count, last - n), n - window
        end, before, torque, steady = row + count, s.floats[LEVEL_SUM], 0.0, False
        for k in range(iterations):
            _swing(n, count, state, answer, pushes, row, arrays, states, free, deflections)  # the robot predicts
            for i in range(row + 1, end + 1):
                for j in range(tool.shape[1]):  # with the axis of a tool that tilts
                    tool[i, j] = reference[i, j] + (deflections[i, j] if j < 3 else 0.0)
            if not max(abs(deflections[end, 0]), abs(deflections[end, 1]), abs(deflections[end, 2])) <= FLIGHT:
                return True  # a sweep over metres would not end; the caller refuses this deflection
            steady = count == 1 or abs(tool[end, 2] - tool[row, 2]) < 6.0 * STEADY  # a move leaves a level floor
            for i in range(1, count):
                steady = steady and not silent[row + i] and not silent[end]
                for j in range(3):
                    chord = tool[row, j] + i / count * (tool[end, j] - tool[row, j])
                    steady = steady and abs(tool[row + i, j] - chord) < STEADY
            if not steady:
                break
            if k > 0 and not cut_undo(s, teeth, mean):
                return False
            for j in range(tool.shape[1]):
                given[1, j] = tool[end, j]
            if 1 < count < last - n:  # a tool that sinks is as low as at the end of a step: then as in the middle
                given[1, 2] += 0.5 * max(tool[row, 2] - tool[end, 2], 0.0)
            if teeth is not None:  # the cut answers
                torque = sweep(s, p, given[0], given[1], n * micro_steps, micro_steps, no_forces, answer)
            if mean is not None:
                span[1] = count * micro_steps
                engage(s, p, p.flat, p.profile, mean[0], mean[1], given, span, answers, turned, taken)
                torque = turned[1]
            if silent[end]:
                torque = 0.0
                for j in range(6):
                    answer[j] = 0.0
        if steady:
            _swing(n, count, state, answer, pushes, row, arrays, states, free, deflections)  # the robot corrects
            farthest = 0.0
            for i in range(row + 1, end + 1):
                away = 0.0
                for j in range(3):
                    away += (reference[i, j] + deflections[i, j] - tool[i, j]) ** 2
                corrections[i] = np.sqrt(away)
                farthest = max(farthest, corrections[i])
            removed = (s.floats[LEVEL_SUM] - before) * per_node
            steady = count == 1 or (farthest < STEADY and (removed > 0.0) == cuts)
            if not steady:  # a step that removes too much to take it back stays
                steady = not cut_undo(s, teeth, mean)
        if not steady:
            count //= 2
            for j in range(6):
                answer[j] = wrench[j]
            continue
        cuts = removed > 0.0
        for j in range(tool.shape[1]):
            given[0, j] = given[1, j]
        for j in range(6):
            wrench[j] = answer[j]
        for j in range(state.size):  # one by one: Numba compiles the sentence on shapes of a slice for seconds
            state[j] = states[0, j]
        for i in range(row + 1, end + 1):
            for j in range(6):
                wrenches[i, j] = answer[j]
            torques[i] = torque
            if not silent[i]:
                volumes[i] = removed / count
        n, count = n + count, min(2 * count, most) if farthest < 0.35 * STEADY else count
    return True


def silent_periods(silent: np.ndarray) -> np.ndarray:
    """Return whether a period has no force, (n + 1,) bool, by its end; silent: its end has no force, (n + 1,) bool.

    The period in which the drilling ends has no force either.
    """
    without = np.array(silent, bool)
    without[1:] |= without[:-1]
    return without


def run_pass(
    model: ArmModel,
    cut: CutModel,
    clock: Clock,
    target: Trajectory,
    reference: Trajectory,
    iterations: int = 1,
    progress: Callable[[int, int], None] | None = None,
    silent: Callable[[np.ndarray], np.ndarray] | None = None,
    most_rows: float = math.inf,
    quick: bool = False,
) -> PassResult:
    """Run a pass along ``reference`` on the workpiece of ``cut``, whose grid it changes; workpiece frame.

    silent: stamps (n,) [ns] -> whether the force is not modelled there, (n,) bool: drilling. The tool then removes
    material without a force, and the period counts as one without a cut. most_rows: of the result; those of a longer
    pass combine several periods, see ``PassResult.every``.
    progress(done, total) is called every 4000 exchange periods. quick: a pass of ``MANY`` periods makes ``TOGETHER`` at
    once where the cut is steady. Raises MillingError if the grid has no more tiles or the periods are too long to be
    iterated, and PassError where the arm would fly off.
    """
    chunk = 4000  # exchange periods between two reports of progress
    n = clock.steps(reference.duration_ns)
    every = max(1, math.ceil(n / most_rows))
    window = WINDOW // every * every
    state, wrench = np.zeros(model.states), np.zeros(6)
    tool = _poses(cut, reference, np.zeros(1, np.int64))
    shapes = tool.shape[1:], (6,), (6,), (), (), ()
    buffers = [np.zeros((min(n, window) + 1, *shape)) for shape in shapes]  # new ones would be mapped for each window
    count = math.ceil(n / every) + 1
    series = {name: np.zeros((count, *shape)) for name, shape in SERIES.items()}
    series["time_ns"] = np.zeros(count, np.int64)
    filled = 0
    most = TOGETHER if quick and cut.mean and iterations == 1 and n >= MANY else 1
    cut_state = cut.state if iterations > 1 or most > 1 else cut.state_of_pass
    # states and free vibration of the arm; steps, torques, volumes, wrenches and poses of the cut, before and after
    scratch = (
        np.zeros((2, model.states)),
        np.zeros(model.order),
        np.zeros(2, np.int64),
        np.zeros(2),
        np.zeros(2),
        np.zeros((2, 6)),
        np.zeros((2, tool.shape[1])),
        NO_FORCES,
    )
    area, volume, undercut, wall = cut.removed_area, cut.removed_volume, cut.undercut_volume, 0.0

    def sampled(begin: int) -> tuple[np.ndarray, ...]:
        """Stamps of a window, what the cut takes there, the target, silent periods and pushes."""
        stamps = clock.stamp(np.arange(begin, min(begin + window, n) + 1))
        poses = _poses(cut, reference, stamps)
        positions = poses[:, :3]
        ahead = stamps if begin == 0 else np.append(clock.stamp(np.array([begin - 1])), stamps)
        without = np.zeros(ahead.size, bool) if silent is None else silent_periods(silent(ahead))
        programmed = positions if reference is target else target.sample(stamps)
        pushes = model.push(reference, stamps, begin, positions)
        return stamps, poses, programmed, without[-stamps.size :], pushes

    beside = ThreadPoolExecutor(1)  # samples a window while the window before is cut
    upcoming: Future | None = None
    for begin in range(0, max(n, 1), window):
        end = min(begin + window, n)
        stamps, poses, programmed, without, pushes = upcoming.result() if upcoming else sampled(begin)
        upcoming = beside.submit(sampled, end) if end < n else None
        buffers[0][0] = tool[-1]
        out = tuple(buffer[: stamps.size] for buffer in buffers)
        out[-1][:] = 0.0  # silent periods remove nothing
        carried = (
            iterations,
            most,
            poses,
            without,
            (pushes, model.arrays),
            state,
            wrench,
            (cut_state, cut.params),
            cut.teeth,
            cut.mean,
            clock.micro_steps,
            scratch,
            out,
        )
        _exchange(begin, begin, begin, *carried)  # compiled before the clock runs
        start = time.perf_counter()
        for first in range(begin, end, chunk):
            last = min(first + chunk, end)
            whole = _exchange(begin, first, last, *carried)
            cut.refuse_failure(whole)
            part = slice(first - begin, last - begin + 1)
            _refuse_flight(stamps[part], out[1][part])
            if progress is not None:
                progress(last, n)
        wall += time.perf_counter() - start
        tool = out[0]
        rows = _combined(every, int(begin > 0), (stamps, programmed, poses[:, :3], tool[:, :3], *out[1:]))
        for values, new in zip(series.values(), rows, strict=True):
            values[filled : filled + len(new)] = new
        filled += len(rows[0])
    beside.shutdown()
    return PassResult(
        **series,
        micro_steps=n * clock.micro_steps,
        removed_area=cut.removed_area - area,
        removed_volume=cut.removed_volume - volume,
        wall_time=wall,
        undercut_volume=cut.undercut_volume - undercut,
        every=every,
    )


def _poses(cut: CutModel, reference: Trajectory, stamps: np.ndarray) -> np.ndarray:
    """Return what the cut takes at stamps [ns]: positions (n, 3) [m], with the axis after each of a tool that tilts."""
    axes = tool_axis(reference.sample_orientation(stamps)) if cut.tilts else None
    return cut.poses(reference.sample(stamps), axes)


def _combined(every: int, first: int, series: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """The rows of a window, ``every`` periods each; first: 0 for the window with the start of the pass, else 1."""
    if every == 1:
        return tuple(values[first:] for values in series)
    size = np.einsum("ij,ij->i", series[4][1:, :3], series[4][1:, :3])
    starts = np.arange(0, size.size, every)
    padded = np.append(size, np.full(-size.size % every, -1.0)).reshape(-1, every)
    rows = np.append(np.zeros(1 - first, int), starts + padded.argmax(1) + 1)
    counts = np.diff(np.append(starts, size.size))[:, None]
    combined = [values[rows] for values in series]
    for k, values in enumerate((np.add, np.maximum, np.maximum, np.add), 5):  # wrench, correction, torque, volume
        combined[k][1 - first :] = values.reduceat(series[k][1:], starts, axis=0) / (counts if k == 5 else 1.0)
    return tuple(combined)
