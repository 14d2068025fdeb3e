"""``kr270_milling compensate``: the revised trajectory of a cell, what it is predicted to achieve, and the programs.

Exit code 1 where the decision is ``no``; then no program is written, unless by force.
"""

from __future__ import annotations

import itertools
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from rich.text import Text

from kr270_milling.base.column import CONVERGED, TextTable, as_dict, columns, columns_of, fixed, table_of
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import find_file, write_include
from kr270_milling.base.version import __version__
from kr270_milling.cell.cell_file import read_cells
from kr270_milling.cell.jobs import joint_ranges
from kr270_milling.cell.models import cut_of, cut_text_of, path_of
from kr270_milling.decide.compensation import DecisionOnTools, compensate, in_turn, limit_sentence
from kr270_milling.decide.decision import CAUTION, NO, YES
from kr270_milling.decide.levers import Lever, levers
from kr270_milling.decide.part import FeatureRow, write_part
from kr270_milling.decide.part.assessment import after_passes, um_text
from kr270_milling.decide.programs.files import (
    OLDER,
    program_bytes,
    rsi_address,
    set_aside,
    time_law,
    write_manifest,
    write_programs,
)
from kr270_milling.decide.programs.gcode import check_gcode, write_gcode
from kr270_milling.decide.programs.written import SOFTER, softer_pass
from kr270_milling.decide.verdict import SAMPLES
from kr270_milling.path.trajectory import read_csv
from kr270_milling.physics.compensation.revision import chord_error
from kr270_milling.physics.motion.scores import Scores
from kr270_milling.show.commands.console import (
    Answer,
    command_line,
    joints_text,
    now,
    steps,
    title_of,
)
from kr270_milling.show.commands.simulate import plant_of
from kr270_milling.show.report import report_text, write_report_page
from kr270_milling.show.report.study_page import tools_page
from kr270_milling.studies.identification.measured_part import learn, learned_keys, read_part
from kr270_milling.studies.maps.along import own_turn, turned_cell

NOT_RELEASED, NOT_WRITTEN = "programs marked NOT RELEASED", "no robot program is written (--force writes one)"
SCORED = "decision and tables are those of the KRL program"
ROBUST, ORIGINAL, LEARNED_FILE = "robust", "original", "learned.yaml"
COLORS = {"yes": "green", "caution": "yellow", "no": "red"}  #: color of a level of the decision


def run_compensate(args) -> Answer:

    def run(cell, whole):
        if cell.compensation.turn == "best" and not reached:
            with whole.under(title_of(cell))("turn of the tool"):
                cell = turned_cell(cell)
        plant = plant_of(args, cell)
        return compensate(
            cell,
            args.method or (ROBUST if parts else None),
            plant=plant,
            motions=args.krl or (),
            robots=args.verdict,
            seed=args.seed,
            former=parts[-1][1] if parts else None,
            feeds=reached[1].feeds if reached else None,
            progress=whole.under(title_of(cell)),
        )

    if args.rsi:
        rsi_address(args.rsi)  # refused before the passes are run
    source, cells = find_file(args.cell), read_cells(find_file(args.cell), args.set)
    if args.gcode:
        check_gcode(cells)
    parts, learned = _measured_parts(args, cells), None
    reached: tuple[list[Lever], Lever] | None = None
    if parts and args.reach:
        raise InputError("--reach", "changes the times of the path; include what was learned in the cell first")
    with staged(args.out) as (draft, final), steps() as whole:
        if parts:
            with whole("measured parts") as report:
                learned = learn(cells[0], parts, report)
            cells = (learned.cell,)
        if args.reach:
            reached = _reach(cells, args, whole)
            cells = (reached[1].cell,)
        jobs = in_turn(
            cells,
            lambda cell: run(cell, whole),
            lambda result: result.revised if result.checked.may_be_run else None,
        )
        jobs = [(result.cell, result) for _, result in jobs]
        several = len(jobs) > 1
        decision = DecisionOnTools.of(jobs) if several else jobs[0][1].decision
        if args.json and decision.level == CAUTION:
            print(f"warning: {decision.text}", file=sys.stderr)
        whole.say("files")
        values = _write(draft, final, jobs, decision, args, source, whole, reached)
        if learned:
            notes = [f"learned by kr270_milling {__version__} from measured parts", *learned.lines()]
            file = write_include(draft / LEARNED_FILE, learned_keys(learned.cell), notes)
            values |= as_dict(learned) | {"learned_file": str(final(file))}
        if older := set_aside(args.out):
            print(f"programs of an earlier run moved to {Path(args.out, OLDER)}: {', '.join(older)}", file=sys.stderr)
    shown = _shown_tools(jobs, decision, values, args) if several else _shown(*jobs[0], decision, values, args, reached)
    if learned:
        keep = f"to keep it, include {values['learned_file']} in the cell (includes)"
        shown = (*itertools.islice(shown := iter(shown), 1), *learned.lines(), keep, *shown)
    return Answer(values, shown, code=decision.exit_code)


