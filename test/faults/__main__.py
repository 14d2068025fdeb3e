"""Faults in mid-pass, or many passes, of the whole graph: ``python -m faults``, in this folder's parent.

Exit code 1 if a row fails, 2 with a sentence where no graph can be started.
"""

import argparse
import contextlib
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from ros_domain import COUNT, is_used

from faults import soak, trials
from faults.faults import FAULTS
from kr270_milling.base.arguments import bounded
from kr270_milling.base.errors import MillingError
from kr270_milling.base.files import fresh_directory
from kr270_milling.live.ros.environment import require_ros


def main(arguments: list[str] | None = None) -> int:
    args = _parser().parse_args(arguments)
    problems = 0
    try:
        require_ros()
        if not os.environ.get("ROS_DOMAIN_ID"):  # a domain without open ports
            os.environ["ROS_DOMAIN_ID"] = str(next((n for n in range(COUNT, 0, -1) if not is_used(n)), 0))
        print(f"ROS domain {os.environ['ROS_DOMAIN_ID']}, seed {args.seed}", file=sys.stderr)
        place = contextlib.nullcontext(fresh_directory(args.out)) if args.out else tempfile.TemporaryDirectory()
        with place as directory:
            Path(directory, "cell.yaml").touch()  # the next run finds that this directory is taken
            if args.soak:
                columns = soak.COLUMNS
                rows = soak.run_soak(args.passes, Path(directory))
            else:
                columns = trials.COLUMNS
                faults = [fault for fault in FAULTS if args.only.lower() in fault.name.lower()]
                rows = trials.run_faults(faults, args.repeats, args.seed, Path(directory))
            _print_row(columns)
            _print_row(["---"] * len(columns))
            for row in rows:
                name, *_ = cells = row.cells()
                _print_row(cells)
                for problem in row.problems:
                    print(f"{name}, {problem}", file=sys.stderr)
                    problems += 1
    except MillingError as error:
        print(f"faults: {error}", file=sys.stderr)
        return 2
    return int(problems > 0)


def _print_row(cells: Sequence[str]) -> None:
    print("| " + " | ".join(cells) + " |", flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m faults", description="Disturb the graph of nodes on purpose.")
    add, count = parser.add_argument, bounded(1, 1000, int)
    add("--soak", action="store_true", help="no fault: many passes in one graph")
    add("--repeats", type=count, default=10, metavar="N", help="of every fault (default: 10)")
    add("--seed", type=int, default=1, metavar="S", help="of the times of the faults (default: 1)")
    add("--only", default="", metavar="NAME", help="only the faults whose name contains this")
    add("--passes", type=count, default=100, metavar="N", help="of the soak (default: 100)")
    add("--out", metavar="DIR", help="keep recordings and logs there (default: they are removed)")
    return parser


if __name__ == "__main__":
    raise SystemExit(main())
