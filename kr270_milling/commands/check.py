"""``kr270_milling check``: whether a path, or its corrected trajectory, may be run. Exit code 1 if it must not."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import add_cell, cell_of, option
from kr270_milling.commands.progress import progress


def add_arguments(parser) -> None:
    add_cell(parser)
    option(parser, "--reference FILE.csv", "check this trajectory, as written by compensate")
    option(parser, "--motion", "default: the cell's program.motion", choices=("LIN", "SPLINE"))


def run(args) -> Answer:
    from kr270_milling.decision.check import check
    from kr270_milling.decision.tolerance import judge
    from kr270_milling.trajectory.trajectory_csv import read_csv

    cell = cell_of(args)
    reference = None if args.reference is None else read_csv(Path(args.reference))[0]
    with progress("checking") as report:
        checked = check(cell, reference, args.motion, progress=report)
        tolerance = judge(cell, checked.ran) if checked.ran else None
    found = {"cell": args.cell, "reference": args.reference, **checked.as_dict()}
    found["tolerance"] = tolerance and tolerance.as_dict()
    words = [f"{'as programmed' if reference is None else 'corrected'}: {tolerance.words}"] if tolerance else []
    return Answer(found, [*words, *checked.lines()], code=int(not checked.may_be_run))
