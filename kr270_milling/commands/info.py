"""``kr270_milling info``: what a recording holds."""

from __future__ import annotations

from kr270_milling.commands.console import add_common, print_json, progress


def add_arguments(parser) -> None:
    parser.add_argument("file", metavar="FILE.mcap|DIR", help="a recording, also one that was cut off")
    add_common(parser)


def run(args) -> None:
    from kr270_milling.bag.info import info, info_text
    from kr270_milling.bag.reader import Recording

    with progress("reading") as report, Recording(args.file, report) as recording:
        found = info(recording, report)
    if args.json:
        print_json(found)
    else:
        print(info_text(found))
