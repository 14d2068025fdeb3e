"""Every command with its text, its example, its options, and the function that runs it: light to import."""

from __future__ import annotations

import argparse

from kr270_milling.commands.command import Group, command, option
from kr270_milling.commands.identify_options import IDENTIFY, POSTURE, SENSOR_ABC, SENSOR_ON
from kr270_milling.compensation.methods import METHODS
from kr270_milling.nodes.play_arguments import PLAY, bounded, grid, numbers

__all__ = ["COMMANDS", "FEWEST_PLANTS", "LOBE_SPEEDS", "PLANTS"]

PLANTS, FEWEST_PLANTS = 32, 8  #: of a verdict
LOBE_SPEEDS = 60

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
PLACES = grid(-1e5, 1e5, 1_000_000)

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
        option("--x LOW:HIGH:COUNT", "[mm] of the workpiece's origin on base_link", PLACES),
        option("--y LOW:HIGH:COUNT", "[mm] likewise", PLACES),
        option("--z LOW:HIGH:COUNT", "[mm] likewise", PLACES),
        option("--turn LOW:HIGH:COUNT", "[deg] of the workpiece about z of base_link, on top of the cell's", PLACES),
        option("--tool-turn LOW:HIGH:COUNT", "[deg] of the tool about its own axis", PLACES),
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
        SENSOR_ON,
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
