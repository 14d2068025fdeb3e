"""``kr270_milling demo``: the paper's case, original and compensated, with table and report."""

from __future__ import annotations

from kr270_milling.commands.console import add_common, command_line, print_json, print_table, progress

METHODS = ("linear", "spline", "learned")
PAPER = {"original": ("58.10", "63.20"), "linear": ("0.14", "4.70")}


def add_arguments(parser) -> None:
    parser.add_argument("--out", metavar="DIR", default="out", help="where report and series go (default: out)")
    parser.add_argument("--plain", action="store_true", help="the plain loop, also where ROS is installed")
    add_common(parser)


def run(args) -> None:
    import importlib.util

    from kr270_milling.base.files import staged
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell

    source = find_file("paper.yaml")
    cell = read_cell(source)
    if args.plain or importlib.util.find_spec("rclpy") is None:
        how = "plain loop in one process" + ("" if args.plain else ", since rclpy is not installed")
        with staged(args.out) as (draft, final):
            passes = _plain(cell)
            report = final(_write(draft, cell, passes, source, args))
        return _tell(args, passes, {"report": str(report), "out": args.out, "ran_as": how})
    from kr270_milling.commands.run import run_cell, summary

    found = run_cell(cell, METHODS, args.out, quiet=args.json)
    passes = [ran.scored for ran in found["passes"]]
    how = f"four ROS 2 nodes and a recorder, graph up in {found['graph_up_s']:.2f} s"
    report = _write(found["out"], cell, passes, source, args)
    return _tell(args, passes, {**summary(found), "report": str(report), "ran_as": how})


def _plain(cell) -> list:
    from kr270_milling.cell.jobs import compensated, simulate

    with progress("original") as report:
        passes = [simulate(cell, progress=report)]
    for method in METHODS:
        with progress(method) as report:
            passes.append(compensated(cell, passes[0], method, report))
    return passes


def _write(directory, cell, passes, source, args):
    """Report and series; returns the path of the report."""
    import datetime

    from kr270_milling.report import write_report
    from kr270_milling.report.series import write_series

    date = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    with progress("report") as _:
        report = write_report(
            directory, cell, passes, title="The milling pass of Klimchik et al. (2012)", source=str(source),
            command=command_line(args), date=date, paper=True,
        )  # fmt: skip
        write_series(directory, cell, passes)
    return report


def _tell(args, passes, found: dict) -> None:
    """Print table or JSON."""
    if args.json:
        print_json({"passes": [p.row() for p in passes], **found})
        return
    rows = [_row(p) for p in passes]
    print_table(
        "Path deviation [um], Table 2", ["pass", "static", "paper", "max", "paper", "low frequency, model [Hz]"], rows
    )
    print(f"ran as: {found['ran_as']}\nreport: {found['report']}")


def _row(p) -> list[str]:
    static, largest = PAPER.get(p.name, ("", ""))
    scores = p.scores
    return [
        p.name, f"{scores.static_deviation * 1e6:.2f}", static, f"{scores.max_deviation * 1e6:.2f}", largest,
        f"{scores.low_frequency:.2f}",
    ]  # fmt: skip
