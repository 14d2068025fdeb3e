"""``kr270_milling demo``: the paper's case, original and compensated, with tables and report.

Twice: with eq. (1) as the paper prints it, beside the paper's own results, and with the inertia of the moving arm,
which the paper leaves out and every real arm has.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence

from kr270_milling.base.column import TextTable
from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import compensated, compensator, simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.show.commands.console import Answer, command_line, now, say_replaced
from kr270_milling.show.commands.progress import steps
from kr270_milling.show.commands.run import missing_text, run_passes, summary
from kr270_milling.show.commands.simulate import plant_of
from kr270_milling.show.report import write_report
from kr270_milling.show.report.series import write_series
from kr270_milling.show.report.tables import TABLE_2

METHODS = ("linear", "spline", "mirror", "learned")
INERTIA_METHODS = (*METHODS, "inverse")
WITH_INERTIA = "Path deviation [um], with the inertia of the moving arm"
WITH = ", with inertia"
NEEDS = "learned and inverse need a tracker or the model: the encoders of the joints do not see the deflection"


def run_demo(args) -> Answer:

    source = find_file("paper.yaml")
    cell = read_cell(source)
    moving = read_cell(source, ["dynamics.reference_inertia=true"])
    other = args.plant is not None or args.noise_um is not None
    if args.plain or other or importlib.util.find_spec("rclpy") is None:
        say_replaced(args.out)
        loop = "plain loop in one process" + ("" if args.plain or other else ", since rclpy is not installed")
        with staged(args.out) as (draft, final), steps() as whole:
            passes = _plain(whole, cell, METHODS, plant_of(args, cell))
            second = _plain(whole, moving, INERTIA_METHODS, plant_of(args, moving), WITH)
            whole.say("report")
            report = final(_write(draft, cell, passes, second, source, args))
        return _answer(passes, second, {"report": str(report), "out": args.out, "ran_as": loop})
    with steps() as whole:
        result = run_passes(cell, METHODS, args.out, say=whole.say)
        passes = [row.scored for row in result["passes"]]
        second = _plain(whole, moving, INERTIA_METHODS, None, WITH)
        whole.say("report")
        report = _write(result["out"], cell, passes, second, source, args)
    loop = f"four ROS 2 nodes and a recorder, graph up in {result['graph_up_s']:.2f} s"
    return _answer(passes, second, {**summary(result), "report": str(report), "ran_as": loop}, missing_text(result))


def _plain(whole, cell, methods, plant, suffix: str = "") -> list:

    with whole(f"original{suffix}") as report:
        passes = [simulate(cell, progress=report, plant=plant)]
    for method in methods:
        by = compensator(cell, path_of(cell).target, method)
        with whole(f"{method}{suffix}", by.most_passes) as report:
            passes.append(compensated(cell, passes[0], method, report, by, plant))
    return passes


def _write(directory, cell, passes, second, source, args):
    """Report and series; returns the path of the report."""
    rows = tuple((name, static, largest) for name, static, _, largest, *_ in map(_row, second))
    table = TextTable(WITH_INERTIA, ("pass", "static", "max"), rows, NEEDS)
    report = write_report(
        directory,
        cell,
        passes,
        title="The milling pass of Klimchik et al. (2014)",
        source=str(source),
        command=command_line(args),
        date=now(),
        paper=True,
        tables=(table,),
    )
    write_series(directory, arm_of(cell), path_of(cell).target, passes)
    return report


def _answer(passes, second, result: dict, missing: Sequence[str] = ()) -> Answer:
    both = {"passes": [p.row() for p in passes], "passes_reference_inertia": [p.row() for p in second]}
    columns = ["pass", "static", "paper", "max", "paper", "low frequency, model [Hz]"]
    rows = [[name, static, largest, low] for name, static, _, largest, _, low in map(_row, second)]
    return Answer(
        {**result, **both},
        [
            TextTable("Path deviation [um], eq. (1) as printed, Table 2", columns, [_row(p) for p in passes]),
            TextTable(WITH_INERTIA, ["pass", "static", "max", "low frequency, model [Hz]"], rows),
            NEEDS,
            f"ran as: {result['ran_as']}",
            f"report: {result['report']}",
            *missing,
        ],
        code=int(bool(missing)),
    )


def _row(p) -> list[str]:

    ours, paper = p.scores, TABLE_2.get(p.name)
    deviations = [
        f"{1e6 * getattr(scores, name):.2f}" if scores else ""
        for name in ("static_deviation", "max_deviation")
        for scores in (ours, paper)
    ]
    return [p.name, *deviations, f"{ours.low_frequency:.2f}"]
