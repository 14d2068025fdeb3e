"""Checks of a corrected path that need only numbers per knot; each returns a list of violations.

Knots that offend one after another make one finding, named by the worst of them. Points are counted from 1, as in the
robot program.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr270_milling.trajectory.timing import joint_rates
from kr270_milling.trajectory.trajectory import Trajectory, offsets

__all__ = ["Violation", "violations", "exceeding", "correction_size", "correction_per_tick", "axis_reversals",
           "corner_blending", "joint_speeds", "joint_accelerations"]  # fmt: skip

ROUNDING = 1e-5  #: share of a limit that a value may lie above it: what was cut down to the limit is not beyond it
LEAST_JUMP = 1e-7  #: [m], of the tool where an axis reverses; a smaller one shows nowhere


@dataclass(frozen=True)
class Violation:
    """A run of points that offend against one limit, named by the worst of them; ``findings`` says what to do."""

    kind: str
    point: int | None  #: number of the worst point, from 1; None where it belongs to none
    value: float  #: there, in SI units
    limit: float
    severity: str  #: "stop": must not be run; "warning"; "note"
    sentence: str
    subject: str = ""  #: of what kind there are several: an axis, a singularity


def violations(
    kind: str,
    over: np.ndarray,
    value: np.ndarray,
    limit,
    sentence: Callable[[int, int, str], str],
    *,
    worst: np.ndarray | None = None,
    severity: str = "stop",
    subject: str = "",
    points: np.ndarray | None = None,
) -> list[Violation]:
    """One violation for each stretch of True in ``over`` (n,), named by its worst place k.

    value (n,) and limit, a number or (n,): of the places in SI units; sentence(k, point, "points 3 to 5") says it;
    worst (n,): is largest at the worst place, default: value, NaN the worst; points (n,): of the program, from 1.
    """
    points = np.arange(1, len(over) + 1) if points is None else points
    worst = np.where(np.isnan(value), np.inf, value) if worst is None else worst
    limits = np.broadcast_to(limit, len(over))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], over, [False]]).astype(np.int8)))
    found = []
    for start, stop in edges.reshape(-1, 2).tolist():
        k = start + int(np.argmax(worst[start:stop]))
        first, point, last = int(points[start]), int(points[k]), int(points[stop - 1])
        where = f"point {first}" if first == last else f"points {first} to {last}"
        text = sentence(k, point, where)
        found.append(Violation(kind, point, float(value[k]), float(limits[k]), severity, text, subject))
    return found


def exceeding(kind: str, value, limit: float, what: str, unit: str, scale: float = 1.0, severity="stop", first=1):
    """Violations where ``value`` (n,), one per point, exceeds the limit, or is NaN; the sentence shows value * scale.

    first: number of the point that value[0] belongs to.
    """
    value = np.asarray(value, float)

    def sentence(k: int, point: int, where: str) -> str:
        return f"{what} exceeds {limit * scale:.4g} {unit} ({where}): {value[k] * scale:.4g} {unit} at point {point}"

    over, points = ~(value <= limit * (1 + ROUNDING)), np.arange(first, first + len(value))
    return violations(kind, over, value, limit, sentence, severity=severity, points=points)


def correction_size(original: Trajectory, revised: Trajectory, tick_ns: int, limit: float) -> list[Violation]:
    """Where the correction [m] is larger than allowed, at a knot or at a tick on the way to it."""
    time_ns, shift, _ = offsets(original, revised, tick_ns)
    size = np.linalg.norm(revised.position - original.position, axis=1)
    size = np.fmax(size, _on_the_way(original, time_ns, np.linalg.norm(shift, axis=1)))
    return exceeding("correction size", size, limit, "the correction", "mm", 1e3)


def _on_the_way(original: Trajectory, time_ns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The largest value of the ticks that lead to each knot, (n,)."""
    largest = np.zeros(len(original))
    np.maximum.at(largest, np.clip(np.searchsorted(original.time_ns, time_ns), 1, len(original) - 1), values)
    return largest


