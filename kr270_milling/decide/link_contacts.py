"""Contacts of the links of the arm with each other, with the box of the stock, fixtures and the table.

Each solid of the URDF contains a capsule: a segment with a radius. Distances are those of capsules from boxes and from
each other. The distance from a convex body is a convex function along a segment, so its least value is bracketed.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from kr270_milling.base.blocks import blocks
from kr270_milling.base.frames import Pose
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import arm_of
from kr270_milling.decide.findings import Finding, violation
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.robot.kinematics import forward
from kr270_milling.physics.robot.urdf import LINKS, link_capsules

WAY = 5e-3  # [m] of the tip between two postures that are compared
TURN = 0.3  # [m], assumed: a turn of the tool by an angle counts as a way on this radius
STOCK = "the box of the uncut stock"
APART = 3  # links in the chain from a link to the nearest link with which it is compared


def link_contacts(cell: Cell, run: Trajectory) -> list[Finding]:
    """Return the deepest contact of each link with each obstacle along a trajectory that the arm can follow."""
    placed, stamps = arm_of(cell), _stamps(run)
    capsules = link_capsules(cell.arm, cell.mount, cell.tool.stick_out)
    turned, obstacles = placed.place.inverse(), _obstacles(cell)
    deepest: dict[tuple[str, str], tuple[float, int]] = {}
    for part in blocks(len(stamps)):
        frames = forward(cell.arm, cell.mount, placed.joints_along(run, stamps[part]))
        links = [Pose(frames.nodes[:, k], frames.rotations[:, k]) for k in range(6)]
        base = Pose(0.0 * frames.flange.position, np.eye(3))
        in_part = [turned @ frame for frame in (base, *links, frames.flange, frames.tool)]
        moved = [(k, in_part[k].apply(start), in_part[k].apply(end), radius) for k, start, end, radius in capsules]
        pairs = []
        for link, start, end, radius in moved:
            for name, box in obstacles if link else ():
                pairs.append((LINKS[link], name, radius - _nearest(start, end, _from_box, *box)))
            for other, first, last, wide in moved:
                if min(other, 6) - min(link, 6) >= APART:
                    away = _nearest(start, end, _from_segment, first, last)
                    pairs.append((LINKS[other], LINKS[link], radius + wide - away))
        for body, obstacle, depth in pairs:
            k = int(np.argmax(depth))
            if depth[k] > deepest.get((body, obstacle), (0.0, 0))[0]:
                deepest[body, obstacle] = float(depth[k]), int(stamps[part][k])
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
    cosine = np.abs(np.einsum("ij,ij->i", run.quaternion[1:], run.quaternion[:-1]))
    turn = 2.0 * np.arccos(np.minimum(cosine, 1.0))
    way = np.linalg.norm(np.diff(run.position, axis=0), axis=1) + TURN * turn
    length = np.concatenate([[0.0], np.cumsum(way)])
    count = 2 + math.ceil(length[-1] / WAY)
    return np.rint(np.interp(np.linspace(0.0, length[-1], count), length, run.time_ns)).astype(np.int64)


def _obstacles(cell: Cell) -> list[tuple[str, tuple[np.ndarray, np.ndarray]]]:
    """Return name, lower and upper corner [m] of stock, fixtures and the table below them, workpiece frame."""
    boxes = [(STOCK, (cell.stock.min, cell.stock.max))]
    boxes += [(f"fixture {k}", (low, high)) for k, (low, high) in enumerate(cell.workpiece.fixture_boxes, 1)]
    top, thick = cell.workpiece.table_z, 0.05  # [m], assumed: thickness of a table
    if not math.isnan(top):
        low, high = np.min([b[1][0] for b in boxes], axis=0), np.max([b[1][1] for b in boxes], axis=0)
        boxes.append(
            ("the table below stock and fixtures", (np.array([*low[:2], top - thick]), np.array([*high[:2], top])))
        )
    return boxes


def _nearest(start: np.ndarray, end: np.ndarray, distance: Callable[..., np.ndarray], *body: np.ndarray) -> np.ndarray:
    """Return the least distance(points, *body) [m] of segments from start to end (n, 3) from a convex body, (n,)."""
    low, high = np.zeros((len(start), 1)), np.ones((len(start), 1))
    for _ in range(12):  # (2/3)^12: 1 % of the length, whose error in the distance is of second order
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
