"""``kr270_milling check``: whether a path, or its corrected trajectory, may be run. Exit code 1 if it must not."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_cell, add_common, print_json, progress

SHOWN = 3  #: findings of one kind that are printed


def add_arguments(parser) -> None:
    add_cell(parser)
    parser.add_argument("--reference", metavar="FILE.csv", help="check this trajectory, as written by compensate")
    parser.add_argument("--motion", choices=("LIN", "SPLINE"), help="default: the cell's program.motion")
    add_common(parser)


def run(args) -> int:
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.decision.check import check
    from kr270_milling.trajectory.trajectory_csv import read_csv

    cell = read_cell(find_file(args.cell), args.set)
    reference = None if args.reference is None else read_csv(Path(args.reference))[0]
    with progress("checking") as report:
        checked = check(cell, reference, args.motion, progress=report)
    if args.json:
        print_json({"cell": args.cell, "reference": args.reference, **checked.as_dict()})
    else:
        print_findings(checked)
    return 1 if checked.stops else 0


def print_findings(checked) -> None:
    """A few lines for each kind, then the summary."""
    seen: dict[tuple[str, str], int] = {}
    pairs = list(zip(checked.findings, checked.sentences(), strict=True))
    for finding, sentence in pairs:
        key = finding.severity, finding.kind
        seen[key] = seen.get(key, 0) + 1
        if seen[key] <= SHOWN:
            print(f"{finding.severity:8} {sentence}")
    for (severity, kind), count in seen.items():
        if count > SHOWN:
            print(f"{severity:8} {kind}: {count - SHOWN} more (--json lists them)")
    counts = ", ".join(f"{checked.count(s)} {s}{'' if checked.count(s) == 1 else 's'}" for s in ("stop", "warning"))
    verdict = "must not be run" if checked.stops else "may be run, after a test in T1"
    print(f"{checked.points} points, {counts}: the path {verdict}")
