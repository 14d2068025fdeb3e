"""``kr270_milling compensate``: the revised trajectory of a cell, what it is predicted to achieve, and the programs.

Exit code 1 where the decision is ``no``; then no program is written, unless by force.
"""

from __future__ import annotations

import sys
from pathlib import Path

from kr270_milling.base.arguments import bounded
from kr270_milling.base.column import CONVERGED, TextTable, as_dict, columns, columns_of, fixed, table_of
from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import find_file
from kr270_milling.physics.compensation.methods import BEST, METHODS
from kr270_milling.show.commands.command import CELL, MOTIONS, PLANT, command, option
from kr270_milling.show.commands.console import (
    Answer,
    Colored,
    cells_of,
    command_line,
    joints_text,
    now,
    plant_of,
)
from kr270_milling.show.commands.progress import steps, title_of

ROBOTS = 32  #: of a verdict
NOT_RELEASED, NOT_WRITTEN = "programs marked NOT RELEASED", "no robot program is written (--force writes one)"
SCORED = "the figures are those of the KRL program; how a controller blends G1 blocks is not simulated"
COLORS = {"yes": "green", "caution": "yellow", "no": "red"}  #: by level of the decision

COMMANDS = {
    "compensate": command(
        "compensate.run_compensate", "compensate config/test_piece.yaml --out out",
        *CELL,
        *PLANT,
        option(
            "--method",
            "default: the cell's compensation.method; best: compare the methods and run the best",
            choices=(BEST, *METHODS),
        ),
        option("--out DIR", "where everything goes", default="out"),
        option(
            "--krl",
            "motions of the robot programs; may be given twice (default: LIN for the method linear, which corrects "
            "in straight lines, else the cell's program.motion)",
            choices=MOTIONS,
            action="append",
        ),
        option(
            "--verdict N",
            "number of simulated robots, drawn from the cell's uncertainty, that judge the compensation; 0: no verdict",
            bounded(0, 999_999, int),
            ROBOTS,
        ),
        option(
            "--force",
            "also write the programs after the decision no, marked NOT RELEASED in name and header",
            bool,
        ),
        option(
            "--rsi ADDRESS[:PORT]",
            "also write the RSI context of a KR C4 and the program around it, for 'kr270_milling rsi' on that host",
        ),
        option("--gcode", "also write the G-code of the cell with corrected coordinates, as G1 blocks", bool),
        option("--seed N", "of the verdict's robots", bounded(1, 999_999, int), 1),
    ),
}  # fmt: skip


def run_compensate(args) -> Answer:
    from kr270_milling.decide.compensation import compensate
    from kr270_milling.decide.decision import CAUTION
    from kr270_milling.decide.programs.files import OLDER, set_aside
    from kr270_milling.decide.programs.gcode import check_gcode
    from kr270_milling.decide.programs.rsi_context import rsi_address
    from kr270_milling.decide.tools import DecisionOnTools, in_turn

    def run(cell, whole):
        plant = plant_of(args, cell)
        return compensate(
            cell, args.method, plant=plant, motions=args.krl or (), robots=args.verdict, seed=args.seed,
            progress=whole.under(title_of(cell)),
        )  # fmt: skip

    if args.rsi:
        rsi_address(args.rsi)  # refused before the passes are run
    source, cells = find_file(args.cell), cells_of(args)
    if args.gcode:
        check_gcode(cells)
    with staged(args.out) as (draft, final), steps() as whole:
        jobs = in_turn(
            cells, lambda cell: run(cell, whole), lambda done: done.revised if done.checked.may_be_run else None
        )
        several = len(jobs) > 1
        decision = DecisionOnTools.of(jobs) if several else jobs[0][1].decision
        if args.json and decision.level == CAUTION:
            print(f"warning: {decision.text}", file=sys.stderr)
        whole.say("files")
        values = _write(draft, final, jobs, decision, args, source, whole)
        if older := set_aside(args.out):
            print(f"programs of an earlier run moved to {Path(args.out, OLDER)}: {', '.join(older)}", file=sys.stderr)
    shown = _shown_tools(jobs, decision, values, args) if several else _shown(*jobs[0], decision, values, args)
    return Answer(values, shown, code=decision.exit_code)


