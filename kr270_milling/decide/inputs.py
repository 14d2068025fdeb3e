"""Checks of the inputs: numbers that no arm, tool or material has, and a cell that is not the cell of the program."""

from __future__ import annotations

import functools
import math

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.frames import TOOL0, Pose, tool_axis
from kr270_milling.base.record import specs
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.decide.findings import Finding, violation
from kr270_milling.path.cam.comments import AXIAL_KINDS
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.physics.cutting import LinearEdgeLaw
from kr270_milling.physics.cutting.laws import materials

#: [rad] assumed: usual angles of a spindle from the axis of the flange, and how far bracket and calibration miss them
MOUNTINGS, OFF_MOUNTING = np.radians([0.0, 30.0, 45.0, 60.0, 90.0]).tolist(), math.radians(5.0)
SAME_PLACE, SAME_ANGLE = 0.1e-3, 0.01  #: [m], [deg] assumed: rounding and calibration of one frame
HANGING = math.radians(100.0)  #: assumed: of z of the workpiece from straight up; tables and angle plates carry parts
BEHIND = 1e-3  #: [m] that a calibrated tip may be behind the flange: the wrist is there
#: section -> names of limits that neither arm nor spindle states -> 1: a larger limit finds less, -1: a smaller one
LOOSER = {
    "limits": {
        "wrist_angle": -1, "elbow_angle": -1, "shoulder_distance": -1, "blending_share": 1, "rapid_contact": 1
    },
    "exchange": {"stop_correction": 1},
}  # fmt: skip


def input_violations(cell: Cell) -> list[Finding]:
    """Everything that is wrong or unlikely in the parameter file, and between the cell and its program."""
    of_arm = _unlikely_arm(cell) + _placement(cell) + _posture(cell) + _loose(cell)
    return of_arm + _safe_height(cell) + _material(cell) + _frames(cell) + _program(cell)


def _unlikely_arm(cell: Cell) -> list[Finding]:
    arm, mass = cell.arm, cell.mount.mass
    # [rad/(N m)], joint compliances of heavy arms lie at 0.1 to 10 urad/(N m) (Table 1 of [Klimchik2014]: 0.15 to 2.13)
    compliance = 1e-8, 1e-4
    # [kg], links of arms that carry a milling spindle (Table 1: 18 to 337)
    link_mass = 1.0, 2e3
    findings = _unlikely("compliance", arm.joint_compliance, compliance) + _unlikely("mass", arm.link_mass, link_mass)
    if arm.payload and mass > arm.payload:
        findings.append(violation("payload", mass, arm.payload))
    return findings + _mounting(cell)


def _loose(cell: Cell) -> list[Finding]:
    """Limits that find less than their defaults."""
    findings = []
    for section, names in LOOSER.items():
        record = getattr(cell, section)
        for spec in specs(type(record)):
            value, default = getattr(record, spec.name), spec.default
            if names.get(spec.name, 0) * (value - default) > 1e-9 * default:
                key, value, default = f"{section}.{spec.key}", value / spec.scale, default / spec.scale
                findings.append(violation("loose limit", value, default, key=key, subject=key))
    return findings


def _mounting(cell: Cell) -> list[Finding]:
    """A spindle that points into the arm or in a direction in which none is mounted, a tip behind the flange."""
    mount = cell.mount
    turn = float(np.arccos(np.clip(mount.pose.rotation[0, 2], -1.0, 1.0)))  # of z of tcp from x of flange
    nearest = min(MOUNTINGS, key=lambda angle: abs(angle - turn))
    findings = []
    if abs(turn - nearest) > OFF_MOUNTING:
        into = turn > max(MOUNTINGS)
        words = ", back into the arm" if into else "; spindles are mounted at 0, 30, 45, 60 or 90 deg"
        findings.append(violation("spindle direction", turn, nearest, words=words))
    behind = {
        "behind the flange": -mount.xyz[0],
        "behind the flange, along the axis of the spindle": -mount.pose.rotation[:, 2] @ mount.xyz,
    }
    away, nearest_tip = float(np.linalg.norm(mount.xyz)), 10e-3  # [m]: no spindle is so short
    for words, distance in behind.items():
        if distance > BEHIND:
            return [*findings, violation("tool tip", distance, BEHIND, words=words)]
    if 0.0 < away < nearest_tip:  # 0: the cell has no tool
        findings.append(violation("tool tip", away, nearest_tip, words="from the centre of the flange; in m?"))
    return findings


def _safe_height(cell: Cell) -> list[Finding]:
    """A motion between home and path that passes near the stock, or below the top of a fixture."""
    least = 5e-3  # [m], assumed: of a PTP motion, whose path is not straight
    tops = {"the stock": float(cell.stock.max[2])}
    tops |= {f"fixture {n}": float(most[2]) for n, (_, most) in enumerate(cell.workpiece.fixture_boxes, 1)}
    name = max(tops, key=lambda name: tops[name])
    height = tops["the stock"] + cell.krl.safe_height - tops[name]
    if height >= least:
        return []
    words = f"{'below' if height < 0.0 else 'above'} the top of {name}"
    return [violation("safe height", abs(height), least, words=words)]


