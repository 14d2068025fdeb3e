"""``kr270_milling replay``: play a recording onto topics, recompute it, or compensate from it."""

from __future__ import annotations

from kr270_milling.base.column import as_dict, table_of
from kr270_milling.base.errors import InputError, one_line
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.revisions import compensate_recording
from kr270_milling.live.ros.environment import require_ros
from kr270_milling.path.trajectory_csv import write_csv
from kr270_milling.recordings.bag.reader import remapping
from kr270_milling.show.commands.console import Answer, output_directory, progress

PUBLISHED: dict = {
    True: "identical to what the node published",
    False: "NOT what the node published",
    None: "not to be compared with a recorded one",
}


def run_replay(args) -> Answer:
    if args.recompute:
        return _recompute(args)
    if args.compensate:
        return _compensate(args)
    return _play(args)


def _play(args) -> Answer:
    if args.remap:
        allowed = "names topics for --recompute and --compensate; a playback takes --ros-args -r RECORDED:=NAME"
        raise InputError("--remap", allowed)
    require_ros("the playback")
    from kr270_milling.live.nodes.player import run_player

    with progress("playing") as report:
        code, count = run_player(args, ["--ros-args", *args.ros_args] if args.ros_args else [], report)
    return Answer({"file": args.file, "messages": count, "exit_code": code}, [], code=code)


def _recompute(args) -> Answer:

    with progress("recomputing") as report:
        result = recompute(args.file, report, remapping(args.remap), args.cell)
    about = as_dict(result)
    rows = ({"topic": _shown(topic), **vars(count)} for topic, count in sorted(result.channels.items()))
    counts = ("compared", "differing", "missing", "not_compared")
    columns = [("topic", "topic", 0), *((name.replace("_", " "), name, str) for name in counts)]
    shown: list = [table_of(result.file, columns, rows)]
    if result.cut_off:
        shown.append("The recording was cut off; the recorded part was compared.")
    shown += [*map(_shown, result.sentences), *("damage: " + _shown(sentence) for sentence in result.damage)]
    if result.first:
        shown.append(f"first difference: {_shown(result.first)}")
    shown.append(f"{result.verdict}: {result.compared} messages compared bit for bit")
    if result.verdict == "different" and about["version"] != result.version:
        shown.append(f"(recorded by version {result.version}, recomputed by {about['version']})")
    return Answer(about, shown, code=int(result.verdict != "identical"))


def _shown(value) -> str:
    return one_line(str(value))


def _compensate(args) -> Answer:

    with progress("compensating") as report:
        revisions = compensate_recording(args.file, args.method, report, remapping(args.remap), args.cell)
    robots, shown = [], []
    for revised in revisions:
        file = None
        if args.out:
            prefix = revised.robot.strip("/").replace("/", "_")
            file = output_directory(args.out) / f"{prefix + '_' if prefix else ''}reference_trajectory.csv"
            write_csv(file, revised.reference, revised.joints)
        robots.append(revised.as_dict() | {"csv": file})
        shown += [
            f"{_shown(revised.robot or '/')}: {revised.method}, {len(revised.reference)} points; the recorded pass was "
            f"off by up to {revised.remaining_error * 1e6:.2f} um, the largest correction is "
            f"{revised.largest_correction * 1e6:.2f} um",
            "  " + PUBLISHED[revised.published],
            f"  written to {file}" if file else "  (--out DIR writes it as CSV)",
        ]
    differs = any(revised.published is False for revised in revisions)
    return Answer({"file": args.file, "robots": robots}, shown, code=int(differs))
