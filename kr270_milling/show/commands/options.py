"""Parsers of all commands, and the one place that imports a command when it runs.

``--help`` and the completion of a shell import this file, so it imports neither numpy nor the models.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from kr270_milling.base.arguments import PLAY, Parser, bounded, grid, numbers, stretch, words
from kr270_milling.base.extensions import require_extra
from kr270_milling.base.version import __version__

if TYPE_CHECKING:
    from kr270_milling.show.commands.console import Answer


MOTIONS = ("LIN", "SPLINE")
POSTURE = numbers(6, most=720.0)
PLACES = grid(-1e5, 1e5, 1_000_000)
#: keywords of ``add_argument`` of the options that several commands have
SHARED: dict[str, dict] = {
    "file": dict(metavar="FILE.mcap|DIR", help="a recording, also one that was cut off"),
    "cell": dict(metavar="CELL.yaml", help="cell file, also a shipped one by its name"),
    "--set": dict(metavar="key=value", default=[], action="append", help="override a key, for example tool.teeth=2"),
    "--plant": dict(
        metavar="PLANT.yaml",
        help=("cell file of the arm, material and imperfections that really cut; CELL.yaml is the model that plans"),
    ),
    "--noise-um": dict(
        metavar="SIGMA",
        type=bounded(0.0, 1e4),
        help=("standard deviation of each measured tool position along each axis (default: the plant's imperfections)"),
    ),
    "--cell": dict(metavar="CELL.yaml", help="the cell, for a recording without it, as of ros2 bag record"),
    "--remap": dict(
        metavar="NAME:=RECORDED",
        default=[],
        action="append",
        help="our topic NAME was recorded as RECORDED, as wrench:=force/measured; may be given several times",
    ),
    "--sensor-abc": dict(metavar="A,B,C", type=numbers(3, most=720.0), help="sensor in the workpiece [deg]"),
    "--sensor-on": dict(default="tool", choices=("tool", "part"), help="a plate under the part: part"),
    "--self-contained": dict(
        action="store_true", help="the page contains plotly.js instead of loading plotly.min.js next to it"
    ),
    "--scheduler": dict(metavar="ADDRESS", help="a running Dask scheduler, tcp://host:port"),
}


def run(args: argparse.Namespace) -> Answer:
    """Import the function of the command and call it."""
    match args.command:
        case "init":
            from kr270_milling.show.commands.cells import run_init as command
        case "check":
            from kr270_milling.show.commands.simulate import run_check as command
        case "compensate":
            from kr270_milling.show.commands.compensate import run_compensate as command
        case "identify":
            from kr270_milling.show.commands.identify import run_identify as command
        case "map":
            from kr270_milling.show.commands.studies import run_map as command
        case "simulate":
            from kr270_milling.show.commands.simulate import run_simulate as command
        case "sweep":
            from kr270_milling.show.commands.studies import run_sweep as command
        case "demo":
            from kr270_milling.show.commands.run import run_demo as command
        case "keys":
            from kr270_milling.show.commands.cells import run_keys as command
        case "stiffness":
            from kr270_milling.show.commands.cells import run_stiffness as command
        case "stability":
            from kr270_milling.show.commands.studies import run_stability as command
        case "compare":
            from kr270_milling.show.commands.identify import run_compare as command
        case "rsi":
            from kr270_milling.show.commands.rsi import run_rsi as command
        case "run":
            from kr270_milling.show.commands.run import run_graph as command
        case "replay":
            from kr270_milling.show.commands.replay import run_replay as command
        case "info":
            from kr270_milling.show.commands.recordings import run_info as command
        case "export":
            from kr270_milling.show.commands.recordings import run_export as command
        case "report":
            from kr270_milling.show.commands.reports import run_report as command
        case "recover":
            from kr270_milling.show.commands.recordings import run_recover as command
        case name:
            raise ValueError(f"no function for the command {name}")
    if (args.command in ("compensate", "demo", "report")) or ("self_contained" in args and args.out):
        require_extra(f"the page of {args.command}", "", "plotly")  # before the computation
    return command(args)


def _shared(parser, *names: str) -> None:
    for name in names:
        parser.add_argument(name, **SHARED[name])


def _methods() -> tuple[str, ...]:
    """Return the names of all methods; other packages may add methods, which takes time and may fail."""
    from kr270_milling.physics.compensation.methods import methods

    return tuple(methods())


def _example(parser, example: str, note: str = "") -> None:
    parser.epilog = f"example: kr270_milling {example}" + (f"\n{note}" if note else "")


def _add_init(parser) -> None:
    _example(parser, "init --gcode config/test_piece.nc --out my.yaml")
    add = parser.add_argument
    add(
        "--gcode",
        metavar="FILE",
        help="program: G-code, Heidenhain, APT/CL, KRL or points (default: a straight cut)",
    )
    add("--tool", metavar="T1", default="", help="tool of a program with several: a cell for this tool alone")
    add("--robot", default="kr270_2", help="arm file, also a shipped one by its name")
    add(
        "--out",
        metavar="FILE.yaml",
        help="write this file instead; it names a program below its folder by the relative path",
    )


def _add_keys(parser) -> None:
    _example(parser, "keys tool")
    parser.add_argument("section", metavar="SECTION", default="", nargs="?", help="for example tool; default: all")
    parser.add_argument("--all", action="store_true", help="show also the keys for experts, which init does not write")
    parser.add_argument("--schema", action="store_true", help="print the JSON schema of a cell file, for an editor")


def _add_stiffness(parser) -> None:
    _example(parser, "stiffness config/kr270_2.yaml --joints-deg 90,-50,120,180,25,180")
    add = parser.add_argument
    add("arm", metavar="ARM.yaml", help="arm or cell file; the flange is the tool point of a bare arm")
    add("--joints-deg", metavar="A1,...,A6", type=POSTURE, required=True, help="posture")
    add("--wrench", metavar="FX,FY,FZ,MX,MY,MZ", type=numbers(6), default=[0.0] * 6, help="[N, N m], default: none")
    add("--frame", default="base", choices=("base", "tool"), help="frame of wrench and matrices")
    add("--gravity", action="store_true", help="load the arm with its link weights too")


def _add_compensate(parser) -> None:
    _example(parser, "compensate config/test_piece.yaml --out out")
    add = parser.add_argument
    _shared(parser, "cell", "--set", "--plant", "--noise-um")
    add(
        "--method",
        choices=("best", "none", *_methods()),
        help="default: the cell's compensation.method; best: compare the methods and run the best; none: no correction",
    )
    add(
        "--measured",
        metavar="WALL.csv",
        action="append",
        help="experimental: errors of a part that was cut, the table of compare, 6 to 200 places: learn from it; may "
        "be given again",
    )
    add(
        "--reference",
        metavar="REFERENCE.csv",
        action="append",
        help="the reference that cut the part, one for each --measured (default: original, the path as programmed)",
    )
    add("--out", metavar="DIR", default="out", help="where everything goes")
    add(
        "--krl",
        choices=MOTIONS,
        action="append",
        help="motions of the robot programs; may be given twice (default: LIN for the method linear, which "
        "corrects in straight lines, else the cell's program.motion)",
    )
    add(
        "--verdict",
        metavar="N",
        type=bounded(0, 999_999, int),
        default=32,
        help="number of simulated robots, drawn from the cell's uncertainty, that judge the compensation; 0: "
        "no verdict",
    )
    add(
        "--reach",
        action="store_true",
        help="try ramps, feeds, a finishing pass and a turn of the tool until 90 %% of the robots meet the tolerance",
    )
    add(
        "--force",
        action="store_true",
        help="also write the programs after the decision no, marked NOT RELEASED in name and header",
    )
    add(
        "--rsi",
        metavar="ADDRESS[:PORT]",
        help="also write the table of offsets, the RSI context of a KR C4 and the program around it, for "
        "'kr270_milling rsi' on that host",
    )
    add(
        "--write",
        metavar="KIND,...",
        type=words("joints", "rsi", "stl"),
        default=(),
        help="also write joints: tables of joint positions; rsi: the table of offsets for 'kr270_milling rsi'; "
        "stl: the machined part",
    )
    add(
        "--gcode",
        action="store_true",
        help="also write the G-code of the cell with corrected coordinates, as G1 blocks",
    )
    add("--seed", metavar="N", type=bounded(1, 999_999, int), default=1, help="random seed of the simulated robots")


def _add_demo(parser) -> None:
    _example(parser, "demo --out out")
    add = parser.add_argument
    add("--out", metavar="DIR", default="out", help="where report and series go")
    add("--plain", action="store_true", help="the plain loop, also where ROS is installed")
    _shared(parser, "--plant", "--noise-um")


def _add_identify(parser) -> None:
    _example(parser, "identify compliance MEASUREMENTS.csv --arm config/kr270_2.yaml")
    parts = parser.add_subparsers(dest="what", metavar="WHAT", required=True, help="each has --help and --json")
    kinds = {  # as ``COMMANDS``
        "compliance": ("joint compliances from load tests, or the load tests to make", _add_compliance),
        "forces": ("force coefficients from mean forces of cuts, or from recordings of a sensor", _add_forces),
        "damping": ("frequency and damping of the modes from a ring-down or an impact", _add_damping),
        "servo": (
            "frequency, damping and dead time of the servo lag from a test move, or the program of the move",
            _add_servo,
        ),
        "backlash": ("backlash of the joints from push and pull at the tool with a dial gauge", _add_backlash),
        "material": ("published force coefficients of a material", _add_material),
    }
    for name, (text, add) in kinds.items():
        _add_command(parts, name, text, add, argparse.SUPPRESS, help=text)


def _add_compliance(parser) -> None:
    _example(
        parser,
        "identify compliance MEASUREMENTS.csv --arm config/kr270_2.yaml --cell config/test_piece.yaml --out identified",
    )
    add = parser.add_argument
    add("measurements", metavar="MEASUREMENTS.csv", nargs="?", help="one load test a row")
    add("--arm", metavar="ARM.yaml", required=True, help="arm or cell file to start from")
    add("--cell", metavar="CELL.yaml", help="where the arm is to mill (default: --arm, if it is a cell file)")
    add("--at", metavar="A1,...,A6", type=POSTURE, help="posture of milling [deg]")
    add("--no-gravity", action="store_true", help="leave the link weights out")
    add("--robust", action="store_true", help="take the weight from tests that contradict the others")
    add("--base", action="store_true", help="also fit or plan arm.base_compliance about x and y")
    add("--compensator", metavar="NAMES", default="", help="also fit these of arm.compensator, as stiffness,preload")
    group = parser.add_argument_group("plan")
    group.add_argument(
        "--plan", metavar="N", type=bounded(1, 1000, int), help="choose the best N load tests for the cell"
    )
    group.add_argument(
        "--point", metavar="X,Y,Z", type=numbers(3, most=5e3), help="place of load and reflector, flange frame [mm]"
    )
    group.add_argument("--mass-kg", type=bounded(0, 5000), default=100.0, help="mass to hang on the tool; 0: none")
    group.add_argument("--pull-n", type=bounded(0, 50000), default=800.0, help="force of a horizontal rope; 0: none")
    group.add_argument("--noise-um", type=bounded(0.001, 1e5), default=20.0, help="standard deviation of a coordinate")
    group.add_argument("--postures", type=bounded(1, 50_000, int), default=2000, help="candidates to choose from")
    group.add_argument("--seed", type=bounded(0, 2**31, int), default=1, help="random seed of the candidates")
    add("--out", metavar="DIR", help="write YAML to include and report, or table and KRL of the plan")
    _shared(parser, "--self-contained")


def _add_forces(parser) -> None:
    _example(parser, "identify forces CUTS.csv --cell config/test_piece.yaml --out identified")
    add = parser.add_argument
    add("cuts", metavar="CUTS.csv", help="one cut a row, with its forces or a recording of them")
    add("--cell", metavar="CELL.yaml", help="cell whose tool made the cuts")
    add("--teeth", type=bounded(1, 100, int), help="teeth of the tool, instead of the cell's")
    add("--diameter-mm", type=bounded(0, 1000), help="diameter of the tool, instead of the cell's")
    add("--rotation", choices=("clockwise", "counterclockwise"), help="sense of rotation, instead of the cell's")
    add("--law", metavar="NAME", default="linear_edge", help="for the YAML file, one of cutting.law")
    add("--robust", action="store_true", help="leave out cuts that contradict the others")
    group = parser.add_argument_group("recordings of a sensor")
    group.add_argument("--topic", default="wrench", help="topic of type geometry_msgs/WrenchStamped")
    group.add_argument("--spindle-speed-rpm", type=bounded(0, 1e6), help="spindle speed, instead of the cell's")
    group.add_argument(
        "--tare",
        metavar="START:STOP",
        type=stretch(0, 1e6),
        help="idle stretch, seconds",
    )
    _shared(group, "--sensor-abc", "--sensor-on")
    group.add_argument(
        "--sensor-mass-kg", type=bounded(0, 5000), default=0.0, help="mass that hangs on the sensor, without --tare"
    )
    add("--out", metavar="DIR", help="write YAML to include and report")
    _shared(parser, "--self-contained")


def _add_damping(parser) -> None:
    _example(parser, "identify damping RECORDING --topic deflection --out identified")
    add = parser.add_argument
    add("recording", metavar="RECORDING", help="recording, UFF file, or CSV with time_s, x y z rx ry rz, force_n")
    add("--topic", default="deflection", help="topic of a recording")
    add("--from", metavar="S", type=bounded(0, 1e6), dest="start", help="start, seconds after the first sample")
    add("--to", metavar="S", type=bounded(0, 1e6), dest="stop", help="end, seconds after the first sample")
    add(
        "--band",
        metavar="LOW:HIGH",
        type=stretch(0.01, 1e5),
        default=(2.0, 100.0),
        help="frequencies [Hz] (default: 2:100)",
    )
    add("--modes", metavar="N", type=bounded(1, 20, int), default=6, help="largest number of modes")
    add(
        "--quantity",
        choices=("displacement", "velocity", "acceleration"),
        help="kind of the channels (default: that of a UFF file, else displacement)",
    )
    add(
        "--hammer",
        choices=("x", "y", "z", "rx", "ry", "rz"),
        help="direction of force_n: scales the shapes by the masses",
    )
    add("--cell", metavar="CELL.yaml", help="scales the shapes by its compliance, or checks those of a hammer")
    add("--out", metavar="DIR", help="write YAML to include and report")
    _shared(parser, "--self-contained")


def _add_servo(parser) -> None:
    _example(parser, "identify servo MOVE.csv --out identified")
    add = parser.add_argument
    add(
        "series",
        metavar="SERIES",
        nargs="?",
        help="CSV with time_s, commanded_mm and measured_mm (or _deg), or a recording of the command rsi",
    )
    add(
        "--other-clock",
        action="store_true",
        help="the measured motion has another clock, as that of a tracker: no dead time is written",
    )
    group = parser.add_argument_group("plan")
    group.add_argument("--plan", action="store_true", help="write the program of the test move, with --cell and --out")
    group.add_argument("--cell", metavar="CELL.yaml", help="the move is in the air above the middle of its stock")
    group.add_argument("--rsi", metavar="HOST[:PORT]", help="also write an RSI context for this host")
    add("--out", metavar="DIR", help="write YAML to include and report, or the programs of the plan")
    _shared(parser, "--self-contained")


def _add_backlash(parser) -> None:
    _example(parser, "identify backlash PUSHES.csv --arm config/test_piece.yaml --out identified")
    add = parser.add_argument
    add("pushes", metavar="PUSHES.csv", help="one reading a row: a1_deg to a6_deg, axis, force_n, reading_mm, sigma_um")
    add("--arm", metavar="ARM.yaml", required=True, help="arm or cell file with tool, friction and weights")
    add("--out", metavar="DIR", help="write YAML to include")


def _add_material(parser) -> None:
    _example(parser, "identify material Al7075-T6")
    add = parser.add_argument
    add("name", metavar="NAME", nargs="?", help="name of a material; without a name all are listed")
    add("--row", type=bounded(1, 1000, int), default=1, help="which, where a material has several")
    add("--out", metavar="DIR", help="write YAML to include")


def _add_compare(parser) -> None:
    _example(parser, "compare out/original config/paper.yaml")
    add = parser.add_argument
    add(
        "recording",
        metavar="RECORDING",
        help="recording of a force sensor, a tracker, or both; or WALL.csv: measured error of a wall",
    )
    _shared(parser, "cell", "--set")
    add(
        "--reference",
        metavar="FILE.csv",
        help="the pass ran along this, as written by compensate (default: as recorded)",
    )
    add(
        "--pass",
        metavar="N",
        type=bounded(1, 1000, int),
        help="pass of several in a recording (default: the last)",
    )
    _shared(parser, "--remap")
    add("--sensor-abc", metavar="A,B,C", type=numbers(3, most=720.0), help="force sensor in the workpiece [deg]")
    _shared(parser, "--sensor-on")
    add(
        "--plants",
        metavar="N",
        type=bounded(2, 1000, int),
        default=16,
        help="simulated robots of the band of a wall",
    )
    add("--out", metavar="DIR", help="write a report")
    _shared(parser, "--self-contained")


def _add_info(parser) -> None:
    _example(parser, "info out/pass1")
    _shared(parser, "file")
    parser.add_argument("--verify", action="store_true", help="check every byte; exit code 1 on damage")


def _add_export(parser) -> None:
    _example(parser, "export out/pass1 --csv tables")
    add = parser.add_argument
    _shared(parser, "file")
    add("--csv", metavar="DIR", required=True, help="write one CSV file per topic into this directory")
    add("--topics", metavar="TOPIC", nargs="+", help="only these")


def _add_report(parser) -> None:
    _example(parser, "report out")
    add = parser.add_argument
    add(
        "recordings",
        metavar="FILE-or-DIR",
        nargs="+",
        help="recordings, or directories that hold some; passes of one path are compared on the same scales",
    )
    add("--namespace", metavar="NAME", help="namespace of the robot, in a recording with several robots")
    _shared(parser, "--remap", "--cell")
    add(
        "--out",
        metavar="DIR",
        help="where the report goes (default: in place of the report.html of the first DIR, else DIR/report; "
        "DIR of a first FILE: that of the file)",
    )


def _add_recover(parser) -> None:
    _example(parser, "recover out/pass1")
    add = parser.add_argument
    add("file", metavar="FILE.mcap|DIR", help="the damaged recording; it is not touched")
    add("--out", metavar="DIR", help="the new recording (default: beside it, with _recovered; none of a whole one)")


def _add_replay(parser) -> None:
    _example(parser, "replay out/pass1 --recompute")
    add = parser.add_argument
    add("file", metavar="FILE.mcap|DIR", help="a recording")
    add(
        "--recompute",
        action="store_true",
        help="no playback: recompute every output, compare bit for bit, and count what is missing; exit code 1 if one "
        "differs, the file is damaged, or the recompute cannot continue",
    )
    _shared(parser, "--cell")
    _shared(parser, "--remap")
    group = parser.add_argument_group("playback (names as in ros2 bag play)")
    for names, keywords in PLAY:
        group.add_argument(*names, **keywords)
    add("--ros-args", default=[], nargs=argparse.REMAINDER, help="remapping and namespace; must be the last option")


def _add_rsi(parser) -> None:
    _example(
        parser,
        "rsi out --host 192.168.1.10 --port 49152",
        note=("It ends when the robot is silent for 1 s. This host is not a real-time system: see guide/rsi.md."),
    )
    add = parser.add_argument
    add("file", metavar="DIR|FILE.csv", help="directory of compensate, or its table rsi_offsets_*.csv")
    add("--port", type=bounded(1, 65_535, int), default=49152, help="UDP port of the object ETHERNET")
    add(
        "--host",
        default="127.0.0.1",
        help="address of this host in the network of the controller (default: %(default)s, no network)",
    )
    add("--cycle-ms", type=bounded(4, 12, int), default=4, help="cycle of the controller")
    add("--max-mm", type=bounded(0.0, 5.0, above=True), default=1.0, help="largest displacement")
    add("--max-deg", type=bounded(0.0, 2.0, above=True), default=0.5, help="largest rotation")
    add(
        "--rate-mm-per-s", type=bounded(0.0, 200.0, above=True), default=20.0, help="fastest change of the displacement"
    )
    add("--ramp-s", type=bounded(0.0, 10.0, above=True), default=0.2, help="time from no correction to the full one")
    add(
        "--reach-mm",
        type=bounded(0.0, 50.0, above=True),
        default=1.0,
        help="largest distance from the path",
    )
    add(
        "--progress",
        default="rsol",
        choices=("rsol", "rist"),
        help="pose from which the place on the path is taken: RSol, or RIst minus the correction",
    )
    add(
        "--context",
        metavar="ETHERNET.xml",
        help="file of the object ETHERNET, which names the elements: RKorr, AK, RIst, RSol, AIPos or others",
    )
    add(
        "--cell",
        metavar="CELL.yaml",
        help="cell of the path, attached to the recording; report and corrections of joints (AK) need it",
    )
    add("--out", metavar="DIR", default="rsi", help="directory of the recording")


def _add_run(parser) -> None:
    _example(parser, "run config/paper.yaml --method spline --out out")
    add = parser.add_argument
    _shared(parser, "cell", "--set", "--plant", "--noise-um")
    add(
        "--passes",
        metavar="N",
        type=bounded(1, 1000, int),
        help="passes in all, with the original one (default: as many as needed)",
    )
    add(
        "--method",
        choices=_methods(),
        action="append",
        help="may be given several times (default: the cell's)",
    )
    add("--out", metavar="DIR", default="out", help="directory of recordings, logs, cell.yaml")
    add("--processes", action="store_true", help="one process a node; else two nodes share one, which is quicker")
    add("--namespace", metavar="NAME", default="", help="ROS namespace of the four nodes")


def _add_simulate(parser) -> None:
    _example(parser, "simulate config/paper.yaml --set path.depth_of_cut_mm=1")
    add = parser.add_argument
    _shared(parser, "cell", "--set", "--plant", "--noise-um")
    add("--reference", metavar="FILE.csv", help="run along this trajectory, as written by compensate")
    add("--out", metavar="DIR", help="write the series of the pass here as CSV")
    add(
        "--write",
        metavar="KIND",
        type=words("stl"),
        default=(),
        help="stl: with --out, of a tool path, write also the machined part",
    )


def _add_check(parser) -> None:
    _example(parser, "check config/test_piece.yaml")
    add = parser.add_argument
    _shared(parser, "cell", "--set")
    add("--reference", metavar="FILE.csv", help="check this trajectory, as written by compensate")
    add("--motion", choices=MOTIONS, help="motions of the program that is checked (default: the cell's)")
    add(
        "-v",
        "--verbose",
        action="store_true",
        help="print everything that was checked, not only tolerance, stops, warnings, stability and the last line",
    )


def _add_stability(parser) -> None:
    _example(
        parser,
        "stability config/paper.yaml --speeds 4000:12000/100",
        note=(
            "keys: path.radial_immersion (share of the diameter) and path.mode (slot, up, down) state the "
            "engagement, tool.modes the vibration of tool and spindle"
        ),
    )
    add = parser.add_argument
    _shared(parser, "cell", "--set")
    add(
        "--speeds",
        metavar="LOW:HIGH/COUNT",
        type=grid(1.0, 2e5, 100000),
        help="spindle speeds [rpm], or a single one (default: 60 from half to one and a half times that of the cell)",
    )
    add("--no-arm", action="store_true", help="leave out the arm: the modes of tool.modes alone")
    add("--along", action="store_true", help="instead of lobes: the limit depth of each feature of the path")
    add("--out", metavar="DIR", help="write lobes.csv and the picture lobes.html here")
    _shared(parser, "--self-contained")


def _add_map(parser) -> None:
    _example(parser, "map config/test_piece.yaml --x 1200:1800/13 --y=-300:300/7 --tool-turn=-90:90/7")
    add = parser.add_argument
    _shared(parser, "cell", "--set")
    add("--x", metavar="LOW:HIGH/COUNT", type=PLACES, help="x of the workpiece's origin on base_link [mm]")
    add("--y", metavar="LOW:HIGH/COUNT", type=PLACES, help="y of this origin [mm]")
    add("--z", metavar="LOW:HIGH/COUNT", type=PLACES, help="z of this origin [mm]")
    add(
        "--turn",
        metavar="LOW:HIGH/COUNT",
        type=PLACES,
        help="turn of the workpiece about z of base_link, added to the cell's [deg]",
    )
    add("--tool-turn", metavar="LOW:HIGH/COUNT", type=PLACES, help="turn of the tool about its axis [deg]")
    add("--out", metavar="DIR", default="map", help="where rows, cells and picture go")
    _shared(parser, "--self-contained", "--scheduler")
    add("--chunk", metavar="N", type=bounded(1, 100_000, int), default=500, help="placements a file")
    group = parser.add_argument_group("along a path")
    group.add_argument(
        "--along",
        metavar="PATH",
        nargs="?",
        const="",
        help=("turn the tool about its axis along this tool path (default: that of the cell), where the workpiece is"),
    )
    group.add_argument(
        "--smooth",
        metavar="UM",
        type=bounded(0.001, 1e6),
        default=1.0,
        help="how much error [um] a turn of 1 deg/s is worth",
    )
    group.add_argument("--places", metavar="N", type=bounded(3, 5000, int), default=200, help="along the path")


def _add_sweep(parser) -> None:
    _example(parser, "sweep config/paper.yaml --vary path.depth_of_cut_mm=0.2:1:0.2 --out sweep")
    add = parser.add_argument
    _shared(parser, "cell", "--set")
    add(
        "--vary",
        metavar="KEY=LOW:HIGH:STEP",
        action="append",
        required=True,
        help="values of a key, also KEY=LOW:HIGH/COUNT or KEY=A,B,C; may be given several times",
    )
    add("--samples", metavar="N", type=bounded(1, 10_000_000, int), help="with --latin: that many rows")
    add("--latin", action="store_true", help="a Latin hypercube between the values instead of a grid")
    add("--seed", metavar="N", type=bounded(0, 2**31, int), default=1, help="random seed of --latin")
    add("--out", metavar="DIR", default="sweep", help="where the rows go")
    _shared(parser, "--self-contained", "--scheduler")
    add("--chunk", metavar="N", type=bounded(1, 100_000, int), default=0, help="rows a file (default: 1 to 8)")


#: title of a group -> command -> line of help, function that adds its options
COMMANDS: dict[str, dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]]] = {
    "part": {
        "init": ("print a first cell file for a program", _add_init),
        "check": ("say whether a path, or its corrected trajectory, may be run", _add_check),
        "compensate": ("revise the trajectory of a cell; tables, report and robot programs", _add_compensate),
        "identify": ("find compliances, force coefficients and modes from measurements of the own cell", _add_identify),
        "map": (
            "where to clamp the part and how to turn the tool: reach, limits and predicted error over placements",
            _add_map,
        ),
        "simulate": ("simulate one pass of a cell", _add_simulate),
        "sweep": ("full passes with other values of any keys, on as many cores as there are", _add_sweep),
        "demo": ("run the paper's case: original pass and compensations, tables and report", _add_demo),
        "keys": ("list the keys of a cell file with unit, range, default and meaning", _add_keys),
    },
    "robot": {
        "stiffness": ("pose, stiffness and natural frequencies of an arm at one posture", _add_stiffness),
        "stability": ("limit depth of cut and chatter frequency over spindle speed", _add_stability),
        "compare": ("set a measured pass beside the simulated one", _add_compare),
        "rsi": ("correct a running robot program over KUKA RobotSensorInterface", _add_rsi),
    },
    "ROS": {
        "run": ("run the passes of a cell as ROS 2 nodes, each recorded to MCAP", _add_run),
        "replay": ("play a recording back onto topics, or recompute it bit for bit", _add_replay),
    },
    "recordings": {
        "info": ("show what a recording holds", _add_info),
        "report": ("make the report of one or several recordings", _add_report),
        "export": ("write the topics of a recording as tables", _add_export),
        "recover": ("make a whole recording of one that was cut off or damaged", _add_recover),
    },
}


def make_parser(argv: Sequence[str] | None = None) -> Parser:
    """Return the parser of the command line: of the command that ``argv`` names alone, or of all (default)."""
    chosen = None if argv is None else next((word for word in argv if not word.startswith("-")), "")
    listing = [
        f"{title}:\n" + "".join(f"  {name:12}{text}\n" for name, (text, _) in group.items())
        for title, group in COMMANDS.items()
    ]
    parser = Parser(
        prog="kr270_milling",
        description="Predict and compensate the compliance errors of robotic milling.",
        epilog="\n".join([*listing, "example: kr270_milling demo --out out"]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("-V", "--version", action="version", version=f"kr270_milling {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    known = {name: command for group in COMMANDS.values() for name, command in group.items()}
    for name, (text, add) in ({chosen: known[chosen]} if chosen in known else known).items():
        if chosen in {name, None}:
            _add_command(commands, name, text, add)
        else:
            commands.add_parser(name)
    return parser


def _add_command(commands, name: str, text: str, add, json_default=False, **more) -> None:
    """Add a sub-parser; more: keywords of ``add_parser``."""
    parser = commands.add_parser(name, description=text[0].upper() + text[1:] + ".", **more)
    add(parser)
    parser.show_defaults()
    text = "print one JSON object to standard output"
    parser.add_argument("--json", help=text, action="store_true", default=json_default)
    parser.set_defaults(parser=parser)
