"""``kr270_milling replay``: play a recording onto topics, or recompute it."""

from __future__ import annotations

from kr270_milling.base.column import as_dict, table_of
from kr270_milling.base.errors import InputError, one_line
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.live.ros.environment import require_ros
from kr270_milling.recordings.bag.reader import remapping
from kr270_milling.show.commands.console import Answer, progress


def run_replay(args) -> Answer:
    if args.recompute:
        return _recompute(args)
    return _play(args)


def _play(args) -> Answer:
    if args.remap:
        allowed = "names topics for --recompute; a playback takes --ros-args -r RECORDED:=NAME"
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
