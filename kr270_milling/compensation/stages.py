"""One segment of the lifted model: from the state at its first knot to the tool in its parts, and to the next knot.

Its numbers are y = [u, u', c, v, a, j]: relative modal coordinates of the arm and their rates, and the cubic of the
correction, 2 r + 12 of them; the state x at a knot is y without j. Where the correction is smooth j is free; where the
target stands still the correction has no slope; straight lines have a free v.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.compensation.response import ArmResponse
from kr270_milling.compensation.segments import Segments

__all__ = ["CONTROLS", "Course", "choices", "outputs", "transitions", "units"]

CONTROLS = 6  #: most free numbers of a segment: a and j after a stop


@dataclass(frozen=True, eq=False)
class Course:
    """What the correction may do in its m + 1 knots."""

    smooth: bool  #: C2 between stops; else straight lines
    resting: np.ndarray  #: (m + 1,) bool: a knot in which the target stands still
    held: np.ndarray  #: (m,) bool: the target rests all along this segment, so does the correction


def units(arm: ArmResponse, segments: Segments) -> np.ndarray:
    """(2 r + 12,): what a one in each number of y stands for, so that all of them are lengths of like size [m]."""
    time, size = float(np.median(segments.duration)), np.linalg.norm(arm.outward[:1], axis=(0, 1))
    size = np.maximum(size, 1e-6 * size.max(initial=1e-300))
    return np.concatenate([1.0 / size, 1.0 / (size * time), *(np.full(3, time**-i) for i in range(4))])


def outputs(arm: ArmResponse, segments: Segments) -> np.ndarray:
    """Motion of the tool in each part from y, (m, parts, 3, 2 r + 12)."""
    place, out = segments.place, arm.outward[:, None]
    free, forced = arm.free(place), arm.forced(place)
    swing = [out @ (f[..., None] * arm.inward[:, None]) if arm.moves else 0.0 for f in forced[:2]]
    straight = segments.powers[..., None, None, :] * np.eye(3)[:, :, None]  # (m, parts, 3, 3, 4)
    cubic = [straight[..., 0], straight[..., 1], straight[..., 2] + swing[0], straight[..., 3] + swing[1]]
    return arm.gain * np.concatenate([out * free[0][..., None, :], out * free[1][..., None, :], *cubic], axis=-1)


def transitions(arm: ArmResponse, segments: Segments) -> np.ndarray:
    """x at the next knot from y, (m, 2 r + 9, 2 r + 12)."""
    duration, r = segments.duration[:, None], arm.order
    h11, h12, h21, h22 = (h[:, 0, None] for h in arm.free(duration))
    of_bend, of_jerk, rate_of_bend, rate_of_jerk = (f[:, 0, :, None] * arm.inward for f in arm.forced(duration))
    found = np.zeros((len(segments), 2 * r + 9, 2 * r + 12))
    found[:, :r, :r], found[:, :r, r : 2 * r] = arm.carry * h11, arm.carry * h12
    found[:, r : 2 * r, :r], found[:, r : 2 * r, r : 2 * r] = arm.carry * h21, arm.carry * h22
    if arm.moves:
        found[:, : 2 * r, 2 * r + 6 :] = np.concatenate(
            [arm.carry @ np.dstack([of_bend, of_jerk]), arm.carry @ np.dstack([rate_of_bend, rate_of_jerk])], axis=1
        )
    powers = duration ** np.arange(4) / [1.0, 1.0, 2.0, 6.0]
    for row in range(3):
        for column in range(row, 4):
            rows, columns = (slice(2 * r + 3 * i, 2 * r + 3 * i + 3) for i in (row, column))
            found[:, rows, columns] = powers[:, column - row, None, None] * np.eye(3)
    return found


def choices(arm: ArmResponse, segments: Segments, course: Course, unit: np.ndarray):
    """y of a segment, in units, from the state x that arrives and from what is free there: (m, y, x), (m, y, CONTROLS).

    The third one gives x at the first knot from c, v, a of the correction there, (x, 9).
    """
    m, r = len(segments), arm.order
    given, free = np.zeros((m, 2 * r + 12, 2 * r + 9)), np.zeros((m, 2 * r + 12, CONTROLS))
    given[:, : 2 * r + 3, : 2 * r + 3] = np.eye(2 * r + 3)
    jump = -arm.inward * (unit[2 * r + 3] / unit[r : 2 * r, None]) if arm.moves else np.zeros((m, r, 3))
    if course.smooth:
        _smooth(given, free, segments, course, r)
    else:
        _straight(given, free, course, jump, r)
    start = np.zeros((2 * r + 9, 9))  # x at the first knot from c, v, a: before it the correction did not move
    start[2 * r :] = np.eye(9)
    start[r : 2 * r, 3:6] = jump[0]
    if course.resting[0]:
        start[:, 3:] = 0.0
    return given, free, start


def _smooth(given, free, segments: Segments, course: Course, r: int) -> None:
    v, a, j = (slice(2 * r + 3 * i, 2 * r + 3 * i + 3) for i in (1, 2, 3))
    time = segments.duration / np.median(segments.duration)
    for k in np.flatnonzero(~course.held).tolist():
        if course.resting[k]:
            free[k, a, 3:] = np.eye(3)  # a bend of its own after a stop
        else:
            given[k, v, v] = given[k, a, a] = np.eye(3)
        if course.resting[k + 1]:  # v + a t + j t^2 / 2 = 0
            given[k, j] = -2.0 / time[k] ** 2 * (given[k, v] + time[k] * given[k, a])
            free[k, j] = -2.0 / time[k] * free[k, a]
        else:
            free[k, j, :3] = np.eye(3)


def _straight(given, free, course: Course, jump: np.ndarray, r: int) -> None:
    v, rate = slice(2 * r + 3, 2 * r + 6), slice(r, 2 * r)
    given[0, v, v] = np.eye(3)
    for k in range(1, len(course.held)):
        given[k, rate, v] = -jump[k]  # at a corner u' jumps by -dv
        if not course.held[k]:
            free[k, v, :3] = np.eye(3)
            free[k, rate, :3] = jump[k]
