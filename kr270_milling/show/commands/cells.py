"""The commands about files: ``init`` (a first cell file), ``keys`` (what it may hold), ``stiffness`` (of an arm)."""

from __future__ import annotations

import contextlib
import json
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

from kr270_milling.base.column import TextTable, counted
from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.files import write_files
from kr270_milling.base.parameter_file import find_file, read_tree
from kr270_milling.base.record import build
from kr270_milling.cell.cell_file import read_cells
from kr270_milling.cell.draft import draft, straight_text
from kr270_milling.cell.keys import keys_of, schema
from kr270_milling.decide.programs.files import kuka_frames
from kr270_milling.path.cam.readers import read_toolpaths
from kr270_milling.path.kinematics import Kinematics
from kr270_milling.physics.robot.analysis import analyse, read_arm
from kr270_milling.show.commands.console import Answer


def run_init(args) -> Answer:

    robot = args.robot if args.robot.endswith(".yaml") else f"{args.robot}.yaml"
    machine = build(Kinematics, read_tree(find_file(robot)).get("machine", {}), robot, "machine.")
    program, warnings = None, list[str]()
    if args.gcode is None:
        text = straight_text(robot)
    else:
        paths = read_toolpaths(args.gcode, args.tool, machine)
        program, file, folder = paths[0].program, Path(args.gcode).resolve(), Path(args.out or ".").resolve().parent
        if args.out and file.is_relative_to(folder):  # the cell names a program below its folder by the relative path
            file = file.relative_to(folder)
        text, warnings = draft(str(file), paths, robot)
        for warning in () if args.json else warnings:
            print(f"warning: {args.gcode}, {warning}", file=sys.stderr)
    result = {"cell": text, "program": program and asdict(program), "warnings": warnings, "file": args.out}
    if args.out is None:
        return Answer(result, [text.removesuffix("\n")])
    if Path(args.out).exists():
        raise InputError(args.out, "exists already: choose another --out")
    write_files({Path(args.out): (text,)})
    guesses = sum("yours" in line for line in text.splitlines()[1:])
    lines = [f"{args.out}: {guesses} lines marked yours are guesses to put right"]
    with contextlib.suppress(MillingError):  # the error of a cell is that of its first use
        lines += kuka_frames(read_cells(args.out)[0])
    return Answer(result, lines)


def run_keys(args) -> Answer:

    entries = keys_of(args.section)
    if args.schema:
        return Answer({"section": args.section, "keys": entries}, [json.dumps(schema(), indent=1)])
    shown = [k for k in entries if args.all or not k["expert"] or k["key"] == args.section]
    rows = [("key", "unit", "range", "default", "meaning")]
    for k in shown:
        rows.append(
            (k["key"], k["unit"], k["range"], "required" if k["required"] else default_text(k["default"]), k["text"])
        )
    # never cut off by the width of the terminal: a key is copied
    widths = [*(max(len(row[column]) for row in rows) for column in range(4)), 0]
    lines = ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    if hidden := len(entries) - len(shown):
        lines.append(f"not shown: {counted(hidden, 'key')} for experts: kr270_milling keys --all")
    return Answer({"section": args.section, "keys": entries}, lines)


def default_text(default) -> str:
    """Return a default as a cell file states it."""
    if default is None:
        return "-"
    if isinstance(default, list):
        return "[" + ", ".join(map(default_text, default)) + "]"
    if isinstance(default, float):
        return f"{default:g}"
    return str(default).lower() if isinstance(default, bool) else str(default) or '""'


def run_stiffness(args) -> Answer:
    """Pose, Jacobian, Cartesian stiffness (17) and natural frequencies at one posture."""
    arm, mount = read_arm(find_file(args.arm))
    result = analyse(arm, mount, np.radians(args.joints_deg), np.array(args.wrench), args.frame, args.gravity)
    x, y, z = (f"{v:.6f}" for v in result["position_m"])
    least = 1e-9 * np.repeat([np.abs(result["deflection"][k : k + 3]).max() for k in (0, 3)], 3)
    deflection = np.where(np.abs(result["deflection"]) <= least, 0.0, result["deflection"])  # zeros that rounding made
    columns = (np.diag(result["compliance"]), np.diag(result["stiffness"]), deflection)
    rows = [
        [axis, *(f"{value:.4e}" if value else "0" for value in values)]
        for axis, *values in zip(("x", "y", "z", "rx", "ry", "rz"), *columns, strict=True)
    ]
    title = "Diagonals and deflection under the wrench [m, rad, N]"
    shown = [
        f"{arm.name} at {args.joints_deg} deg, {args.frame} frame, tool point at ({x}, {y}, {z}) m\n",
        TextTable(title, ["axis", "compliance", "stiffness", "deflection"], rows),
    ]
    for model, values in result["mode_frequencies_hz"].items():
        shown.append(f"natural frequencies, {model} mass: " + ", ".join(f"{v:.2f}" for v in values) + " Hz")
    shown.append(f"condition number of the Jacobian (lengths in m): {result['condition_number']:.1f}")
    return Answer(result, [*shown, *(f"warning: {warning}" for warning in result["warnings"])])
