"""Every command with its text, its example, its options, and the function that runs it: light to import."""

from __future__ import annotations

import argparse
import functools
import importlib
from typing import NamedTuple

from kr270_milling.compensation.methods import METHODS
from kr270_milling.nodes.play_arguments import PLAY, bounded, grid, numbers, stretch

__all__ = ["COMMANDS", "FEWEST_PLANTS", "LOBE_SPEEDS", "PLANTS", "add_command"]

PLANTS, FEWEST_PLANTS = 32, 8  #: of a verdict
LOBE_SPEEDS = 60
SIX_AXES = ("x", "y", "z", "rx", "ry", "rz")
QUANTITIES = ("displacement", "velocity", "acceleration")


class Group(NamedTuple):
    """Options under a title of their own; without one only one of them may be given."""

    title: str | None
    options: tuple


class Command(NamedTuple):
    """run: module.function below ``commands``; note: behind the example; parts: sub-commands by name."""

    run: str
    example: str
    text: str
    options: tuple
    note: str
    parts: dict[str, Command]


def command(run: str, example: str, text: str, *options, note: str = "", parts: dict | None = None) -> Command:
    return Command(run, example, text, options, note, parts or {})


def option(names: str, text: str, kind=None, default=None, **more) -> tuple[tuple[str, ...], dict]:
    """Names and keywords for ``add_argument`` of "--seed N", of the switch "--robust" (kind bool) or of the argument
    "cell CELL.yaml"; the help says the default."""
    name, _, metavar = names.partition(" ")
    if kind is bool:
        return (name,), dict(action="store_true", help=text)
    if default and "default" not in text:
        text += f" (default: {default:g})" if isinstance(default, (int, float)) else f" (default: {default})"
    return (name,), dict(metavar=metavar or None, type=kind, default=default, help=text, **more)


def add_command(sub, name: str, of: Command, filled: bool = True, json_default=False, **more) -> None:
    """Add a command to the sub-parsers ``sub``; with its own options only where it is the one that was chosen."""
    epilog = f"example: kr270_milling {of.example}" + (f"\n{of.note}" if of.note else "")
    parser = sub.add_parser(name, description=of.text[0].upper() + of.text[1:] + ".", epilog=epilog, **more)
    if not filled:
        return
    _add(parser, of.options)
    if of.parts:
        below = parser.add_subparsers(dest="what", metavar="WHAT", required=True, help="each has --help and --json")
        for key, part in of.parts.items():
            add_command(below, key, part, json_default=argparse.SUPPRESS, help=part.text)
    text = "print one JSON object to standard output"
    parser.add_argument("--json", help=text, action="store_true", default=json_default)
    parser.set_defaults(run=functools.partial(_run, of.run))


def _run(place: str, args: argparse.Namespace):
    """Only now is the command imported."""
    module, _, function = place.rpartition(".")
    return getattr(importlib.import_module(f"kr270_milling.commands.{module}"), function)(args)


def _add(parser, options: tuple) -> None:
    for one in options:
        if isinstance(one, Group):
            _add(parser.add_argument_group(one.title) if one.title else parser.add_mutually_exclusive_group(), one[1])
        else:
            parser.add_argument(*one[0], **one[1])


CELL = (
    option("cell CELL.yaml", "cell file, also a shipped one by its name"),
    option("--set key=value", "override a key, for example tool.teeth=2", default=[], action="append"),
)
PLANT = (
    option(
        "--plant PLANT.yaml",
        "cell file of the arm, material and imperfections that really cut; CELL.yaml is the model that plans",
    ),
    option(
        "--noise-um SIGMA",
        "standard deviation of each measured tool position along each axis (default: the plant's imperfections)",
        bounded(0.0, 1e4),
    ),
)
RECORDING = option("file FILE.mcap|DIR", "a recording, also one that was cut off")
REFERENCE = option("--reference FILE.csv", "run along this trajectory, as written by compensate")
SCHEDULER = option("--scheduler ADDRESS", "a running Dask scheduler, tcp://host:port")
MOTIONS = ("LIN", "SPLINE")
INCLUDE = option("--out DIR", "write YAML to include and report")
SENSOR_ABC = numbers(3, most=720.0)
POSTURE = numbers(6, most=720.0)