def _values(cell, done) -> dict:
    """What ``--json`` prints, but for the files."""
    from kr270_milling.cell.jobs import joint_ranges
    from kr270_milling.cell.models import path_of
    from kr270_milling.decide.programs.files import time_law

    original, revised = done.original, done.revised
    values = {"method": revised.name, "cut": cell.cutting.detail, "points": len(revised.reference)}
    values |= {k: v for k, v in revised.row().items() if k != "name"}
    values["commanded_joints_deg"] = joint_ranges(cell, revised.reference)
    values["planned_max_deviation_um"] = 1e6 * done.planned.max_deviation
    values["time_law"] = time_law(path_of(cell))
    values["original"] = {k: v for k, v in original.row().items() if k != "name"}
    values["passes"] = [ran.row() for ran in (original, revised)]
    values |= _correction(cell, revised, done.by)
    values["features"] = {part.name: part.table() for part in done.parts}
    values["check"] = as_dict(done.checked)
    values["verdict"] = done.decision.verdict and done.decision.verdict.as_dict()
    return values | done.decision.as_dict()


def _correction(cell, revised, by) -> dict:
    """How large the correction is, and the parts that a limit removed."""
    import numpy as np

    from kr270_milling.cell.models import path_of
    from kr270_milling.decide.compensation import limit_sentence
    from kr270_milling.physics.compensation.revision import chord_error

    size = np.linalg.norm(revised.reference.position - path_of(cell).target.position, axis=1)
    limited = [
        {"kind": part.kind, "first": part.first, "last": part.last, "worst": part.worst, "time_s": part.time,
         "wanted_um": 1e6 * part.wanted, "missing_um": 1e6 * part.missing, "sentence": limit_sentence(part, by)}
        for part in by.limited
    ]  # fmt: skip
    values = {"largest_correction_um": 1e6 * float(size.max()), "limited": limited}
    if by.errors[1:]:
        values["remaining_errors_um"] = [1e6 * error for error in by.errors]
    values["identified"] = by.identified and by.identified.as_dict()
    values["note"] = by.note or None
    if not by.chosen.smooth:
        values["chord_error_um"] = 1e6 * chord_error(path_of(cell).target)
    return values


def _write(draft, final, jobs, decision, args, source, whole) -> dict:
    """All files of all tools, and what ``--json`` prints; jobs: of each tool its cell and its compensation."""
    from kr270_milling.decide.decision import NO
    from kr270_milling.decide.programs.files import write_manifest

    date, released = now(), decision.level != NO
    tools, texts, pages = [], [], []
    for cell, done in jobs:
        lines = decision.lines(cell.stage.tool) if len(jobs) > 1 else decision.lines()
        values = _values(cell, done)
        placed, text = _write_programs(draft, final, cell, done, lines, released, args, date)
        tools.append(values | placed)
        texts.append(text)
        pages.append(_report_of_tool(cell, done, args, source, date, whole))
        if done.parts:
            tools[-1] |= {"part": str(final(_write_part(draft, cell, done.revised)))}
    gcode: dict = {}
    if args.gcode and (released or args.force):
        gcode, text = _write_gcode(draft, final, jobs, decision, released, date)
        texts.append(text)
    manifest = str(final(write_manifest(draft, texts, decision.lines(), released)))
    report = {"report": str(final(_write_report(draft, jobs, decision, pages)))}
    if len(jobs) > 1:
        rows = [
            {"tool": cell.stage.tool, "level": one.pop("decision"), **one}
            for (cell, _), one in zip(jobs, tools, strict=True)
        ]
        return {**as_dict(decision), "out": args.out, "manifest": manifest, **report, **gcode, "tools": rows}
    tools[0]["programs"]["manifest"] = [manifest]
    return tools[0] | report | gcode


def _write_gcode(draft, final, jobs, decision, released, date: str) -> tuple[dict, str]:
    """The G-code of all tools: its final path with what was read back, and the text for the manifest."""
    from kr270_milling.decide.programs.gcode import write_gcode

    path, tools = write_gcode(
        draft, [(cell, done.revised.reference) for cell, done in jobs], date=date, decision=decision.lines(),
        method="-".join(dict.fromkeys(done.revised.name for _, done in jobs)), released=released,
    )  # fmt: skip
    lines = [f"{path.name}: for KUKA.CNC, another robot or a machine tool.", *(one.text for one in tools), SCORED]
    values = {"file": str(final(path)), "tools": list(map(as_dict, tools))}
    return {"gcode": values}, "\n" + "\n  ".join(lines) + "\n"