def _measured_parts(args, cells) -> list:
    """Read places and reference of each measured part, with a text on its source; raises InputError."""
    files, ran = args.measured or [], args.reference or []
    if len(ran) > len(files):
        raise InputError("--reference", f"is given {len(ran)} times, but --measured {len(files)} times")
    if files and len(cells) > 1:
        raise InputError("--measured", "needs a cell with one tool, or path.tool")
    parts = []
    for file, run in itertools.zip_longest(files, ran):
        target = path_of(cells[0]).target
        reference = read_csv(find_file(run))[0] if run and run != ORIGINAL else target
        if not np.array_equal(reference.time_ns, target.time_ns):
            raise InputError(
                run, "has its knots at other times than the path of the cell: it belongs to another program"
            )
        places = read_part(find_file(file))
        along = f"along {Path(run).name}" if run and run != ORIGINAL else "as programmed"
        parts.append((places, reference, f"{Path(file).name}, {len(places.error)} places, {along}, {now()[:10]}"))
    return parts


def _reach(cells, args, whole) -> tuple[list, Lever]:
    """Return the rows of the levers that were tried, and the row to run."""
    if len(cells) > 1:
        raise InputError("--reach", "takes a program with one tool, or one of its tools: --set path.tool=T1")
    motion = (args.krl or [cells[0].krl.motion])[0]
    turned = None if args.gcode else turned_cell  # 3-axis G-code has no words for a turn
    with whole("levers") as report:
        return levers(cells[0], args.verdict or SAMPLES, args.seed, motion, report, turned, args.method)


def _levers_table(reached, chosen: Lever) -> TextTable:
    """The levers side by side, for terminal and report."""
    state = "is the cheapest that is enough" if chosen.enough else "keeps most robots within; none is enough"
    note = f"'{chosen.name}' {state}, and is run: {', '.join(chosen.keys)}"
    rows = [as_dict(lever) for lever in reached]
    columns = [(head, key, 0 if key in ("within_tolerance", "robots") else 2) for head, key, _ in columns_of(Lever)]
    return table_of("Levers: simulated robots within the tolerance", columns, rows, note)


def _values(cell, result) -> dict:
    """Return the values for ``--json`` without the files."""
    original, revised = result.original, result.revised
    values = {"method": revised.name, "cut": cell.cutting.detail, "points": len(revised.reference)}
    values |= as_dict(revised.scores)
    values["commanded_joints_deg"] = joint_ranges(cell, revised.reference)
    values["planned_max_deviation_um"] = 1e6 * result.planned.scores.max_deviation
    values["time_law"] = time_law(path_of(cell))
    if turn := own_turn(cell):
        values["tool_turn_deg"] = np.degrees(turn)
    if result.feeds:
        values["feeds"] = result.feeds
    if passes := after_passes(cell, revised):
        values["finish"] = passes
    values["original"] = as_dict(original.scores)
    values["passes"] = [scored.row() for scored in (original, revised)]
    values |= _correction(cell, revised, result.by)
    values["features"] = {part.name: part.table() for part in result.parts}
    values["check"] = as_dict(result.checked)
    values["verdict"] = result.decision.verdict and as_dict(result.decision.verdict)
    return values | as_dict(result.decision)


