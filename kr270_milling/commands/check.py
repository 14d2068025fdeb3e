"""``kr270_milling check``: whether a path, or its corrected trajectory, may be run. Exit code 1 if it must not."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_cell, add_common, print_json
from kr270_milling.commands.progress import progress


def add_arguments(parser) -> None:
    add_cell(parser)
    parser.add_argument("--reference", metavar="FILE.csv", help="check this trajectory, as written by compensate")
    parser.add_argument("--motion", choices=("LIN", "SPLINE"), help="default: the cell's program.motion")
    add_common(parser)


def run(args) -> int:
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.decision.check import check
    from kr270_milling.decision.tolerance import judge
    from kr270_milling.trajectory.trajectory_csv import read_csv

    cell = read_cell(find_file(args.cell), args.set)
    reference = None if args.reference is None else read_csv(Path(args.reference))[0]
    with progress("checking") as report:
        checked = check(cell, reference, args.motion, progress=report)
        tolerance = judge(cell, checked.ran) if checked.ran else None
    if args.json:
        print_json(
            {
                "cell": args.cell,
                "reference": args.reference,
                **checked.as_dict(),
                "tolerance": tolerance and tolerance.as_dict(),
            }
        )
    else:
        if tolerance:
            print(f"{'as programmed' if reference is None else 'corrected'}: {tolerance.words}")
        print("\n".join(checked.lines()))
    return 0 if checked.may_be_run else 1