def _gcode_lines(values: dict):
    if "gcode" in values:
        yield f"gcode: {values['gcode']['file']}"
        yield from (one["sentence"] for one in values["gcode"]["tools"])
        yield SCORED


def _write_programs(draft, final, cell, done, lines, released, args, date: str) -> tuple[dict, str]:
    """Programs and tables of one tool: their final paths by kind, and the text for the manifest."""
    from kr270_milling.decide.programs.files import write_tool_programs
    from kr270_milling.decide.programs.rsi_context import rsi_address

    files, text = write_tool_programs(
        draft, cell, done.original.reference, done.revised.reference, method=done.revised.name, date=date,
        motions=done.motions if released or args.force else None, source=cell.path.sha256,
        decision=lines, findings=[*done.checked.findings_lines(), done.checked.counts],
        released=released, rsi=args.rsi and rsi_address(args.rsi),
    )  # fmt: skip
    placed = {"out": args.out, "trajectory": str(final(files.pop("trajectory")[0]))}
    placed["programs"] = {kind: [str(final(path)) for path in paths] for kind, paths in files.items()}
    return placed, text


def _report_of_tool(cell, done, args, source, date: str, whole) -> str:
    """The report of one tool as text."""
    from kr270_milling.show.report import report_text

    revised = done.revised
    title = f"{cell.path.file_name or source.name}: before and after compensation ({revised.name})"
    return report_text(
        cell, (done.original, revised), title=f"{title}, {cell.stage}" if cell.stage else title, source=str(source),
        command=command_line(args), date=date, parts=done.parts, decision=done.decision, checked=done.checked,
        tables=[_joints_table(cell, revised), _time_law_table(cell, done, whole)],
    )  # fmt: skip


def _write_part(draft, cell, revised):
    """Write the predicted part as STL and return its path."""
    from kr270_milling.cell.models import cut_of, path_of
    from kr270_milling.decide.part import write_part

    stl = draft / f"part_{revised.name}{cell.stage.suffix if cell.stage else ''}.stl"
    write_part(stl, cut_of(cell), revised.result, path_of(cell).clock)
    return stl


def _write_report(draft, jobs, decision, pages):
    """One page: that of the only tool, or one with the page of each tool behind a tab."""
    from kr270_milling.show.report import write_report_page
    from kr270_milling.show.report.tools_page import tools_page

    if len(jobs) == 1:
        return write_report_page(draft, pages[0])
    names = [cell.stage.tool for cell, _ in jobs]
    title = f"{jobs[0][0].path.file_name}: {len(jobs)} tools, before and after compensation"
    return write_report_page(draft, tools_page(title, decision, names, pages))


def _joints_table(cell, revised):
    """The posture that is commanded, for the report."""
    import numpy as np

    from kr270_milling.cell.jobs import joint_ranges

    columns = [
        *joint_ranges(cell, revised.reference).values(),
        *np.degrees([cell.arm.joint_lower, cell.arm.joint_upper]),
    ]
    rows = [(f"A{k}", *(fixed(value) for value in row)) for k, row in enumerate(np.transpose(columns), 1)]
    head = ("axis", "start", "end", "least", "largest", "lower limit", "upper limit")
    return TextTable("Commanded joints [deg]", head, tuple(rows), f"of the pass '{revised.name}', signs as KUKA's")


def _time_law_table(cell, done, whole):
    """Largest deviation of the plan, of the written program, and of its points with a lower acceleration."""
    from kr270_milling.cell.models import path_of
    from kr270_milling.decide.programs.files import time_law
    from kr270_milling.decide.programs.written import SOFTER, softer_pass

    with whole.under(title_of(cell))("lower acceleration") as report:
        softer = softer_pass(cell, done.revised.reference, progress=report)
    rows = [("plan", done.planned), ("written program", done.revised.scores)]
    rows += [(f"written program, {SOFTER:g} times the acceleration", softer.scores)] if softer else []
    texts = tuple((name, f"{1e6 * scores.max_deviation:.2f}") for name, scores in rows)
    return TextTable("Plan and program: largest deviation [um]", ("pass", "max"), texts, time_law(path_of(cell)))


