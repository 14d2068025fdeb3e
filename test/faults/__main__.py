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
from faults.faults import FAULTS
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
        print(f"ROS domain {os.environ['ROS_DOMAIN_ID']}", file=sys.stderr)
        kept = contextlib.nullcontext(fresh_directory(args.out)) if args.out else tempfile.TemporaryDirectory()
        with kept as directory:
            Path(directory, "cell.yaml").touch()  # the next run finds that this directory is taken
            return (_soak if args.soak else _faults)(args, Path(directory))
    except MillingError as error:
        print(f"faults: {error}", file=sys.stderr)
        return 2


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


def _faults(args, directory) -> int:
    faults = [fault for fault in FAULTS if args.only.lower() in fault.name.lower()]
    if not faults:
        names = ", ".join(fault.name for fault in FAULTS)
        raise InputError("--only", f"no fault is named like {args.only!r}; there are {names}")
    minutes = trials.SECONDS * len(faults) * args.repeats / 60
    print(f"seed {args.seed}; this takes about {minutes:.0f} min", file=sys.stderr)
    with progress("faults") as report:
        rows = trials.run_faults(faults, args.repeats, args.seed, directory, report)
    return _print(trials.COLUMNS, {row.fault.name: row for row in rows})


def _soak(args, directory) -> int:
    print(f"this takes about {args.minutes + args.passes * 5 / 60:.0f} min", file=sys.stderr)
    with progress("soak") as report:
        rows = soak.run_soak(args.passes, args.minutes * 60, directory, report)
    return _print(soak.COLUMNS, {row.name: row for row in rows})


def _print(columns, rows: dict) -> int:
    """Print a table in Markdown and the problems of its rows; return the exit code."""
    for cells in (columns, ["---"] * len(columns), *(row.cells() for row in rows.values())):
        print("| " + " | ".join(cells) + " |")
    for name, row in rows.items():
        print("".join(f"{name}, {problem}\n" for problem in row.problems), end="")
    return int(any(row.problems for row in rows.values()))


if __name__ == "__main__":
    raise SystemExit(main())
