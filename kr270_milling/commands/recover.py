"""``kr270_milling recover``: a whole recording out of one that was cut off or damaged."""

from __future__ import annotations

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import option
from kr270_milling.commands.progress import progress


def add_arguments(parser) -> None:
    option(parser, "file FILE.mcap|DIR", "the damaged recording; it is not touched")
    option(parser, "--out DIR", "the new recording (default: beside it, with _recovered; none of a whole one)")


def run(args) -> Answer:
    from kr270_milling.bag.recover import recover
    from kr270_milling.base.errors import one_line

    with progress("recovering") as report:
        found = recover(args.file, args.out, report)
    if found.whole and args.out is None:
        return Answer(found.as_dict(), [f"{found.source}: is whole, nothing to recover; left as it is"])
    state = "was whole already" if found.whole else f"{found.lost_bytes} bytes of it could not be used"
    shown = [f"{found.source}: {state}"]
    shown += ["  damage: " + one_line(sentence) for sentence in found.damage]
    shown += ["  lost: " + one_line(sentence) for sentence in found.dropped]
    if found.lost_messages:
        shown.append(f"  {found.lost_messages} messages are lost")
    return Answer(found.as_dict(), [*shown, f"{found.messages} messages in {found.directory}"])
