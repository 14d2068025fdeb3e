"""``kr270_milling init``: print a first cell file, for a program or for a straight cut."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_common, print_json


def add_arguments(parser) -> None:
    parser.add_argument("--gcode", metavar="FILE", help="the program: G-code or APT/CL")
    parser.add_argument("--tool", default="", metavar="T1", help="of a program with several tools: whose moves")
    parser.add_argument(
        "--robot", default="kr270_2", help="arm file, also a shipped one by its name (default: kr270_2)"
    )
    add_common(parser)


def run(args) -> None:
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
    if args.json:
        print_json({"cell": text, "program": None if program is None else asdict(program)})
    else:
        print(text, end="")
