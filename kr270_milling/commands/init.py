"""``kr270_milling init``: print a first cell file, for a program or for a straight cut."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import option


def add_arguments(parser) -> None:
    option(parser, "--gcode FILE", "the program: G-code or APT/CL")
    option(parser, "--tool T1", "of a program with several tools: whose moves", default="")
    option(parser, "--robot", "arm file, also a shipped one by its name", default="kr270_2")


def run(args) -> Answer:
    from dataclasses import asdict

    from kr270_milling.base.record import find_file
    from kr270_milling.cell.draft import draft_text, straight_text
    from kr270_milling.trajectory.readers import read_toolpath

    robot = args.robot if args.robot.endswith(".yaml") else f"{args.robot}.yaml"
    find_file(robot)
    if args.gcode is None:
        text, program = straight_text(robot), None
    else:
        path = read_toolpath(args.gcode, args.tool)
        text, program = draft_text(str(Path(args.gcode).resolve()), path, robot), path.program
    return Answer({"cell": text, "program": program and asdict(program)}, [text.removesuffix("\n")])
