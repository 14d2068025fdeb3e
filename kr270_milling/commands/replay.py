"""``kr270_milling replay``: play a recording onto topics, recompute it, or compensate from it."""

from __future__ import annotations

import argparse
from pathlib import Path

from kr270_milling.base.errors import one_line
from kr270_milling.commands.console import EXIT_FAILED, add_common, output_directory, print_json, print_table
from kr270_milling.commands.progress import progress
from kr270_milling.compensation.methods import METHODS
from kr270_milling.nodes.play_arguments import add_play_arguments, play_options


def add_arguments(parser) -> None:
    parser.add_argument("file", metavar="FILE.mcap|DIR", help="a recording")
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--recompute", action="store_true",
        help="no playback: recompute every output and compare bit for bit; exit code 1 if one differs, is "
        "missing or is left over, or the recompute cannot go on",
    )  # fmt: skip
    what.add_argument(
        "--compensate", action="store_true", help="no playback: the revised trajectory from the recorded pass"
    )
    parser.add_argument("--method", choices=METHODS, help="with --compensate: in place of the recorded method")
    parser.add_argument("--out", metavar="DIR", help="with --compensate: write reference_trajectory.csv there")
    add_common(parser)
    add_play_arguments(parser.add_argument_group("playback (names as in ros2 bag play)"))
    parser.add_argument("--ros-args", nargs=argparse.REMAINDER, default=[], help="remapping and namespace; the last")


def run(args) -> int:
    if args.recompute:
        return _recompute(args)
    if args.compensate:
        return _compensate(args)
    return _play(args)


def _play(args) -> int:
    from kr270_milling.ros.environment import require_ros

    require_ros()
    from kr270_milling.nodes.player import play

    with progress("playing") as report:
        code, count = play(play_options(args), ["--ros-args", *args.ros_args] if args.ros_args else [], report)
    if args.json:
        print_json({"file": args.file, "messages": count, "exit_code": code})
    return code


def _recompute(args) -> int:
    from kr270_milling.replay.recompute import recompute

    with progress("recomputing") as report:
        result = recompute(args.file, report)
    if args.json:
        print_json(result.as_dict())
        return EXIT_FAILED if result.verdict != "identical" else 0
    names = ["compared", "differing", "missing", "repeated", "given", "not_compared"]
    rows = [
        [_shown(topic), *(str(c.as_dict()[name]) for name in names)] for topic, c in sorted(result.channels.items())
    ]
    print_table(result.file, ["topic", *(name.replace("_", " ") for name in names)], rows)
    if result.cut_off:
        print("The recording was cut off; what is there was compared.")
    for stop in result.stops:
        print(_shown(stop))
    for sentence in result.damage:
        print("damage: " + _shown(sentence))
    if result.first:
        print(f"first difference: {_shown(result.first)}")
    print(f"{result.verdict}: {result.compared} messages compared bit for bit")
    if result.verdict == "different" and result.as_dict()["version"] != result.version:
        print(f"(recorded by version {result.version}, recomputed by {result.as_dict()['version']})")
    return EXIT_FAILED if result.verdict != "identical" else 0


TOLD = {
    True: "identical to what the node published",
    False: "NOT what the node published",
    None: "not to be compared with a recorded one",
}


def _shown(value) -> str:
    return one_line(str(value))


def _compensate(args) -> int:
    from kr270_milling.replay.compensate import compensate

    with progress("compensating") as report:
        found = compensate(args.file, args.method, report)
    files = [_write(args.out, revised) for revised in found] if args.out else [None] * len(found)
    if args.json:
        print_json({"file": args.file, "robots": [r.as_dict() | {"csv": f} for r, f in zip(found, files, strict=True)]})
        return 0
    for revised, file in zip(found, files, strict=True):
        print(
            f"{_shown(revised.robot or '/')}: {revised.method}, {len(revised.reference)} points; the recorded pass was "
            f"off by up to {revised.remaining_error * 1e6:.2f} um, the largest correction is "
            f"{revised.largest_correction * 1e6:.2f} um"
        )
        told: dict[bool | None, str] = {
            True: "identical to what the node published",
            False: "NOT what the node published",
        }
        print("  " + told.get(revised.published, "not to be compared with a recorded one"))
        print(f"  written to {file}" if file else "  (--out DIR writes it as CSV)")
    return EXIT_FAILED if any(r.published is False for r in found) else 0


def _write(out: str, revised) -> Path:
    from kr270_milling.trajectory.trajectory_csv import write_csv

    prefix = revised.robot.strip("/").replace("/", "_")
    path = output_directory(out) / f"{prefix + '_' if prefix else ''}reference_trajectory.csv"
    write_csv(path, revised.reference, revised.joints)
    return path