IDENTIFY = {
    "compliance": command(
        "identify.compliance",
        "identify compliance MEASUREMENTS.csv --arm config/kr270_2.yaml --cell config/test_piece.yaml --out identified",
        "joint compliances from load tests, or the load tests to make",
        option("measurements MEASUREMENTS.csv", "one load test a row, see identification/README.md", nargs="?"),
        option("--arm ARM.yaml", "arm or cell file to start from", required=True),
        option("--cell CELL.yaml", "where the arm is to mill (default: --arm, if it is a cell file)"),
        option("--at A1,...,A6", "posture there [deg]", POSTURE),
        option("--no-gravity", "leave the link weights out", bool),
        option("--robust", "take the weight from tests that contradict the others", bool),
        option("--compensator NAMES", "also fit these of arm.compensator, as stiffness,preload", default=""),
        Group("plan", (
            option("--plan N", "choose the N load tests that tell most about the cell", bounded(1, 1000, int)),
            option("--point X,Y,Z", "of load and reflector, flange frame [mm]", numbers(3, most=5e3)),
            option("--mass-kg", "to hang; 0: none", bounded(0, 5000), 100.0),
            option("--pull-n", "of a horizontal rope; 0: none", bounded(0, 50_000), 800.0),
            option("--noise-um", "of a measured coordinate, 1 sigma", bounded(0.001, 1e5), 20.0),
            option("--postures", "candidates to choose from", bounded(1, 50_000, int), 2000),
            option("--seed", "of the candidates", bounded(0, 2**31, int), 1),
        )),
        option("--out DIR", "write YAML to include and report, or table and KRL of the plan"),
    ),
    "forces": command(
        "identify.forces", "identify forces CUTS.csv --cell config/test_piece.yaml --out identified",
        "force coefficients from mean forces of cuts, or from recordings of a sensor",
        option("cuts CUTS.csv", "one cut a row, with its forces or a recording of them"),
        option("--cell CELL.yaml", "its tool made the cuts"),
        option("--teeth", "of the tool, instead of the cell's", int),
        option("--diameter-mm", "of the tool, instead of the cell's", bounded(0, 1000)),
        option("--rotation", "instead of the cell's", choices=("clockwise", "counterclockwise")),
        option("--law", "for the YAML file", default="linear_edge", choices=("linear_edge", "fractional")),
        Group("recordings of a sensor", (
            option("--topic", "of type geometry_msgs/WrenchStamped", default="wrench"),
            option("--spindle-speed-rpm", "instead of the cell's", bounded(0, 1e6)),
            option("--tare START:STOP", "seconds of an idle stretch", stretch(0, 1e6)),
            option("--sensor-abc A,B,C", "sensor in the workpiece [deg]", SENSOR_ABC),
            option("--sensor-on", "a plate under the part: part", default="tool", choices=("tool", "part")),
            option("--sensor-mass-kg", "that hangs on it, where there is no tare", bounded(0, 5000), 0.0),
        )),
        INCLUDE,
    ),
    "damping": command(
        "identify.damping", "identify damping RECORDING --topic deflection --out identified",
        "frequency and damping of the modes from a ring-down or an impact",
        option("recording RECORDING", "recording, UFF file, or CSV with time_s, any of x y z rx ry rz, force_n"),
        option("--topic", "of a recording", default="deflection"),
        option("--from S", "seconds after the first sample", bounded(0, 1e6), dest="start"),
        option("--to S", "seconds after the first sample", bounded(0, 1e6), dest="stop"),
        option("--band LOW:HIGH", "[Hz] (default: 2:100)", stretch(0.01, 1e5), (2.0, 100.0)),
        option("--modes N", "at most", bounded(1, 20, int), 6),
        option("--quantity", "of the channels", default=QUANTITIES[0], choices=QUANTITIES),
        option("--hammer", "direction of force_n: scales the shapes by the masses", choices=SIX_AXES),
        option("--cell CELL.yaml", "scales the shapes by its compliance, where no hammer was"),
        INCLUDE,
    ),
    "material": command(
        "identify.material", "identify material Al7075-T6",
        "published force coefficients of a material",
        option("name NAME", "of a material; without it all are listed", nargs="?"),
        option("--row", "which, where a material has several", int, 1),
        option("--out DIR", "write YAML to include"),
    ),
}  # fmt: skip