def _shown_tools(jobs, decision, values: dict, args):
    """The output for the terminal: the decision, then what each tool has on its own."""
    from kr270_milling.decide.decision import NO

    yield Colored(decision.text, COLORS[decision.level])
    for (cell, done), one in zip(jobs, values["tools"], strict=True):
        yield f"\n{cell.stage}: {cell.tool.diameter * 1e3:g} mm, {cell.tool.teeth} teeth"
        yield f"{done.decision.level}: {done.decision.sentence}"
        yield from done.decision.lines()[1:]
        yield from _details(cell, done, one)
        yield from _files(one)
        yield from (f"{kind}: {one[kind]}" for kind in ("part",) if kind in one)
    yield ""
    if decision.level == NO:
        yield NOT_RELEASED if args.force else NOT_WRITTEN
    yield from _gcode_lines(values)
    yield from (f"{kind}: {values[kind]}" for kind in ("manifest", "report") if kind in values)


def _shown(cell, done, decision, values: dict, args):
    """The output for the terminal, the decision first."""
    from kr270_milling.decide.decision import NO

    yield Colored(decision.text, COLORS[decision.level])
    yield from decision.lines()[1:]
    yield from _details(cell, done, values)
    if decision.level == NO:
        yield NOT_RELEASED if args.force else NOT_WRITTEN
    yield from _files(values)
    yield from _gcode_lines(values)
    yield from (f"{kind}: {values[kind]}" for kind in ("report", "part") if kind in values)


def _files(values: dict):
    for kind, paths in values["programs"].items():
        yield f"{kind}: {', '.join(paths[:2])}{f' and {len(paths) - 2} more files' if len(paths) > 2 else ''}"


def _details(cell, done, values: dict):
    """Tables and lines of one tool after its decision."""
    from kr270_milling.cell.models import cut_text_of
    from kr270_milling.decide.tolerance import um_text

    if done.parts:
        yield _features(values["features"], values["method"])
    else:
        from kr270_milling.physics.motion.scores import Scores

        columns = (("pass", "name", 2), *columns_of(Scores, unit="um"))
        yield table_of("Predicted path deviation [um]", columns, values["passes"])
    yield (
        f"largest deviation of the written program {um_text(1e-6 * values['max_deviation_um'])}, of the plan "
        f"{um_text(1e-6 * values['planned_max_deviation_um'])}; {values['time_law']}"
    )
    if values["note"]:
        yield values["note"]
    if values["identified"]:
        yield _identified(values["identified"])
    yield cut_text_of(cell)
    yield joints_text(values["commanded_joints_deg"])
    yield f"largest correction {values['largest_correction_um']:.1f} um"
    if "chord_error_um" in values:
        yield f"LIN chords deviate from the programmed path by up to {values['chord_error_um']:.2f} um"
    yield from (*done.checked.findings_lines(), done.checked.counts)
    if values["verdict"]:
        yield from _verdict(values["verdict"])
    yield f"{values['points']} reference points: {values['trajectory']}"


def _identified(values: dict) -> str:
    """The arm as the passes show it, in one line."""
    modes = ", ".join(f"{m['frequency_hz']:.2f} Hz ({100 * m['damping_ratio']:.1f} %)" for m in values["modes"])
    gain, compliance = values["gain"], values["compliance_factor"]
    return f"arm as the passes show it: modes {modes}; gain {gain:.3f}, compliance {compliance:.3f} x the model's"


def _features(features: dict, method: str) -> TextTable:
    """Before and after, side by side."""
    from kr270_milling.decide.part import FeatureRow

    before, after = ({row["feature"]: row for row in features[name]} for name in ("original", method))
    keys = ("max_normal_um", "mean_normal_um", "max_wall_error_um", "max_floor_error_um")
    texts = {column.key: column.text for column in columns(FeatureRow)}
    rows = []
    for name, row in before.items():
        cells = [(texts[key](row[key]), texts[key](after.get(name, {}).get(key, float("nan")))) for key in keys]
        rows.append([name, *(text for pair in cells for text in pair)])
    heads = ["feature", "max", "after", "mean", "after", "wall", "after", "floor", "after"]
    title = f"Before and after ({method}) [um]: deviation to the side while cutting, errors that remain"
    return TextTable(title, heads, rows)


def _verdict(verdict: dict):
    columns = ["", "5 %", "50 %", "95 %"]
    rows = [[name, *(fixed(v, 1, 1e6 * CONVERGED) for v in band)] for name, band in verdict["methods_um"].items()]
    yield TextTable(
        f"{verdict['samples']} simulated robots, seed {verdict['seed']}: {verdict['quantity']} [um]", columns, rows
    )
    yield f"verdict: compensation {verdict['verdict']}: {verdict['reason']}"
