"""``kr270_milling compensate``: the revised trajectory of a cell and what it is predicted to achieve."""

from __future__ import annotations

from kr270_milling.commands.console import add_cell, add_common, output_directory, print_json, print_table, progress
from kr270_milling.compensation.methods import METHODS


def add_arguments(parser) -> None:
    add_cell(parser)
    parser.add_argument("--method", choices=METHODS, help="default: the cell's compensation.method")
    parser.add_argument("--out", metavar="DIR", required=True, help="where the revised trajectory goes")
    add_common(parser)


def run(args) -> None:
    from kr270_milling.cell import read_cell
    from kr270_milling.config import find_file
    from kr270_milling.passes import commanded_joints, compensated, simulate
    from kr270_milling.trajectory.trajectory_csv import write_csv

    cell = read_cell(find_file(args.cell), args.set)
    method = args.method or cell.compensation.method
    directory = output_directory(args.out)
    with progress("original pass") as report:
        original = simulate(cell, progress=report)
    with progress(f"{method} pass") as report:
        revised = compensated(cell, original, method, report)
    path = directory / f"reference_{method}.csv"
    write_csv(path, revised.reference, commanded_joints(cell, revised.reference))
    found = {"method": method, "trajectory": str(path), "points": len(revised.reference)}
    found |= {k: v for k, v in revised.row().items() if k != "name"}
    found["original"] = {k: v for k, v in original.row().items() if k != "name"}
    if args.json:
        print_json(found)
        return
    rows = [
        [p.name, f"{p.scores.static_deviation * 1e6:.2f}", f"{p.scores.max_deviation * 1e6:.2f}"]
        for p in (original, revised)
    ]
    print_table("Predicted path deviation [um]", ["pass", "static", "max"], rows)
    print(f"{found['points']} reference points: {path}")