def _correction(cell, revised, by) -> dict:
    """Return the size of the correction and the parts that a limit removed."""
    size = np.linalg.norm(revised.reference.position - path_of(cell).target.position, axis=1)
    limited = [as_dict(part) | {"sentence": limit_sentence(part, by)} for part in by.limited]
    values = {"largest_correction_um": 1e6 * float(size.max()), "limited": limited}
    if by.errors[1:]:
        values["remaining_errors_um"] = [1e6 * error for error in by.errors]
    values["identified"] = by.identified
    values["note"] = by.note or None
    if not by.chosen.smooth:
        values["chord_error_um"] = 1e6 * chord_error(path_of(cell).target)
    return values


def _write(draft, final, jobs, decision, args, source, whole, reached) -> dict:
    """Write all files of all tools and return the values for ``--json``; jobs: cell and compensation of each tool."""
    date, released = now(), decision.level != NO
    tools, texts, pages = [], [], []
    for cell, result in jobs:
        values = _values(cell, result)
        with ThreadPoolExecutor(1) as pool:
            softer = pool.submit(softer_pass, cell, result.revised.reference)
            placed, text = _write_programs(draft, final, cell, result, decision.level, args, date)
            tools.append(values | placed)
            texts.append(text)
            with whole.under(title_of(cell))("lower acceleration"):
                page = _report_of_tool(cell, result, args, source, date, softer.result(), reached, values)
        pages.append(page)
        if result.parts and "stl" in args.write:
            stl = draft / f"part_{result.revised.name}{cell.stage.suffix if cell.stage else ''}.stl"
            write_part(stl, cut_of(cell), result.revised.result, path_of(cell).clock, path_of(cell).target)
            tools[-1]["part"] = str(final(stl))
    gcode: dict = {}
    if args.gcode and (released or args.force):
        gcode, text = _write_gcode(draft, final, jobs, decision, released, date)
        texts.append(text)
    manifest = str(final(write_manifest(draft, texts, decision.lines(), released)))
    page = pages[0]
    if len(jobs) > 1:
        title = f"{jobs[0][0].path.file_name}: {len(jobs)} tools, before and after compensation"
        page = tools_page(title, decision, [cell.stage.tool for cell, _ in jobs], pages)
    report = {"report": str(final(write_report_page(draft, page)))}
    if len(jobs) > 1:
        rows = [
            {"tool": cell.stage.tool, "level": tool.pop("decision"), **tool}
            for (cell, _), tool in zip(jobs, tools, strict=True)
        ]
        return {**as_dict(decision), "out": args.out, "manifest": manifest, **report, **gcode, "tools": rows}
    tools[0]["programs"]["manifest"] = [manifest]
    shown = {"levers": [as_dict(lever) for lever in reached[0]]} if reached else {}
    return tools[0] | report | gcode | shown


def _write_gcode(draft, final, jobs, decision, released, date: str) -> tuple[dict, str]:
    """Write the G-code of all tools; return its path with the figures read back, and the text for the manifest."""
    path, tools = write_gcode(
        draft,
        [(cell, result.revised.reference) for cell, result in jobs],
        date=date,
        decision=decision.lines(),
        method="-".join(dict.fromkeys(result.revised.name for _, result in jobs)),
        released=released,
    )
    lines = [f"{path.name}: for KUKA.CNC, another robot or a machine tool.", *(tool.text for tool in tools), SCORED]
    values = {"file": str(final(path)), "tools": list(map(as_dict, tools))}
    return {"gcode": values}, "\n" + "\n  ".join(lines) + "\n"


def _gcode_lines(values: dict):
    if "gcode" in values:
        yield f"gcode: {values['gcode']['file']}"
        yield from (tool["sentence"] for tool in values["gcode"]["tools"])
        yield SCORED


def _write_programs(draft, final, cell, result, level: str, args, date: str) -> tuple[dict, str]:
    """Write programs and tables of one tool; return their final paths by kind, and the text for the manifest."""
    released = level != NO
    files, text = write_programs(
        draft,
        cell,
        result.original.reference,
        result.revised.reference,
        method=result.revised.name,
        date=date,
        motions=result.motions if released or args.force else None,
        source=cell.path.sha256,
        decision=level,
        findings=[*result.checked.findings_lines(), result.checked.counts],
        released=released,
        rsi=args.rsi and rsi_address(args.rsi),
        tables=[*args.write, *["rsi"] * bool(args.rsi)],
    )
    placed = {"out": args.out, "trajectory": str(final(files.pop("trajectory")[0]))}
    placed["programs"] = {kind: [str(final(path)) for path in paths] for kind, paths in files.items()}
    placed["program_bytes"] = {kind: program_bytes(files[kind]) for kind in ("krl_spline", "krl_lin") if kind in files}
    return placed, text


