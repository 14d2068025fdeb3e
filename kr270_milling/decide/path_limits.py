"""Checks of a path by itself: what the arm does along it, and how large and hasty a correction is.

Knots that offend one after another make one violation, named by the worst of them; points are counted from 1.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from kr270_milling.base.blocks import blocks
from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.sections import Limits
from kr270_milling.decide.findings import Finding, violation, violations
from kr270_milling.path.controller_motion import places_on_program
from kr270_milling.path.timing import joint_rates
from kr270_milling.path.trajectory import Trajectory, offsets
from kr270_milling.physics.robot import Arm, singularity_measures, status_turn
from kr270_milling.physics.robot.errors import SingularityError
from kr270_milling.physics.robot.inverse import branches

MOST_TURNED = 4 * np.pi  #: [rad], of joints that have no limits


def arm_violations(placed: PlacedArm, limits: Limits, run: Trajectory) -> tuple[list[Finding], np.ndarray | None]:
    """The findings about the arm, and the joint positions [rad], (n, 6); None where a point is out of reach."""
    arm = placed.arm
    results = _reach(placed, run)
    if results:
        return results, None
    unlimited = arm.replace(joint_lower=np.full(6, -MOST_TURNED), joint_upper=np.full(6, MOST_TURNED))
    try:
        joints = dataclasses.replace(placed, arm=unlimited).joints(run)
    except SingularityError as error:
        point = error.index[0] + 1
        return [violation("singularity", error.measure, 0.0, point, sentence=f"point {point}: {error}")], None
    at_rest = run.velocity is not None and not run.velocity[[0, -1]].any()
    results = _joint_limits(arm, joints) + _singularities(arm, limits, joints) + _flips(arm, joints)
    rates = _joint_rates(run.time, joints, arm.joint_speed_limit, arm.joint_acceleration_limit, at_rest)
    return results + rates, joints


def _reach(placed: PlacedArm, run: Trajectory) -> list[Finding]:
    arm = placed.arm
    lost, nearest = np.zeros(len(run), bool), np.zeros(len(run))
    for part in blocks(len(run)):
        tool = Pose(run.position[part], rotation_from_quaternion(run.quaternion[part]))
        angles, distance = branches(arm, placed.mount, placed.place @ tool, placed.posture)
        lost[part], nearest[part] = ~np.isfinite(angles).all(-1).any(-1), distance.min(-1)
    least, most = abs(arm.a2 - arm.forearm), arm.a2 + arm.forearm
    worst = np.maximum(nearest - most, least - nearest)
    return violations("reach", nearest, most, lost, worst=worst, least=least)


def _joint_limits(arm: Arm, joints: np.ndarray) -> list[Finding]:
    results = []
    for axis, (low, high) in enumerate(zip(arm.joint_lower, arm.joint_upper, strict=True)):
        angle = joints[:, axis]
        beyond = np.maximum(angle - high, low - angle)
        results += violations(
            "joint limit",
            angle,
            np.where(angle > high, high, low),
            beyond > 1e-12,
            worst=beyond,
            subject=f"axis {axis + 1}",
            low=np.degrees(low),
            high=np.degrees(high),
        )
    return results


def _singularities(arm: Arm, limits: Limits, joints: np.ndarray) -> list[Finding]:
    parts = [singularity_measures(arm, joints[part]) for part in blocks(len(joints))]
    measures = np.concatenate(parts) * [arm.a2 + arm.forearm, 1.0, 1.0]
    elbow, wrist = np.arcsin(np.minimum(measures[:, 1:], 1.0)).T
    rows = [
        ("shoulder", measures[:, 0], limits.shoulder_distance, 1e3, "mm from axis 1 to the wrist centre"),
        ("elbow", elbow, limits.elbow_angle, 180 / np.pi, "deg of the stretched arm"),
        ("wrist", wrist, limits.wrist_angle, 180 / np.pi, "deg of A5"),
    ]
    results = []
    for which, value, least, scale, unit in rows:
        words = dict(subject=which, measure=value * scale, wanted=least * scale, of=unit)
        results += violations("singularity", value, least, value < least, worst=-value, **words)
    return results


def _flips(arm: Arm, joints: np.ndarray) -> list[Finding]:
    status = np.concatenate([status_turn(arm, joints[part])[0] for part in blocks(len(joints))])
    return [
        violation("configuration flip", int(status[k]), int(status[k - 1]), k + 1, before=k)
        for k in (np.flatnonzero(np.diff(status)) + 1).tolist()
    ]


def _joint_rates(time, joints, speed_limit, acceleration_limit, at_rest: bool) -> list[Finding]:
    """Where a joint runs faster between two knots (named by the later one), or accelerates harder, than it may.

    time [s], (n,); joints [rad], (n, 6); limits [rad/s], [rad/s^2], (6,); at_rest: as for ``joint_rates``.
    """
    points = np.arange(1, len(joints) + 1)
    results: tuple[list[Finding], ...] = [], []
    kinds = ("joint speed", speed_limit), ("joint acceleration", acceleration_limit)
    for axis in range(joints.shape[1]):
        rates = joint_rates(time, joints[:, axis : axis + 1], at_rest)
        for (kind, limits), values, of_kind in zip(kinds, rates, results, strict=True):
            where = points[-len(values) :]
            of_kind += violations(kind, np.abs(values[:, 0]), limits[axis], points=where, axis=f"axis {axis + 1}")
    return [*results[0], *results[1]]


def correction_size(original: Trajectory, revised: Trajectory, tick_ns: int, limit: float) -> list[Finding]:
    """Check the size of the correction [m] at a knot or at a tick on the way to it."""
    time_ns, shift, _ = offsets(original, revised, tick_ns)
    size = np.linalg.norm(revised.position - original.position, axis=1)
    size = np.fmax(size, _on_the_way(original, time_ns, np.linalg.norm(shift, axis=1)))
    return violations("correction size", size, limit)


def correction_per_tick(original: Trajectory, revised: Trajectory, tick_ns: int, limit: float) -> list[Finding]:
    """Check the change of the correction [m] from one tick to the next."""
    time_ns, shift, _ = offsets(original, revised, tick_ns)
    change = np.linalg.norm(np.diff(shift, axis=0), axis=1)
    return violations("correction per tick", _on_the_way(original, time_ns[1:], change), limit)


def _on_the_way(original: Trajectory, time_ns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The largest value of the ticks that lead to each knot, (n,)."""
    largest = np.zeros(len(original))
    np.maximum.at(largest, np.clip(np.searchsorted(original.time_ns, time_ns), 1, len(original) - 1), values)
    return largest


def corner_blending(
    original: Trajectory,
    revised: Trajectory,
    blend_distance: float,
    share=0.5,
    points: np.ndarray | None = None,
    auxiliary: np.ndarray | None = None,
) -> list[Finding]:
    """Check the share of the correction [m] at a point that the controller's blending of LIN and CIRC rounds off.

    The path through the points is that of ``places_on_program``. Points where the tool stops are not blended. points:
    the knots that are points, None: all; auxiliary: those that are auxiliary points of arcs, None: none.
    """
    points = np.arange(len(revised)) if points is None else points
    stops, inner = original.standing[points], points[1:-1]
    place = places_on_program(revised, points, revised.position[points], stops, False, blend_distance, auxiliary)
    rounded = np.linalg.norm(place - revised.position, axis=1)[inner]
    correction = np.linalg.norm(revised.position - original.position, axis=1)[inner]
    least_rounding = 1e-7  # [m], of a corner; less is no matter
    ratio = np.where(rounded < least_rounding, 0.0, rounded / np.maximum(correction, 1e-9))
    return violations("corner blending", ratio, share, points=inner + 1)
