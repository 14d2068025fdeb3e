"""``kr270_milling info``: what a recording holds."""

from __future__ import annotations

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import option
from kr270_milling.commands.progress import progress


def add_arguments(parser) -> None:
    option(parser, "file FILE.mcap|DIR", "a recording, also one that was cut off")
    option(parser, "--verify", "check every byte; exit code 1 where damage is found", bool)


def run(args) -> Answer:
    from kr270_milling.bag.info import info, info_text
    from kr270_milling.bag.reader import Recording
    from kr270_milling.bag.verify import findings
    from kr270_milling.base.errors import one_line

    with progress("reading") as report, Recording(args.file, report) as recording:
        damage = findings(recording, report) if args.verify else []
        about = {"file": str(recording.path)} if damage else info(recording, report)
    shown = [f"{about['file']}: damaged; recover saves what can be read" if damage else info_text(about)]
    shown += ["  " + one_line(sentence) for sentence in damage]
    if args.verify and not damage:
        shown.append("whole: every checksum and index fits")
    return Answer(about | ({"damage": damage} if args.verify else {}), shown, code=int(bool(damage)))
