"""Faults in mid-pass, or long runs, of the whole graph: ``python -m faults``, in this folder's parent.

Exit code 1 if a row fails, 2 with a sentence for an argument that cannot be used.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import tempfile
import time
from pathlib import Path

from ros_domain import COUNT, is_used

from faults.faults import FAULTS
from faults.rows import COLUMNS, expected_seconds, run_faults
from faults.soak import COLUMNS as SOAK_COLUMNS
from faults.soak import run_soak
from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.live.graph.plan import fresh_directory
from kr270_milling.live.ros.environment import require_ros
from kr270_milling.show.commands.console import print_json
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
    parser.add_argument("--soak", action="store_true", help="no fault: many passes in one graph, and a long recording")
    parser.add_argument("--repeats", type=_count, default=10, metavar="N", help="of every fault (default: 10)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the times of the faults (default: 1)")
    parser.add_argument("--only", metavar="NAME", help="only the faults whose name contains this")
    parser.add_argument("--passes", type=_count, default=100, metavar="N", help="of the soak (default: 100)")
    parser.add_argument("--minutes", type=_minutes, default=10.0, metavar="M", help="of its recording (default: 10)")
    parser.add_argument("--out", metavar="DIR", help="keep recordings and logs there (default: they are removed)")
    parser.add_argument("--markdown", action="store_true", help="print a table in Markdown")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 1000:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to 1000")
    return int(text)


def _minutes(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.01 <= value <= 1000.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0.01 to 1000")
    return value


def _faults(args, directory) -> int:
    faults = [fault for fault in FAULTS if (args.only or "").lower() in fault.name.lower()]
    if not faults:
        raise InputError(
            "--only", f"no fault is named like {args.only!r}; there are {', '.join(f.name for f in FAULTS)}"
        )
    minutes = expected_seconds(faults, args.repeats) / 60
    print(f"seed {args.seed}; this takes about {minutes:.0f} min", file=sys.stderr)
    start = time.perf_counter()
    with progress("faults") as report:
        rows = run_faults(faults, args.repeats, args.seed, directory, report)
    seconds, failed = time.perf_counter() - start, sum(bool(row.problems) for row in rows)
    if args.json:
        print_json({"seed": args.seed, "rows": [r.as_dict() for r in rows], "failed": failed, "wall_s": seconds})
    else:
        _print(list(COLUMNS), [row.cells() for row in rows], args.markdown)
        print(f"{len(rows)} rows, {failed} FAILED; seed {args.seed}; {seconds:.0f} s")
        for row in rows:
            print("".join(f"{row.fault.name}, {problem}\n" for problem in row.problems), end="")
    return 1 if failed else 0


def _soak(args, directory) -> int:
    print(f"this takes about {args.minutes + args.passes * 5 / 60:.0f} min", file=sys.stderr)
    with progress("soak") as report:
        rows = run_soak(args.passes, args.minutes * 60, directory, report)
    failed = sum(bool(row.problems) for row in rows)
    if args.json:
        print_json({"rows": [row.as_dict() for row in rows], "failed": failed})
    else:
        _print(list(SOAK_COLUMNS), [row.cells() for row in rows], args.markdown)
        for row in rows:
            print("".join(f"{row.name}: {problem}\n" for problem in row.problems), end="")
    return 1 if failed else 0


def _print(columns: list[str], rows: list[list[str]], markdown: bool) -> None:
    if markdown:
        for row in (columns, ["---"] * len(columns), *rows):
            print("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |")
        print()
        return
    for row in rows:  # a table of this width would be cut off
        print(row[0])
        for name, cell in zip(columns[1:], row[1:], strict=True):
            print(f"    {name:28} {cell}")


if __name__ == "__main__":
    raise SystemExit(main())
