"""Checks of the arm along a path: what it does, what its links touch, and how large and hasty a correction is.

Knots that offend one after another make one violation, named by the worst of them; points are counted from 1.

Contacts of the links of the arm with each other, with the box of the stock, fixtures and the table: each solid of the
URDF contains a capsule, a segment with a radius. Distances are those of capsules from boxes and from each other. The
distance from a convex body is a convex function along a segment, so its least value is bracketed.

Where the load on a joint reverses, its backlash moves the tool.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from kr270_milling.base.blocks import blocks
from kr270_milling.base.frames import Pose, rotation_from_quaternion
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.paths import CellPath
from kr270_milling.cell.plant import joint_gaps
from kr270_milling.cell.sections import Limits, Workpiece
from kr270_milling.decide.findings import Finding, violation, violations
from kr270_milling.path.controller_motion import places_on_program
from kr270_milling.path.timing import joint_rates
from kr270_milling.path.trajectory import Trajectory, offsets
from kr270_milling.physics.cutting import Stock
from kr270_milling.physics.motion.backlash import tool_jumps
from kr270_milling.physics.robot import Arm, singularity_measures, status_turn
from kr270_milling.physics.robot.arm import ASSUMED_BACKLASH
from kr270_milling.physics.robot.errors import JointLimitError, ReachError, SingularityError
from kr270_milling.physics.robot.inverse import branches
from kr270_milling.physics.robot.kinematics import forward
from kr270_milling.physics.robot.urdf import LINKS, link_capsules


def arm_violations(placed: PlacedArm, limits: Limits, run: Trajectory) -> tuple[list[Finding], np.ndarray | None]:
    """The findings about the arm, and the joint positions [rad], (n, 6); None where a point is out of reach."""
    results, joints = reach_violations(placed, run)
    return results if joints is None else results + motion_violations(placed.arm, limits, run, joints), joints


def reach_violations(placed: PlacedArm, run: Trajectory) -> tuple[list[Finding], np.ndarray | None]:
    """The findings of ``arm_violations`` about reach and joint limits, and the joint positions."""
    most_turned = 4 * np.pi  # [rad], of joints that have no limits
    arm = placed.arm
    unlimited = arm.replace(joint_lower=np.full(6, -most_turned), joint_upper=np.full(6, most_turned))
    try:
        try:
            joints = placed.joints(run)
        except JointLimitError:
            joints = dataclasses.replace(placed, arm=unlimited).joints(run)
    except ReachError:
        results = _reach(placed, run)
        if not results:  # of this branch alone
            raise
        return results, None
    except SingularityError as error:
        point = (*error.index, 0)[0] + 1
        stuck = violation("singularity", error.measure, 0.0, point, sentence=f"point {point}: {error}")
        return _reach(placed, run) or [stuck], None
    return _joint_limits(arm, joints), joints


def motion_violations(arm: Arm, limits: Limits, run: Trajectory, joints: np.ndarray) -> list[Finding]:
    """The findings about singularities, flips, speeds and accelerations at joint positions [rad], (n, 6)."""
    at_rest = run.velocity is not None and not run.velocity[[0, -1]].any()
    rates = _joint_rates(run.time, joints, arm.joint_speed_limit, arm.joint_acceleration_limit, at_rest)
    return _singularities(arm, limits, joints) + _flips(arm, joints) + rates


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
        if low <= angle.min() and angle.max() <= high:
            continue
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


STOCK = "the box of the uncut stock"


def link_contacts(
    placed: PlacedArm, stick_out: float, workpiece: Workpiece, stock: Stock, run: Trajectory
) -> list[Finding]:
    """Return the deepest contact of each link with each obstacle along a trajectory that the arm can follow.

    stick_out: of the tool [m]; stock, workpiece: box of the uncut stock, fixtures and table.
    """
    arm, mount, stamps = placed.arm, placed.mount, _stamps(run)
    capsules = link_capsules(arm, mount, stick_out)
    turned, obstacles = placed.place.inverse(), _obstacles(workpiece, stock)
    deepest: dict[tuple[str, str], tuple[float, int]] = {}
    every = 32  # stamps of which one is compared, and the others where the way from there may lead to a contact
    for part in blocks(len(stamps)):
        frames = forward(arm, mount, placed.joints_along(run, stamps[part]))
        links = [Pose(frames.nodes[:, k], frames.rotations[:, k]) for k in range(6)]
        base = Pose(0.0 * frames.flange.position, np.eye(3))
        in_part = [turned @ frame for frame in (base, *links, frames.flange, frames.tool)]
        moved = [(k, in_part[k].apply(start), in_part[k].apply(end), radius) for k, start, end, radius in capsules]
        coarse = np.arange(len(stamps[part])) // every * every
        ways = [
            np.maximum(*(np.linalg.norm(place - place[coarse], axis=1) for place in (start, end)))
            for _, start, end, _ in moved
        ]
        pairs: list[tuple] = []
        for (link, start, end, radius), way in zip(moved, ways, strict=True):
            for name, box in obstacles if link else ():
                corners = (np.broadcast_to(corner, start.shape) for corner in box)
                pairs.append((LINKS[link], name, radius, way, _from_box, (start, end, *corners)))
            for (other, first, last, wide), more in zip(moved, ways, strict=True):
                # links in the chain from a link to the nearest link with which it is compared
                if min(other, 6) - min(link, 6) >= 3:
                    ends = start, end, first, last
                    pairs.append((LINKS[other], LINKS[link], radius + wide, way + more, _from_segment, ends))
        for body, obstacle, reach, way, distance, places in pairs:
            known = deepest.get((body, obstacle), (0.0, 0))[0]
            start, end, *other = places
            half = 0.5 * np.linalg.norm(end - start, axis=1)  # no place of a segment is farther from its middle
            if (reach + half - distance(0.5 * (start + end), *other)).max() <= known:
                continue
            depth = reach - _nearest(distance, *(place[::every] for place in places))
            near = np.flatnonzero(depth[coarse // every] + way > known)
            depth = reach - _nearest(distance, *(place[near] for place in places))
            k = int(np.argmax(depth)) if near.size else 0
            if near.size and depth[k] > known:
                deepest[body, obstacle] = float(depth[k]), int(stamps[part][near[k]])
    return [
        violation(
            "link contact",
            depth,
            0.0,
            int(np.clip(np.searchsorted(run.time_ns, stamp), 0, len(run) - 1)) + 1,
            severity="warning" if obstacle == STOCK else "stop",
            subject=obstacle,
            body=body,
        )
        for (body, obstacle), (depth, stamp) in deepest.items()
    ]


def _stamps(run: Trajectory) -> np.ndarray:
    """Stamps [ns] on a trajectory, WAY apart."""
    spacing = 5e-3  # [m] of the tip between two postures that are compared
    way = np.linalg.norm(np.diff(run.position, axis=0), axis=1)
    if run.turns:
        cosine = np.abs(np.einsum("ij,ij->i", run.quaternion[1:], run.quaternion[:-1]))
        # [m], assumed: a turn of the tool by an angle counts as a way on this radius
        way += 0.3 * 2.0 * np.arccos(np.minimum(cosine, 1.0))
    length = np.concatenate([[0.0], np.cumsum(way)])
    count = 2 + math.ceil(length[-1] / spacing)
    return np.rint(np.interp(np.linspace(0.0, length[-1], count), length, run.time_ns)).astype(np.int64)


def _obstacles(workpiece: Workpiece, stock: Stock) -> list[tuple[str, tuple[np.ndarray, np.ndarray]]]:
    """Return name, lower and upper corner [m] of stock, fixtures and the table below them, workpiece frame."""
    boxes = [(STOCK, (stock.min, stock.max))]
    boxes += [(f"fixture {k}", (low, high)) for k, (low, high) in enumerate(workpiece.fixture_boxes, 1)]
    top, thick = workpiece.table_z, 0.05  # [m], assumed: thickness of a table
    if not math.isnan(top):
        low, high = np.min([b[1][0] for b in boxes], axis=0), np.max([b[1][1] for b in boxes], axis=0)
        boxes.append(
            ("the table below stock and fixtures", (np.array([*low[:2], top - thick]), np.array([*high[:2], top])))
        )
    return boxes


def _nearest(distance: Callable[..., np.ndarray], start: np.ndarray, end: np.ndarray, *body: np.ndarray) -> np.ndarray:
    """Return the least distance(points, *body) [m] of segments from start to end (n, 3) from a convex body, (n,)."""
    low, high = np.zeros((len(start), 1)), np.ones((len(start), 1))
    for _ in range(20):  # (2/3)^20: 0.03 % of the length, of first order where the segment meets an edge
        first, second = low + (high - low) / 3.0, high - (high - low) / 3.0
        near, far = (distance(start + share * (end - start), *body)[:, None] for share in (first, second))
        nearer = near < far
        low, high = np.where(nearer, low, first), np.where(nearer, second, high)
    return distance(start + 0.5 * (low + high) * (end - start), *body)


def _from_box(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return the distance of points (n, 3) from a box [m], negative inside."""
    beyond = np.maximum(low - points, points - high)
    return np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0)


