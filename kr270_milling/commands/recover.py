"""``kr270_milling recover``: a whole recording out of one that was cut off or damaged."""

from __future__ import annotations

from kr270_milling.commands.console import add_common, print_json
from kr270_milling.commands.progress import progress


def add_arguments(parser) -> None:
    parser.add_argument("file", metavar="FILE.mcap|DIR", help="the damaged recording; it is not touched")
    parser.add_argument(
        "--out", metavar="DIR", help="the new recording (default: beside it, with _recovered; none of a whole one)"
    )
    add_common(parser)


def run(args) -> None:
    from kr270_milling.bag.recover import recover
    from kr270_milling.base.errors import one_line

    with progress("recovering") as report:
        found = recover(args.file, args.out, report)
    if args.json:
        print_json(found.as_dict())
        return
    if found.whole and args.out is None:
        print(f"{found.source}: is whole, nothing to recover; left as it is")
        return
    state = "was whole already" if found.whole else f"{found.lost_bytes} bytes of it could not be used"
    print(f"{found.source}: {state}")
    for sentence in found.damage:
        print("  damage: " + one_line(sentence))
    for sentence in found.dropped:
        print("  lost: " + one_line(sentence))
    if found.lost_messages:
        print(f"  {found.lost_messages} messages are lost")
    print(f"{found.messages} messages in {found.directory}")
