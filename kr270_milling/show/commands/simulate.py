"""``simulate``: one pass of a cell, as programmed or along a reference; ``check``: whether that may be run."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np

from kr270_milling.base.column import as_dict, columns_of, counted, table_of
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell import jobs
from kr270_milling.cell.cell_file import read_cell, read_cells
from kr270_milling.cell.models import arm_of, cut_of, cut_text_of, flat_floors, path_of, thin_chips
from kr270_milling.cell.plant import Plant
from kr270_milling.decide import check as decision
from kr270_milling.decide.check_cut import residue_of
from kr270_milling.decide.compensation import in_turn
from kr270_milling.decide.part import FeatureRow, assess, write_part
from kr270_milling.decide.part.assessment import judge
from kr270_milling.decide.programs.files import kuka_frames
from kr270_milling.path.trajectory import read_csv
from kr270_milling.show.commands.console import Answer, joints_text, steps, title_of
from kr270_milling.show.report.series import write_series


def run_simulate(args) -> Answer:

    cells = read_cells(find_file(args.cell), args.set)
    _refuse_reference(args, cells)
    with (
        staged(args.out) if args.out else contextlib.nullcontext((None, None)) as (draft, final),
        steps() as whole,
    ):
        results = in_turn(cells, lambda cell: _simulated(cell, args, draft, final, whole), lambda result: result[0])
    shown = [line for cell, (_, _, lines) in results for line in _headed(cell, cells, lines)]
    return Answer(_by_tool(cells, [summary for _, (_, summary, _) in results]), shown)


def _simulated(cell, args, draft, final, whole):
    """Return the pass of one tool, its values for ``--json``, and the output for the terminal."""
    reference = None if args.reference is None else _reference(cell, args.reference)
    suffix = cell.stage.suffix if cell.stage else ""
    name = f"original{suffix}" if reference is None else Path(args.reference).stem
    with whole.under(title_of(cell))("milling") as report:
        scored = jobs.simulate(cell, reference, name, report, plant_of(args, cell))
    summary = _summary(cell, scored)
    residue = residue_of(cell, scored.result)
    summary["simulated_pass"] = as_dict(residue)
    part = None if path_of(cell).straight else assess(cell, scored)
    tolerance = judge(cell, scored, part)
    summary["tolerance"] = as_dict(tolerance)
    if part:
        summary |= as_dict(part)
    if draft and final:
        files = write_series(draft, arm_of(cell), path_of(cell).target, [scored])
        if "stl" in args.write and not path_of(cell).straight:
            files.append(draft / f"part{suffix}.stl")
            write_part(files[-1], cut_of(cell), scored.result, path_of(cell).clock, path_of(cell).target)
        summary["files"] = [str(final(path)) for path in files]
    columns = columns_of(FeatureRow, unit="um")
    absent = {"max_surface_error_um"} if flat_floors(cell) else {"max_wall_error_um", "max_floor_error_um"}
    columns = tuple(column for column in columns if column[1] not in absent)
    scores: list = _scores(cell, summary)
    if part:
        scores = [
            table_of(
                "Deviation to the side of the path while cutting, and largest errors of what remains [um]",
                columns,
                (*summary["features"], summary["whole_part"]),
            )
        ]
    speed = (
        f"{summary['steps']} micro-steps in {summary['wall_s']:.3f} s, {summary['real_time_factor']:.1f} x real time"
    )
    shown = [
        *scores,
        f"tolerance: {tolerance.words}",
        residue.text,
        cut_text_of(cell),
        joints_text(summary["commanded_joints_deg"]),
        f"removed area        {summary['removed_area_mm2']:10.3f} mm2",
        speed,
        *summary.get("files", []),
    ]
    return scored, summary, shown


def run_check(args) -> Answer:
    """Exit code 1 if the path must not be run."""
    cells = read_cells(find_file(args.cell), args.set)
    _refuse_reference(args, cells)
    with steps() as whole:
        results = in_turn(
            cells,
            lambda cell: _checked(cell, args, whole),
            lambda result: result[0].ran if result[0].may_be_run else None,
        )
    all_checked = [checked for _, (checked, _, _) in results]
    may_be_run = all(checked.may_be_run for checked in all_checked)
    result = {"cell": args.cell, "reference": args.reference}
    if len(cells) == 1:
        return Answer(result | results[0][1][1], results[0][1][2], code=int(not may_be_run))
    counts = {
        f"{severity}s": sum(checked.count(severity) for checked in all_checked) for severity in ("stop", "warning")
    }
    result |= {"may_be_run": may_be_run, **counts}
    shown = [line for cell, (_, _, lines) in results for line in _headed(cell, cells, lines)]
    stopped = [cell.path.tool for cell, (checked, _, _) in results if not checked.may_be_run]
    verdict = f"must not be run: stops of {', '.join(stopped)}" if stopped else "may be run, after a test in mode T1"
    several = f"{counted(counts['stops'], 'stop')}, {counted(counts['warnings'], 'warning')}"
    words = f"{len(cells)} tools, {several}: the program {verdict}"
    answer = result | _by_tool(cells, [values for _, (_, values, _) in results])
    return Answer(answer, [*shown, "", words], code=int(not may_be_run))


def _checked(cell, args, whole):
    """Return the check of one tool, its values for ``--json``, and the output for the terminal."""
    reference = None if args.reference is None else read_csv(Path(args.reference))[0]
    progress = whole.under(title_of(cell))
    checked = decision.check(cell, reference, args.motion, progress=progress)
    tolerance = checked.tolerance
    values = {"cut": cell.cutting.detail, **as_dict(checked), "tolerance": tolerance and as_dict(tolerance)}
    words = [f"{'as programmed' if reference is None else 'corrected'}: {tolerance.words}"] if tolerance else []
    if args.verbose:
        return checked, values, [*words, cut_text_of(cell), *kuka_frames(cell), *checked.lines()]
    return checked, values, [*words, *[cut_text_of(cell)] * bool(thin_chips(cell)), *checked.lines(short=True)]


def _refuse_reference(args, cells) -> None:
    if args.reference and len(cells) > 1:
        advice = f"choose the tool with --set path.tool={cells[0].stage.tool}"
        raise InputError(args.reference, f"is the trajectory of one tool, and the cell has {len(cells)}: {advice}")


def _headed(cell, cells, lines) -> list:
    """Return the output of a tool, below its name if there are several."""
    if len(cells) == 1:
        return list(lines)
    return [f"\n{cell.stage}: {cell.tool.diameter * 1e3:g} mm, {cell.tool.teeth} teeth", *lines]


def _by_tool(cells, values: list[dict]) -> dict:
    """Return the values for ``--json``: those of the only tool, or a list with those of each."""
    if len(cells) == 1:
        return values[0]
    return {
        "tools": [{"tool": cell.stage.tool, **tool_values} for cell, tool_values in zip(cells, values, strict=True)]
    }


def _scores(cell, summary: dict) -> list[str]:

    x, y, z = summary["mean_force_n"]
    ringing = summary["ringing_frequency_hz"]
    engaged = round(1e9 * path_of(cell).full_engagement) <= path_of(cell).target.duration_ns
    place = "once fully engaged" if engaged else "at the end of the path, before the tool is fully engaged"
    return [
        f"static deviation    {summary['static_deviation_um']:10.3f} um   mean over the last quarter",
        f"max deviation       {summary['max_deviation_um']:10.3f} um   {place}",
        f"low frequency       {summary['low_frequency_hz']:10.3f} Hz   model; ringing {ringing:.3f} Hz",
        f"mean force          {x:10.3f} {y:.3f} {z:.3f} N   last quarter, workpiece axes",
    ]


def _reference(cell, path: str):

    run, target = read_csv(Path(path))[0], path_of(cell).target
    if run.duration_ns != target.duration_ns:
        both = f"{run.duration_ns * 1e-9:.9g} s, but the path of this cell {target.duration_ns * 1e-9:.9g} s"
        raise InputError(path, f"is no reference for this cell: it lasts {both}")
    far = float(np.max(np.linalg.norm(run.position - target.sample(run.time_ns), axis=1)))
    # [m] from the path that a reference may be, the most that compensation.max_correction_mm may say
    if not far <= 0.05:
        raise InputError(path, f"is no reference for this cell: it goes {far:.3g} m away from its path")
    return run


def _summary(cell, scored) -> dict:

    result = scored.result
    duration = float(result.time[-1])
    return {
        **scored.row(),
        "commanded_joints_deg": jobs.joint_ranges(cell, scored.reference),
        "cut": cell.cutting.detail,
        "steps": result.micro_steps,
        "duration_s": duration,
        "wall_s": result.wall_time,
        "real_time_factor": duration / result.wall_time,
        "mean_force_n": jobs.mean_force(result),
        "removed_area_mm2": result.removed_area * 1e6,
        "removed_volume_mm3": result.removed_volume * 1e9,
        "largest_pose_correction_um": float(result.correction.max()) * 1e6,
        "ringing_damping": scored.scores.ringing_damping,
    }


def plant_of(args, cell):
    """Return the plant of ``--plant`` and ``--noise-um``; None: the model cuts, without imperfections."""
    chosen = [f"path.tool={cell.stage.tool}"] if cell.stage else []
    cuts = read_cell(find_file(args.plant), chosen) if args.plant else cell
    if cell.stage and not cuts.stage:
        raise InputError(args.plant, f"is no plant for a cell with tools: it needs tools.{cell.stage.tool}, too")
    imperfections = cuts.imperfections
    if args.noise_um is not None:
        imperfections = imperfections.replace(pose_noise=1e-6 * args.noise_um)
    added = (
        imperfections.pose_noise,
        imperfections.repeatability,
        imperfections.servo_frequency,
        imperfections.servo_delay,
        imperfections.joining,
    )
    perfect = not (any(added) or imperfections.backlash.any())
    return None if perfect and not args.plant else Plant(cell, cuts, imperfections)