def _frames(cell: Cell) -> list[Finding]:
    """$TOOL and $BASE of a KRL program that are not those of the cell."""
    fed = path_of(cell).fed
    program = fed.toolpath.program if fed else None
    if program is None:
        return []
    findings = []
    for name, key, frame, own in (
        ("$TOOL", "mount.tool_kuka", program.tool_frame, TOOL0.inverse() @ cell.mount.pose),
        ("$BASE", "workpiece.base_kuka", program.base_frame, cell.workpiece.pose),
    ):
        if frame:
            between = Pose.from_abc(1e-3 * np.array(frame[:3]), np.radians(frame[3:])).inverse() @ own
            away = float(np.linalg.norm(between.position))
            degrees = float(np.degrees(Rotation.from_matrix(between.rotation).magnitude()))
            if away > SAME_PLACE or degrees > SAME_ANGLE:
                amounts = {"degrees": degrees}
                findings.append(violation("frame of the program", away, 0.0, amounts=amounts, name=name, key=key))
    return findings


def _unlikely(kind: str, values: np.ndarray, bounds: tuple[float, float]) -> list[Finding]:
    """The first value that is not within the bounds."""
    over = np.flatnonzero(~((values >= bounds[0]) & (values <= bounds[1])))
    return [violation(kind, values[k], bounds[int(values[k] > bounds[1])], number=k + 1) for k in over[:1]]


def _placement(cell: Cell) -> list[Finding]:
    """A workpiece out of reach, a grid that is too coarse for the tool."""
    widest_grid = 0.05  # of the tool's radius: with fewer nodes across a cut its force is noise
    arm, step, widest = cell.arm, cell.stock.grid_step, widest_grid * cell.tool.radius
    reach = arm.a1 + arm.a2 + arm.forearm + arm.d6 + float(np.linalg.norm(cell.mount.xyz))
    away = float(np.hypot(*cell.workpiece.xyz[:2]))
    findings = []
    if step > widest:
        findings.append(violation("tool and grid", step, widest, diameter=1e3 * cell.tool.diameter))
    if away > reach:
        findings.append(violation("envelope", away, reach))
    turn = float(np.arccos(np.clip(cell.workpiece.pose.rotation[2, 2], -1.0, 1.0)))
    if turn > HANGING:
        findings.append(violation("workpiece direction", turn, HANGING))
    return findings


def _posture(cell: Cell) -> list[Finding]:
    """Joints outside the limits, or all so small that they must be radians."""
    q, arm = np.asarray(arm_of(cell).posture), cell.arm
    key = "start_joints_deg" if cell.start_joints.size else "posture_hint_deg"
    beyond = np.maximum(q - arm.joint_upper, arm.joint_lower - q)
    k = int(np.argmax(beyond))
    degrees = np.degrees(np.abs(q))
    if beyond[k] > 0.0:
        limit = arm.joint_upper[k] if q[k] > arm.joint_upper[k] else arm.joint_lower[k]
        reason = f"axis {k + 1} is at {np.degrees(q[k]):.4g} deg"
        return [violation("posture", q[k], limit, key=key, reason=reason)]
    if np.any(degrees > 0.0) and np.all(degrees <= 2.0 * np.pi) and np.any(degrees % 1.0 > 1e-9):
        reason = f"all within {degrees.max():.3g} deg, as radians would be"
        return [violation("posture", np.radians(degrees.max()), np.radians(2.0 * np.pi), key=key, reason=reason)]
    return []


@functools.cache
def _published() -> tuple[float, float]:
    """The least and the largest K_tc of ``config/materials.csv`` [N/m^2]."""
    values = [float(row.values[0]) for row in materials()]
    return min(values), max(values)


def _material(cell: Cell) -> list[Finding]:
    """K_tc far from those of all published rows: a unit has slipped, or the material is another one."""
    law = cell.cutting.active
    if not isinstance(law, LinearEdgeLaw):
        return []
    material_range = 0.3, 3.0  # factors of the least and the largest published K_tc; beyond them a unit has slipped
    low, high = (factor * value for factor, value in zip(material_range, _published(), strict=True))
    value = law.tangential_cutting
    if low <= value <= high:
        return []
    return [violation("force coefficient", value, low if value < low else high, low=1e-6 * low, high=1e-6 * high)]


