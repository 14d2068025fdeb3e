"""The commands about recordings: ``info``, ``export`` and ``recover``."""

from __future__ import annotations

import shlex
import sys

from kr270_milling.base.column import as_dict
from kr270_milling.base.errors import one_line
from kr270_milling.base.units import seconds
from kr270_milling.recordings.bag import info as bag_info
from kr270_milling.recordings.bag.export import export as export_files
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import findings
from kr270_milling.recordings.bag.recover import recover as recover_file
from kr270_milling.show.commands.console import Answer, progress


def run_info(args) -> Answer:
    with progress("reading") as report, Recording(args.file, report) as recording:
        damage = findings(recording, report) if args.verify else []
        about = {"file": str(recording.path)} if damage else bag_info.info(recording, report)
    if damage:
        shown = [f"{about['file']}: damaged", *("  " + one_line(sentence) for sentence in damage)]
        shown.append(f"to save what can be read: kr270_milling recover {shlex.quote(str(args.file))}")
    else:
        shown = [bag_info.info_text(about), *["whole: every checksum and count fits"] * args.verify]
    return Answer(about | ({"damage": damage} if args.verify else {}), shown, code=int(bool(damage)))


def run_export(args) -> Answer:
    """Exit code 1 where a topic cannot be exported."""
    with progress("exporting") as report, Recording(args.file, report) as recording:
        files, refused = export_files(recording, args.csv, args.topics, report)
        first, last = recording.first_log_time or 0, recording.last_log_time or 0
    about = {"file": str(recording.path), "cut_off": recording.cut_off, "files": files, "refused": refused}
    for sentence in () if args.json else refused.values():
        print("not exported: " + one_line(sentence), file=sys.stderr)
    cut = [f"{recording.path} was cut off; this is what it holds, {seconds(last - first)} s"]
    return Answer(about, [*(cut if recording.cut_off else ()), *files], code=int(bool(refused)))


def run_recover(args) -> Answer:
    with progress("recovering") as report:
        recovered = recover_file(args.file, args.out, report)
    if recovered.whole and args.out is None:
        return Answer(as_dict(recovered), [f"{recovered.source}: is whole, nothing to recover; unchanged"])
    state = "was whole already" if recovered.whole else f"{recovered.lost_bytes} bytes of it could not be used"
    shown = [f"{recovered.source}: {state}"]
    shown += ["  damage: " + one_line(sentence) for sentence in recovered.damage]
    shown += ["  lost: " + one_line(sentence) for sentence in recovered.dropped]
    if recovered.lost_messages:
        shown.append(f"  {recovered.lost_messages} messages are lost")
    return Answer(as_dict(recovered), [*shown, f"{recovered.messages} messages in {recovered.directory}"])