def _report_of_tool(cell, result, args, source, date: str, softer, reached, values: dict) -> str:
    """Return the report of one tool as text."""
    revised = result.revised
    title = f"{cell.path.file_name or source.name}: before and after compensation ({revised.name})"
    return report_text(
        cell,
        (result.original, revised),
        title=f"{title}, {cell.stage}" if cell.stage else title,
        source=str(source),
        command=command_line(args),
        date=date,
        parts=result.parts,
        decision=result.decision,
        checked=result.checked,
        tables=[
            *([_levers_table(*reached)] if reached else []),
            *([_passes_table(values["finish"])] if "finish" in values else []),
            _joints_table(cell, revised),
            _time_law_table(cell, result, softer),
        ],
    )


def _joints_table(cell, revised):
    """Return the table of commanded joints for the report."""
    columns = [
        *joint_ranges(cell, revised.reference).values(),
        *np.degrees([cell.arm.joint_lower, cell.arm.joint_upper]),
    ]
    rows = [(f"A{k}", *(fixed(value) for value in row)) for k, row in enumerate(np.transpose(columns), 1)]
    head = ("axis", "start", "end", "least", "largest", "lower limit", "upper limit")
    return TextTable("Commanded joints [deg]", head, tuple(rows), f"of the pass '{revised.name}', signs as KUKA's")


def _time_law_table(cell, result, softer):
    """Largest deviation of the plan, of the written program, and of its points with a lower acceleration."""
    rows = [("plan", result.planned.scores), ("written program", result.revised.scores)]
    rows += [(f"written program, {SOFTER:g} times the acceleration", softer.scores)] if softer else []
    texts = tuple((name, f"{1e6 * scores.max_deviation:.2f}") for name, scores in rows)
    return TextTable("Plan and program: largest deviation [um]", ("pass", "max"), texts, time_law(path_of(cell)))


def _shown_tools(jobs, decision, values: dict, args):
    """Yield the output for the terminal: the decision, then each tool."""
    yield Text(decision.text, f"bold {COLORS[decision.level]}")
    for (cell, result), tool_values in zip(jobs, values["tools"], strict=True):
        yield f"\n{cell.stage}: {cell.tool.diameter * 1e3:g} mm, {cell.tool.teeth} teeth"
        yield f"{result.decision.level}: {result.decision.sentence}"
        yield from result.decision.lines()[1:]
        yield from _details(cell, result, tool_values)
        yield from _files(tool_values)
        yield from (f"{kind}: {tool_values[kind]}" for kind in ("part",) if kind in tool_values)
    yield ""
    if decision.level == NO:
        yield NOT_RELEASED if args.force else NOT_WRITTEN
    yield from _gcode_lines(values)
    yield from (f"{kind}: {values[kind]}" for kind in ("manifest", "report") if kind in values)


def _shown(cell, result, decision, values: dict, args, reached):
    """Yield the output for the terminal, the decision first."""
    yield Text(decision.text, f"bold {COLORS[decision.level]}")
    yield from decision.lines()[1:]
    if reached:
        table = _levers_table(*reached)
        yield from (table, f"levers: {table.note}")
    elif decision.level != YES and decision.verdict and not path_of(cell).straight:
        yield "levers: compensate --reach tries softer ramps, other feeds, a finishing pass and a turn of the tool"
    yield from _details(cell, result, values)
    if decision.level == NO:
        yield NOT_RELEASED if args.force else NOT_WRITTEN
    yield from _files(values)
    yield from _gcode_lines(values)
    yield from (f"{kind}: {values[kind]}" for kind in ("report", "part") if kind in values)


def _files(values: dict):
    for kind, paths in values["programs"].items():
        more = f" and {len(paths) - 2} more files" if len(paths) > 2 else ""
        size = values["program_bytes"].get(kind)
        yield f"{kind}: {', '.join(paths[:2])}{more}{f'; the corrected program has {size:,} bytes' if size else ''}"