def _program(cell: Cell) -> list[Finding]:
    """Return contradictions between the cell and the program of ``path.file``."""
    fed = path_of(cell).fed
    if fed is None:
        return []
    path = fed.toolpath
    findings = _outside(cell, path)
    tool = path.program.current
    silent = path.program.tools and not path.spindle_speed[~path.rapid].any()
    if silent and not cell.krl.spindle_on:
        block = int(np.flatnonzero(~path.rapid[1:])[0]) + 1
        findings.append(violation("spindle off", 0.0, cell.tool.spindle_speed, block=block))
    if path.program.beside:
        block = int(np.flatnonzero(~path.rapid[1:])[0]) + 1
        label = tool.label if tool and tool.label else "the tool"
        findings.append(violation("cutter radius", path.program.beside, 0.0, block=block, label=label))
    findings += [
        violation(kind, 1.0, 0.0, sentence=sentence, line=line) for kind, sentence, line in path.program.doubtful
    ]
    for axes, height, line in path.program.sideways:
        if (depth := float(cell.stock.max[2]) - height) > 1e-6:  # rounding of a height
            findings.append(violation("home sideways", depth, 0.0, line=line, axes=axes))
    if path.drilling.any():
        block = int(np.argmax(path.drilling))
        holes = int(np.sum(path.drilling[1:] & ~path.drilling[:-1]))
        number = f"{holes} hole" + "s" * (holes > 1)
        findings.append(violation("drilling", float(holes), 0.0, block=block, number=number))
    if tool is None:
        return findings
    if tool.changed_as == "T0":
        findings.append(violation("no tool", 0.0, 1.0, line=tool.line, label="T0"))
    diameter_rounding = 20e-6  # [m], of a diameter in a comment: 0.394 in for 10 mm
    if tool.diameter and abs(tool.diameter - cell.tool.diameter) > diameter_rounding:
        reground = 0.02  # share of the diameter that regrinding takes; a larger difference is another tool
        other = abs(tool.diameter - cell.tool.diameter) > reground * tool.diameter
        severity = "stop" if other else "warning"
        findings.append(
            violation(
                "tool diameter", cell.tool.diameter, tool.diameter, severity=severity, line=tool.line, label=tool.label
            )
        )
    if cell.stage and cell.stage.same_tip and not tool.length_offset:
        x, y, z = 1e3 * cell.mount.xyz
        tip = f"[{x:g}, {y:g}, {z:g}]"
        findings.append(violation("tool length", 0.0, 0.0, line=tool.line, label=tool.label, tip=tip))
    if tool.shape and cell.tool.type == "program" and not (tool.shape in AXIAL_KINDS and _along_axis(cell, path)):
        article = "an" if tool.shape[0] in "aeiou" else "a"
        findings.append(
            violation(
                "tool shape",
                tool.corner_radius,
                0.0,
                line=tool.line,
                label=tool.label,
                shape=tool.shape,
                article=article,
            )
        )
    return findings


def _along_axis(cell: Cell, path: Toolpath) -> bool:
    """Return whether the tool makes no sideways feed move below the top of the stock."""
    low = np.minimum(path.position[1:, 2], path.position[:-1, 2]) < cell.stock.max[2] - 1e-6
    return not (_sideways(path)[1:] & low & ~path.rapid[1:]).any()


def _sideways(path: Toolpath) -> np.ndarray:
    """Return the blocks that do not lead along the axis of the tool, (n,)."""
    move, axes = np.diff(path.position, axis=0, prepend=path.position[:1]), tool_axis(path.quaternion)
    along = np.einsum("ij,ij->i", move, axes)
    # a program rounds the moves of a tilted tool
    return np.linalg.norm(move - along[:, None] * axes, axis=1) > np.maximum(1e-6, 1e-3 * np.abs(along))


def _outside(cell: Cell, path: Toolpath) -> list[Finding]:
    """Features whose cutting moves never pass over the stock, and a path that is outside of the stock mostly."""
    most_outside = 0.5  # share of the cutting moves outside of the stock; leads and overlaps take less
    low, high, radius = cell.stock.min, cell.stock.max, float(cell.tool.radii.max())
    places = 100_000  # of a path, at most
    distance = np.linspace(0.0, path.length, 2 + min(places, int(4.0 * path.length / radius)))
    position, block = path.position_at(distance), path.block_at(distance)
    cuts = ~path.rapid[block]
    away = np.hypot(*(position[:, :2] - np.clip(position[:, :2], low[:2], high[:2])).T)
    outside = away >= radius
    findings = []
    numbers, sideways = np.unique(path.feature[block[cuts]]).tolist(), _sideways(path) | path.drilling
    for number in numbers:
        mine = cuts & (path.feature[block] == number)
        moves = np.unique(block[mine])  # one along the axis: a robot program feeds to its first point
        if outside[mine].all() and (len(moves) > 1 or sideways[moves].any() or len(numbers) == 1):
            name = path.features[number] or "the path"
            first = int(np.flatnonzero(mine)[0])
            nearest = float(away[mine].min()) - radius
            findings.append(violation("outside the stock", nearest, 0.0, block=int(block[first]), subject=name))
    share = float(np.mean(outside[cuts])) if cuts.any() else 0.0
    if not findings and share > most_outside:
        first = int(np.flatnonzero(cuts & outside)[0])
        findings.append(violation("stock too small", share, most_outside, block=int(block[first])))
    return findings
