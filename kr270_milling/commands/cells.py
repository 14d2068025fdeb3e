"""The commands about files: ``init`` (a first cell file), ``keys`` (what it may hold), ``stiffness`` (of an arm)."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.draft import draft_text, straight_text
from kr270_milling.cell.keys import keys_of
from kr270_milling.commands.console import Answer, Table
from kr270_milling.commands.identify_options import SIX_AXES
from kr270_milling.robot.analysis import analyse, read_arm
from kr270_milling.trajectory.readers import read_toolpath


def init(args) -> Answer:
    robot = args.robot if args.robot.endswith(".yaml") else f"{args.robot}.yaml"
    find_file(robot)
    if args.gcode is None:
        text, program = straight_text(robot), None
    else:
        path = read_toolpath(args.gcode, args.tool)
        text, program = draft_text(str(Path(args.gcode).resolve()), path, robot), path.program
    return Answer({"cell": text, "program": program and asdict(program)}, [text.removesuffix("\n")])


def keys(args) -> Answer:
    found = keys_of(args.section)
    rows = [("key", "unit", "range", "default", "meaning")]
    for k in found:
        rows.append((k["key"], k["unit"], k["range"], "required" if k["required"] else _shown(k["default"]), k["text"]))
    if args.markdown:
        cells = [[f"`{row[0]}`", *(text.replace("|", "or") for text in row[1:])] for row in rows]
        cells[0][0] = "key"
        lines = ["| " + " | ".join(row) + " |" for row in [cells[0], ["---"] * 5, *cells[1:]]]
    else:  # whole, however wide the terminal is: a key is to be copied
        widths = [*(max(len(row[column]) for row in rows) for column in range(4)), 0]
        lines = ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return Answer({"section": args.section, "keys": found}, lines)


def _shown(default) -> str:
    if default is None:
        return "-"
    if isinstance(default, list):
        return "[" + ", ".join(map(_shown, default)) + "]"
    if isinstance(default, float):
        return f"{default:g}"
    return str(default).lower() if isinstance(default, bool) else str(default) or '""'


def stiffness(args) -> Answer:
    """Pose, Jacobian, Cartesian stiffness (17) and natural frequencies at one posture."""
    arm, mount = read_arm(find_file(args.arm))
    found = analyse(arm, mount, np.radians(args.joints_deg), np.array(args.wrench), args.frame, args.gravity)
    x, y, z = (f"{v:.6f}" for v in found["position_m"])
    least = 1e-9 * np.repeat([np.abs(found["deflection"][k : k + 3]).max() for k in (0, 3)], 3)
    deflection = np.where(np.abs(found["deflection"]) <= least, 0.0, found["deflection"])  # zeros that rounding made
    columns = (np.diag(found["compliance"]), np.diag(found["stiffness"]), deflection)
    rows = [
        [axis, *(f"{value:.4e}" if value else "0" for value in values)]
        for axis, *values in zip(SIX_AXES, *columns, strict=True)
    ]
    title = "Diagonals and deflection under the wrench [m, rad, N]"
    shown = [
        f"{arm.name} at {args.joints_deg} deg, {args.frame} frame, tool point at ({x}, {y}, {z}) m\n",
        Table(title, ["axis", "compliance", "stiffness", "deflection"], rows),
    ]
    for model, values in found["mode_frequencies_hz"].items():
        shown.append(f"natural frequencies, {model} mass: " + ", ".join(f"{v:.2f}" for v in values) + " Hz")
    shown.append(f"condition number of the Jacobian (lengths in m): {found['condition_number']:.1f}")
    return Answer(found, [*shown, *(f"warning: {warning}" for warning in found["warnings"])])
