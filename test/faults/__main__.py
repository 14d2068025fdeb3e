"""Faults in mid-pass, or long runs, of the whole graph: ``python -m faults``, in this folder's parent.

Exit code 1 if a row fails, 2 with a sentence for an argument that cannot be used.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import tempfile
from pathlib import Path

from ros_domain import COUNT, is_used

from faults import soak, trials
from faults.faults import FAULTS, Fault
from kr270_milling.base.arguments import bounded
from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.live.graph.plan import fresh_directory
from kr270_milling.live.ros.environment import require_ros
from kr270_milling.show.commands.progress import progress


def main(arguments: list[str] | None = None) -> int:
    args = _parser().parse_args(arguments)
    try:
        require_ros()
        if not os.environ.get("ROS_DOMAIN_ID"):  # a domain without open ports
            os.environ["ROS_DOMAIN_ID"] = str(next((n for n in range(COUNT, 0, -1) if not is_used(n)), 0))
        print(f"ROS domain {os.environ['ROS_DOMAIN_ID']}, seed {args.seed}", file=sys.stderr)
        kept = contextlib.nullcontext(fresh_directory(args.out)) if args.out else tempfile.TemporaryDirectory()
        with kept as directory, progress("soak" if args.soak else "faults") as report:
            Path(directory, "cell.yaml").touch()  # the next run finds that this directory is taken
            if args.soak:
                columns = soak.COLUMNS
                rows = soak.run_soak(args.passes, args.minutes * 60, Path(directory), report)
            else:
                columns = trials.COLUMNS
                rows = trials.run_faults(_named(args.only), args.repeats, args.seed, Path(directory), report)
    except MillingError as error:
        print(f"faults: {error}", file=sys.stderr)
        return 2
    for cells in (columns, ["---"] * len(columns), *(row.cells() for row in rows)):
        print("| " + " | ".join(cells) + " |")
    print("".join(f"{row.name}, {problem}\n" for row in rows for problem in row.problems), end="")
    return int(any(row.problems for row in rows))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m faults", description="Disturb the graph of nodes on purpose.")
    add, count = parser.add_argument, bounded(1, 1000, int)
    add("--soak", action="store_true", help="no fault: many passes in one graph, and a long recording")
    add("--repeats", type=count, default=10, metavar="N", help="of every fault (default: 10)")
    add("--seed", type=int, default=1, metavar="S", help="of the times of the faults (default: 1)")
    add("--only", default="", metavar="NAME", help="only the faults whose name contains this")
    add("--passes", type=count, default=100, metavar="N", help="of the soak (default: 100)")
    add("--minutes", type=bounded(0.01, 1000.0), default=10.0, metavar="M", help="of its recording (default: 10)")
    add("--out", metavar="DIR", help="keep recordings and logs there (default: they are removed)")
    return parser


def _named(text: str) -> list[Fault]:
    faults = [fault for fault in FAULTS if text.lower() in fault.name.lower()]
    if not faults:
        names = ", ".join(fault.name for fault in FAULTS)
        raise InputError("--only", f"no fault is named like {text!r}; there are {names}")
    return faults


if __name__ == "__main__":
    raise SystemExit(main())