def _details(cell, result, values: dict):
    """Yield tables and lines of one tool after its decision."""
    if result.parts:
        yield _features(values["features"], values["method"])
    else:
        columns = (("pass", "name", 2), *columns_of(Scores, unit="um"))
        yield table_of("Predicted path deviation [um]", columns, values["passes"])
    if "tool_turn_deg" in values:
        yield f"the tool is turned by {values['tool_turn_deg']:.4g} deg about its axis, in all points"
    if "feeds" in values:
        yield _feeds_text(values["feeds"])
    if "finish" in values:
        yield _passes_table(values["finish"])
    yield (
        f"largest deviation of the written program {um_text(1e-6 * values['max_deviation_um'])}, of the plan "
        f"{um_text(1e-6 * values['planned_max_deviation_um'])}; {values['time_law']}"
    )
    if values["note"]:
        yield values["note"]
    if identified := values["identified"]:
        modes = ", ".join(
            f"{mode['frequency_hz']:.2f} Hz ({100 * mode['damping_ratio']:.1f} %)" for mode in identified["modes"]
        )
        gain, compliance = identified["gain"], identified["compliance_factor"]
        yield f"arm as the passes show it: modes {modes}; gain {gain:.3f}, compliance {compliance:.3f} x the model's"
    yield cut_text_of(cell)
    yield joints_text(values["commanded_joints_deg"])
    yield f"largest correction {values['largest_correction_um']:.1f} um"
    if "chord_error_um" in values:
        yield f"LIN chords deviate from the programmed path by up to {values['chord_error_um']:.2f} um"
    yield from (*result.checked.findings_lines(), result.checked.counts)
    if verdict := values["verdict"]:
        rows = [[name, *(fixed(v, 1, 1e6 * CONVERGED) for v in band)] for name, band in verdict["methods_um"].items()]
        title = f"{verdict['samples']} simulated robots, seed {verdict['seed']}: {verdict['quantity']} [um]"
        yield TextTable(title, ["", "5 %", "50 %", "95 %"], rows)
        yield f"verdict: compensation {verdict['verdict']}: {verdict['reason']}"
    yield f"{values['points']} reference points: {values['trajectory']}"


def _feeds_text(feeds: dict) -> str:
    """The feeds of the stretches as one line."""
    least, most = feeds["feed_percent"]
    before, after = feeds["duration_s"]
    text = (
        f"feeds: {feeds['slower']} of {feeds['stretches']} stretches slower, {least:.0f} to {most:.0f} % of the "
        f"programmed feed; cycle time {before:.4g} s before, {after:.4g} s after"
    )
    if lines := feeds["lines_without_response"]:
        shown = ", ".join(map(str, lines[:5])) + (f" and {len(lines) - 5} more" if len(lines) > 5 else "")
        text += f"; the error in line {shown} does not respond to the feed, which stays as programmed there"
    return text


def _passes_table(rows: list[dict]) -> TextTable:
    """The part after each pass along the same path."""
    heads = [("pass", "pass", 0), ("wall [um]", "wall_um", 2), ("floor [um]", "floor_um", 2)]
    heads += [("force [N]", "max_force_n", 1), ("ends at [s]", "end_s", 1)]
    return table_of("After each pass along the path: errors that remain, largest force of the pass", heads, rows)


def _features(features: dict, method: str) -> TextTable:
    """Before and after, side by side."""
    before, after = ({row["feature"]: row for row in features[name]} for name in ("original", method))
    headings = {"max_normal_um": "max", "mean_normal_um": "mean"}
    if all(np.isnan(row["max_surface_error_um"]) for row in before.values()):
        headings |= {"max_wall_error_um": "wall", "max_floor_error_um": "floor"}
    else:
        headings["max_surface_error_um"] = "surface"
    texts = {column.key: column.text for column in columns(FeatureRow)}
    rows = []
    for name, row in before.items():
        cells = [(texts[key](row[key]), texts[key](after.get(name, {}).get(key, float("nan")))) for key in headings]
        rows.append([name, *(text for pair in cells for text in pair)])
    heads = ["feature", *(word for heading in headings.values() for word in (heading, "after"))]
    title = f"Before and after ({method}) [um]: deviation to the side while cutting, errors that remain"
    return TextTable(title, heads, rows)
