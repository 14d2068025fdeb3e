"""``kr270_milling demo``: the paper's case, original and compensated, with table and report."""

from __future__ import annotations

from kr270_milling.commands.console import add_common, output_directory, print_json, print_table, progress

PAPER = {"original": ("58.10", "63.20"), "linear": ("0.14", "4.70")}


def add_arguments(parser) -> None:
    parser.add_argument("--out", metavar="DIR", default="out", help="where report and series go (default: out)")
    add_common(parser)


def run(args) -> None:
    from kr270_milling.cell import read_cell
    from kr270_milling.config import find_file
    from kr270_milling.passes import compensated, simulate

    source = find_file("paper.yaml")
    cell = read_cell(source)
    directory = output_directory(args.out)
    with progress("original") as report:
        passes = [simulate(cell, progress=report)]
    for method in ("linear", "spline", "learned"):
        with progress(method) as report:
            passes.append(compensated(cell, passes[0], method, report))
    finish(args, directory, cell, passes, source, "plain loop in one process (rclpy is not installed)")


def finish(args, directory, cell, passes, source, how: str, extra: dict | None = None) -> None:
    """Write report and series, print table or JSON."""
    import datetime

    from kr270_milling.report import write_report
    from kr270_milling.report.series import write_series

    date = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    with progress("report") as _:
        report = write_report(
            directory, cell, passes, title="The milling pass of Klimchik et al. (2012)", source=str(source),
            command="kr270_milling demo", date=date, paper=True,
        )  # fmt: skip
        write_series(directory, cell, passes)
    if args.json:
        rows = [p.row() for p in passes]
        print_json({"passes": rows, "report": str(report), "out": str(directory), "ran_as": how, **(extra or {})})
        return
    rows = [_row(p) for p in passes]
    print_table("Path deviation [um], Table 2", ["pass", "static", "paper", "max", "paper", "low frequency [Hz]"], rows)
    print(f"ran as: {how}\nreport: {report}")


def _row(p) -> list[str]:
    static, largest = PAPER.get(p.name, ("", ""))
    scores = p.scores
    return [
        p.name, f"{scores.static_deviation * 1e6:.2f}", static, f"{scores.max_deviation * 1e6:.2f}", largest,
        f"{scores.low_frequency:.2f}",
    ]  # fmt: skip