def _from_segment(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the distance of points (n, 3) from segments (n, 3) to (n, 3) [m]."""
    along = end - start
    share = np.einsum("ij,ij->i", points - start, along) / np.maximum(np.einsum("ij,ij->i", along, along), 1e-12)
    return np.linalg.norm(points - start - np.clip(share, 0.0, 1.0)[:, None] * along, axis=1)


ARCSEC = math.pi / 648000  # [rad]


def load_reversals(arm: PlacedArm, path: CellPath, run: Trajectory, ran: ScoredPass) -> list[Finding]:
    """Each change of a flank under weight, inertia of the path and the cut of the simulated pass, in the order of time.

    The gaps are those of a plant whose joints have ``arm.backlash``; see ``physics.motion.backlash``.
    """
    width, result = arm.arm.backlash, ran.result
    places = []
    least_jump = 1e-7  # [m], of the tool; a smaller jump shows nowhere
    for step, joint, jump in tool_jumps(joint_gaps(arm, path, run, width, result.every), result.wrench):
        if jump < least_jump:
            continue
        point = int(np.clip(np.searchsorted(run.time_ns, result.time_ns[step]), 0, len(run) - 1)) + 1
        amounts = {"arcsec": float(width[joint] / ARCSEC), "friction_n_m": float(arm.arm.friction_torque[joint])}
        source = " (assumed)" if math.isclose(width[joint], ASSUMED_BACKLASH[joint]) else " (arm.backlash_arcsec)"
        places.append(
            violation("load reversal", jump, 0.0, point, subject=f"axis {joint + 1}", amounts=amounts, source=source)
        )
    return places


def backlash_statement(
    backlash: np.ndarray, shares: tuple[float, float], reversals: Sequence[Finding] | None, drawn: bool
) -> str:
    """Return whether the decision includes the backlash [rad], (6,).

    shares: smallest and largest multiple of it in a plant; drawn: a verdict with plants was made.
    """
    least, most = (share * float(backlash.max()) / ARCSEC for share in shares)
    if not backlash.any():
        return "backlash: none (arm.backlash_arcsec is 0)"
    if drawn and most:
        return f"backlash: in the verdict only, {least:.3g} to {most:.3g} arcsec"
    if not reversals:
        return f"backlash: not included{'' if reversals is None else ', no load reverses'}"
    largest = max(finding.value for finding in reversals)
    places = f"{len(reversals)} place{'s' * (len(reversals) > 1)}"
    return f"backlash: not included, up to {largest:.3g} um where the load on an axis reverses ({places})"