COMMANDS = {
    "demo": command(
        "demo.run", "demo --out out",
        "run the paper's case: original pass and three compensations, table and report",
        option("--out DIR", "where report and series go", default="out"),
        option("--plain", "the plain loop, also where ROS is installed", bool),
        *PLANT,
    ),
    "init": command(
        "cells.init", "init --gcode config/test_piece.nc",
        "print a first cell file for a program",
        option("--gcode FILE", "the program: G-code or APT/CL"),
        option("--tool T1", "of a program with several tools: whose moves", default=""),
        option("--robot", "arm file, also a shipped one by its name", default="kr270_2"),
    ),
    "keys": command(
        "cells.keys", "keys tool",
        "list the keys of a cell file with unit, range, default and meaning",
        option("section SECTION", "for example tool; default: all", default="", nargs="?"),
        option("--markdown", "print a table for a page", bool),
    ),
    "run": command(
        "run.run", "run config/paper.yaml --method spline --out out",
        "run the passes of a cell as ROS 2 nodes, each recorded to MCAP",
        *CELL,
        *PLANT,
        option(
            "--passes N", "passes in all, with the original one (default: as many as needed)", bounded(1, 1000, int)
        ),
        option("--method", "how to compensate; may be given several times", choices=METHODS, action="append"),
        option("--out DIR", "for recordings, logs, cell.yaml", default="out"),
        option("--processes", "one process a node; else two nodes share one, which is quicker", bool),
        option("--namespace NAME", "ROS namespace of the four nodes", default=""),
    ),
    "simulate": command(
        "simulate.simulate", "simulate config/paper.yaml --set path.depth_of_cut_mm=1",
        "simulate one pass of a cell",
        *CELL,
        *PLANT,
        REFERENCE,
        option("--out DIR", "write the series of the pass here as CSV; of a tool path also the part as STL"),
    ),
    "compensate": command(
        "compensate.run", "compensate config/test_piece.yaml --out out",
        "revise the trajectory of a cell; tables, report and robot programs",
        *CELL,
        *PLANT,
        option("--method", "default: the cell's compensation.method", choices=METHODS),
        option("--out DIR", "where everything goes", default="out"),
        option(
            "--krl",
            "motions of the robot programs; may be given twice (default: LIN for the method linear, which corrects "
            "in straight lines, else the cell's program.motion)",
            choices=MOTIONS,
            action="append",
        ),
        Group(None, (
            option(
                "--verdict N",
                f"judge the compensation by N plants (default {PLANTS}) drawn from the cell's uncertainty; by "
                f"fewer, but at least {FEWEST_PLANTS}, where they take more than 5 minutes. Without this option: "
                f"as many as take less than a minute, and none where {FEWEST_PLANTS} take longer",
                bounded(1, 999_999, int),
                nargs="?",
                const=PLANTS,
            ),
            option("--quick", f"a verdict of {FEWEST_PLANTS} plants, without a look at other methods", bool),
            option("--no-verdict", "no verdict: the model itself is what cuts", bool),
        )),
        option(
            "--force",
            "write the programs of a path that must not be run all the same, marked NOT RELEASED in name and "
            "header",
            bool,
        ),
        option("--seed N", "of the verdict's plants", bounded(1, 999_999, int), 1),
    ),
    "check": command(
        "simulate.check", "check config/test_piece.yaml",
        "say whether a path, or its corrected trajectory, may be run",
        *CELL,
        option("--reference FILE.csv", "check this trajectory, as written by compensate"),
        option("--motion", "default: the cell's program.motion", choices=MOTIONS),
    ),
    "stiffness": command(
        "cells.stiffness", "stiffness config/kr270_2.yaml --joints-deg 90,-50,120,180,25,180",
        "pose, stiffness and natural frequencies of an arm at one posture",
        option("arm ARM.yaml", "arm or cell file; the flange is the tool point of a bare arm"),
        option("--joints-deg A1,...,A6", "posture", POSTURE, required=True),
        option("--wrench FX,FY,FZ,MX,MY,MZ", "[N, N m], default: none", numbers(6), [0.0] * 6),
        option("--frame", "of wrench and matrices", default="base", choices=("base", "tool")),
        option("--gravity", "load the arm with its link weights too", bool),
    ),
    "stability": command(
        "stability.run", "stability config/paper.yaml --speeds 4000:12000:100",
        "limit depth of cut and chatter frequency over spindle speed",
        *CELL,
        option(
            "--speeds LOW:HIGH:COUNT",
            f"spindle speeds [rpm] (default: {LOBE_SPEEDS} from half to one and a half times that of the cell)",
            grid(1.0, 2e5, 100_000),
        ),
        option("--no-arm", "leave out the arm: the modes of tool.modes alone", bool),
        option("--along", "instead of lobes: the limit depth of each feature of the path", bool),
        option("--out DIR", "write lobes.csv and the picture lobes.html here"),
        note="keys: path.radial_immersion (share of the diameter) and path.mode (slot, up, down) say how the tool is "
        "engaged, tool.modes what of tool and spindle vibrates",
    ),
    "map": command(
        "studies.place", "map config/test_piece.yaml --x 1200:1800:13 --y=-300:300:7 --tool-turn=-90:90:7",
        "where to clamp the part and how to turn the tool: reach, limits and predicted error over placements",
        *CELL,
        *(
            option(f"--{name} LOW:HIGH:COUNT", text, grid(-1e5, 1e5, 1_000_000))
            for name, text in {
                "x": "[mm] of the workpiece's origin on base_link",
                "y": "[mm] likewise",
                "z": "[mm] likewise",
                "turn": "[deg] of the workpiece about z of base_link, on top of the cell's",
                "tool-turn": "[deg] of the tool about its own axis",
            }.items()
        ),
        option("--out DIR", "where rows, cells and picture go", default="map"),
        SCHEDULER,
        option("--chunk N", "placements a file", bounded(1, 100_000, int), 500),
        Group("along a path", (
            option(
                "--along PATH",
                "turn the tool about its axis along this tool path (default: that of the cell), where the "
                "workpiece is",
                nargs="?",
                const="",
            ),
            option("--smooth UM", "how much error [um] a turn of 1 deg/s is worth", bounded(0.001, 1e6), 1.0),
            option("--places N", "along the path", bounded(3, 5000, int), 200),
        )),
    ),
    "sweep": command(
        "studies.sweep", "sweep config/paper.yaml --vary path.depth_of_cut_mm=0.2:1:0.2 --out sweep",
        "full passes with other values of any keys, on as many cores as there are",
        *CELL,
        option(
            "--vary KEY=LOW:HIGH:STEP",
            "values of a key, also KEY=A,B,C; may be given several times",
            action="append",
            required=True,
        ),
        option("--samples N", "with --latin: that many rows", int),
        option("--latin", "a Latin hypercube between the values instead of a grid", bool),
        option("--seed N", "of --latin", int, 1),
        option("--out DIR", "where the rows go", default="sweep"),
        SCHEDULER,
        option("--chunk N", "rows a file (default: 1 to 8)", bounded(1, 100_000, int), 0),
    ),
    "identify": command(
        "", "identify compliance MEASUREMENTS.csv --arm config/kr270_2.yaml",
        "find compliances, force coefficients and modes from measurements of the own cell",
        parts=IDENTIFY,
    ),
    "compare": command(
        "identify.compare", "compare out/original config/paper.yaml",
        "set a measured pass beside the simulated one",
        option("recording RECORDING", "of a force sensor, a tracker, or both"),
        *CELL,
        option("--reference FILE.csv", "the pass ran along this, as written by compensate"),
        option("--force-topic", "WrenchStamped", default="wrench"),
        option("--pose-topic", "PoseStamped in workpiece axes", default="tool_pose"),
        option("--sensor-abc A,B,C", "force sensor in the workpiece [deg]", SENSOR_ABC),
        option("--sensor-on", "a plate under the part: part", default="tool", choices=("tool", "part")),
        option("--out DIR", "write a report"),
    ),
    "info": command(
        "recordings.info", "info out/pass1",
        "show what a recording holds",
        RECORDING,
        option("--verify", "check every byte; exit code 1 where damage is found", bool),
    ),
    "replay": command(
        "replay.run", "replay out/pass1 --recompute",
        "play a recording back onto topics, recompute it bit for bit, or compensate from it",
        option("file FILE.mcap|DIR", "a recording"),
        Group(None, (
            option(
                "--recompute",
                "no playback: recompute every output and compare bit for bit; exit code 1 if one differs, is "
                "missing or is left over, or the recompute cannot go on",
                bool,
            ),
            option("--compensate", "no playback: the revised trajectory from the recorded pass", bool),
        )),
        option("--method", "with --compensate: in place of the recorded method", choices=METHODS),
        option("--out DIR", "with --compensate: write reference_trajectory.csv there"),
        Group("playback (names as in ros2 bag play)", PLAY),
        option("--ros-args", "remapping and namespace; the last", default=[], nargs=argparse.REMAINDER),
    ),
    "export": command(
        "recordings.export", "export out/pass1 --csv tables",
        "write the topics of a recording as tables",
        RECORDING,
        option("--csv DIR", "write one CSV file per topic into this directory"),
        option("--parquet DIR", "the same as Parquet; needs pyarrow"),
        option("--topics TOPIC", "only these", nargs="+"),
    ),
    "report": command(
        "recordings.report", "report out",
        "make the report of one or several recordings",
        option(
            "recordings FILE-or-DIR",
            "recordings, or directories that hold some; passes of one path are compared on the same scales",
            nargs="+",
        ),
        option("--namespace NAME", "of the robot, where a recording holds several"),
        option("--out DIR", "where the report goes (default: report in the first DIR, or beside the first FILE)"),
    ),
    "watch": command(
        "run.watch", "watch --port 8270",
        "show a running graph, live, on a page of this host",
        option("--namespace NAME", "ROS namespace of the robot", default=""),
        option("--host", "where it is served (default: 127.0.0.1, this host alone)", default="127.0.0.1"),
        option("--port", "default: 8270; 0: any that is free", bounded(0, 65535, int), 8270),
    ),
    "recover": command(
        "recordings.recover", "recover out/pass1",
        "make a whole recording of one that was cut off or damaged",
        option("file FILE.mcap|DIR", "the damaged recording; it is not touched"),
        option("--out DIR", "the new recording (default: beside it, with _recovered; none of a whole one)"),
    ),
    "bench": command("bench.run", "bench", "time the sweep of the teeth and the stiffness model"),
}  # fmt: skip