def correction_per_tick(original: Trajectory, revised: Trajectory, tick_ns: int, limit: float) -> list[Violation]:
    """Where the correction [m] changes by more from one tick to the next than the controller takes."""
    time_ns, shift, _ = offsets(original, revised, tick_ns)
    largest = _on_the_way(original, time_ns[1:], np.linalg.norm(np.diff(shift, axis=0), axis=1))
    return exceeding("correction per tick", largest, limit, "the change of the correction per tick", "um", 1e6)


def axis_reversals(joints, backlash, lever, least: float = 1e-5) -> list[Violation]:
    """Where a joint turns back, so that its backlash [rad], (6,), shows; movements below ``least`` [rad] are noise.

    joints [rad], (n, 6); lever: distance of the tool tip from each axis [m], (n, 6), so that the tool jumps by
    backlash times lever. An axis that pauses and goes on in the same sense does not reverse.
    """
    violations = []
    for axis, (angle, play) in enumerate(zip(np.asarray(joints, float).T, np.asarray(backlash, float), strict=True)):
        for k in _turns(angle.tolist(), least):
            jump = float(play * lever[k, axis])
            if jump < LEAST_JUMP:
                continue
            name = f"axis {axis + 1}"
            sentence = f"{name} reverses at point {k + 1}: its backlash lets the tool jump by {1e6 * jump:.3g} um"
            violations.append(Violation("axis reversal", k + 1, jump, 0.0, "note", sentence, name))
    return sorted(violations, key=lambda v: v.point or 0)


def _turns(angle: list[float], least: float) -> list[int]:
    """Knots at the extremes after which ``angle`` goes back by more than ``least``."""
    turns, extreme, sense = [], 0, 0
    for k, value in enumerate(angle):
        gone = value - angle[extreme]
        if gone * sense > 0:
            extreme = k  # further in the same sense
        elif abs(gone) > least:
            if sense:
                turns.append(extreme)
            extreme, sense = k, 1 if gone > 0 else -1
    return turns


def corner_blending(original: Trajectory, revised: Trajectory, blend_distance: float, share=0.5) -> list[Violation]:
    """Where the controller's blending of LIN motions rounds off more than a share of the correction at the knot [m].

    A parabola that leaves the corner's legs at the distance d, at most half a leg, misses the corner by d sin(t/2) / 2
    for a turn by t. Knots where the tool stops are not blended.
    """
    legs = np.diff(revised.position, axis=0)
    length = np.linalg.norm(legs, axis=1)
    ahead = legs / np.where(length > 0, length, 1.0)[:, None]
    half_sine = np.linalg.norm(np.diff(ahead, axis=0), axis=1) / 2
    distance = np.minimum(blend_distance, np.minimum(length[:-1], length[1:]) / 2)
    rounded = np.where(original.standing[1:-1], 0.0, distance * half_sine / 2)
    correction = np.linalg.norm(revised.position - original.position, axis=1)[1:-1]
    ratio = np.where(rounded < 1e-7, 0.0, rounded / np.maximum(correction, 1e-9))  # below 0.1 um it is no matter
    what = "the share of the correction that corner blending takes"
    return exceeding("corner blending", ratio, share, what, "%", 100.0, "warning", first=2)


def joint_speeds(time_ns, joints, limit) -> list[Violation]:
    """Where a joint runs faster between two knots than its limit [rad/s], (6,); named by the later knot."""
    speed, _ = joint_rates(np.asarray(time_ns) * 1e-9, np.asarray(joints, float))
    return _joints("joint speed", np.abs(speed), limit, "deg/s", 2)


def joint_accelerations(time_ns, joints, limit, at_rest: bool = True) -> list[Violation]:
    """Where a joint accelerates harder at a knot than its limit [rad/s^2], (6,)."""
    _, acceleration = joint_rates(np.asarray(time_ns) * 1e-9, np.asarray(joints, float), at_rest)
    return _joints("joint acceleration", np.abs(acceleration), limit, "deg/s^2", 1)


def _joints(kind: str, values: np.ndarray, limit, unit: str, first: int) -> list[Violation]:
    violations = []
    for axis, most in enumerate(np.asarray(limit, float).tolist()):
        what = f"the {kind.split()[1]} of axis {axis + 1}"
        violations += exceeding(kind, values[:, axis], most, what, unit, 180 / np.pi, first=first)
    return violations
