"""``kr270_milling info``: what a recording holds."""

from __future__ import annotations

from kr270_milling.commands.console import EXIT_FAILED, add_common, print_json
from kr270_milling.commands.progress import progress


def add_arguments(parser) -> None:
    parser.add_argument("file", metavar="FILE.mcap|DIR", help="a recording, also one that was cut off")
    parser.add_argument("--verify", action="store_true", help="check every byte; exit code 1 where damage is found")
    add_common(parser)


def run(args) -> int:
    from kr270_milling.bag.info import info, info_text
    from kr270_milling.bag.reader import Recording
    from kr270_milling.bag.verify import findings
    from kr270_milling.base.errors import one_line

    with progress("reading") as report, Recording(args.file, report) as recording:
        damage = findings(recording, report) if args.verify else []
        about = {"file": str(recording.path)} if damage else info(recording, report)
    if args.json:
        print_json(about | ({"damage": damage} if args.verify else {}))
        return EXIT_FAILED if damage else 0
    print(f"{about['file']}: damaged; recover saves what can be read" if damage else info_text(about))
    for sentence in damage:
        print("  " + one_line(sentence))
    if args.verify and not damage:
        print("whole: every checksum and index fits")
    return EXIT_FAILED if damage else 0
