"""``simulate``: one pass of a cell, as programmed or along a reference; ``check``: whether that may be run."""

from __future__ import annotations

import contextlib
from pathlib import Path

from kr270_milling.base.column import as_dict, columns_of, table_of
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import staged
from kr270_milling.show.commands.command import CELL, MOTIONS, PLANT, REFERENCE, command, option
from kr270_milling.show.commands.console import Answer, cells_of, joints_text, plant_of
from kr270_milling.show.commands.progress import steps, title_of

FARTHEST = 0.05  #: [m] from the path that a reference may be, the most that compensation.max_correction_mm may say
FEATURES = "Deviation to the side of the path while cutting, and largest errors of what remains [um]"
COMMANDS = {
    "simulate": command(
        "simulate.run_simulate", "simulate config/paper.yaml --set path.depth_of_cut_mm=1",
        *CELL,
        *PLANT,
        REFERENCE,
        option("--out DIR", "write the series of the pass here as CSV; of a tool path also the part as STL"),
    ),
    "check": command(
        "simulate.run_check", "check config/test_piece.yaml",
        *CELL,
        option("--reference FILE.csv", "check this trajectory, as written by compensate"),
        option("--motion", "default: the cell's program.motion", choices=MOTIONS),
    ),
}  # fmt: skip


def run_simulate(args) -> Answer:
    from kr270_milling.decide.tools import in_turn

    cells = cells_of(args)
    _refuse_reference(args, cells)
    with (
        staged(args.out) if args.out else contextlib.nullcontext((None, None)) as (draft, final),
        steps() as whole,
    ):
        done = in_turn(cells, lambda cell: _simulated(cell, args, draft, final, whole), lambda one: one[0])
    shown = [line for cell, (_, _, lines) in done for line in _headed(cell, cells, lines)]
    return Answer(_by_tool(cells, [summary for _, (_, summary, _) in done]), shown)


def _simulated(cell, args, draft, final, whole):
    """The pass of one tool, what ``--json`` prints of it, and the output for the terminal."""
    from kr270_milling.cell import jobs
    from kr270_milling.cell.models import arm_of, cut_of, cut_text_of, path_of
    from kr270_milling.decide.check_cut import residue_of
    from kr270_milling.decide.part import FeatureRow, assess, write_part
    from kr270_milling.decide.tolerance import judge
    from kr270_milling.show.report.series import write_series

    reference = None if args.reference is None else _reference(cell, args.reference)
    suffix = cell.stage.suffix if cell.stage else ""
    name = f"original{suffix}" if reference is None else Path(args.reference).stem
    with whole.under(title_of(cell))("milling") as report:
        ran = jobs.simulate(cell, reference, name, report, plant_of(args, cell))
    summary = _summary(cell, ran)
    residue = residue_of(cell, ran.result)
    summary["simulated_pass"] = as_dict(residue)
    part = None if path_of(cell).straight else assess(cell, ran)
    tolerance = judge(cell, ran, part)
    summary["tolerance"] = as_dict(tolerance)
    if part:
        summary |= as_dict(part)
    if draft and final:
        files = write_series(draft, arm_of(cell), path_of(cell).target, [ran])
        if not path_of(cell).straight:
            files.append(draft / f"part{suffix}.stl")
            write_part(files[-1], cut_of(cell), ran.result, path_of(cell).clock)
        summary["files"] = [str(final(path)) for path in files]
    columns = columns_of(FeatureRow, unit="um")
    scores: list = _scores(cell, summary)
    if part:
        scores = [table_of(FEATURES, columns, (*summary["features"], summary["whole_part"]))]
    return ran, summary, [
        *scores,
        f"tolerance: {tolerance.words}",
        residue.text,
        cut_text_of(cell),
        joints_text(summary["commanded_joints_deg"]),
        f"removed area        {summary['removed_area_mm2']:10.3f} mm2",
        f"{summary['steps']} micro-steps in {summary['wall_s']:.3f} s, {summary['real_time_factor']:.1f} x real time",
        *summary.get("files", []),
    ]  # fmt: skip


def run_check(args) -> Answer:
    """Exit code 1 if the path must not be run."""
    from kr270_milling.decide.tools import in_turn

    cells = cells_of(args)
    _refuse_reference(args, cells)
    with steps() as whole:
        done = in_turn(
            cells, lambda cell: _checked(cell, args, whole), lambda one: one[0].ran if one[0].may_be_run else None
        )
    all_checked = [checked for _, (checked, _, _) in done]
    may_be_run = all(checked.may_be_run for checked in all_checked)
    result = {"cell": args.cell, "reference": args.reference}
    if len(cells) == 1:
        return Answer(result | done[0][1][1], done[0][1][2], code=int(not may_be_run))
    counts = {f"{severity}s": sum(one.count(severity) for one in all_checked) for severity in ("stop", "warning")}
    result |= {"may_be_run": may_be_run, **counts}
    shown = [line for cell, (_, _, lines) in done for line in _headed(cell, cells, lines)]
    stopped = [cell.path.tool for cell, (checked, _, _) in done if not checked.may_be_run]
    verdict = f"must not be run: stops of {', '.join(stopped)}" if stopped else "may be run, after a test in T1 mode"
    words = f"{len(cells)} tools, {counts['stops']} stops, {counts['warnings']} warnings: the program {verdict}"
    answer = result | _by_tool(cells, [values for _, (_, values, _) in done])
    return Answer(answer, [*shown, "", words], code=int(not may_be_run))


def _checked(cell, args, whole):
    """The check of one tool, what ``--json`` prints of it, and the output for the terminal."""
    from kr270_milling.cell.models import cut_text_of
    from kr270_milling.decide import check as decision
    from kr270_milling.decide.programs.files import kuka_frames
    from kr270_milling.decide.tolerance import judge
    from kr270_milling.path.trajectory_csv import read_csv

    reference = None if args.reference is None else read_csv(Path(args.reference))[0]
    checked = decision.check(cell, reference, args.motion, progress=whole.under(title_of(cell)))
    tolerance = judge(cell, checked.ran) if checked.ran else None
    values = {"cut": cell.cutting.detail, **as_dict(checked), "tolerance": tolerance and as_dict(tolerance)}
    words = [f"{'as programmed' if reference is None else 'corrected'}: {tolerance.words}"] if tolerance else []
    return checked, values, [*words, cut_text_of(cell), *kuka_frames(cell), *checked.lines()]


def _refuse_reference(args, cells) -> None:
    if args.reference and len(cells) > 1:
        advice = f"choose the tool with --set path.tool={cells[0].stage.tool}"
        raise InputError(args.reference, f"is the trajectory of one tool, and the cell has {len(cells)}: {advice}")


def _headed(cell, cells, lines) -> list:
    """The output of a tool, under its name where there are several."""
    if len(cells) == 1:
        return list(lines)
    return [f"\n{cell.stage}: {cell.tool.diameter * 1e3:g} mm, {cell.tool.teeth} teeth", *lines]


def _by_tool(cells, values: list[dict]) -> dict:
    """What ``--json`` prints: the values of the only tool, or a list with those of each."""
    if len(cells) == 1:
        return values[0]
    return {"tools": [{"tool": cell.stage.tool, **one} for cell, one in zip(cells, values, strict=True)]}


def _scores(cell, summary: dict) -> list[str]:
    from kr270_milling.cell.models import path_of

    x, y, z = summary["mean_force_n"]
    ringing = summary["ringing_frequency_hz"]
    engaged = round(1e9 * path_of(cell).full_engagement) <= path_of(cell).target.duration_ns
    scored = "once fully engaged" if engaged else "at the end of the path, before the tool is fully engaged"
    return [
        f"static deviation    {summary['static_deviation_um']:10.3f} um   mean over the last quarter",
        f"max deviation       {summary['max_deviation_um']:10.3f} um   {scored}",
        f"low frequency       {summary['low_frequency_hz']:10.3f} Hz   model; ringing {ringing:.3f} Hz",
        f"mean force          {x:10.3f} {y:.3f} {z:.3f} N   last quarter, workpiece axes",
    ]


def _reference(cell, path: str):
    import numpy as np

    from kr270_milling.cell.models import path_of
    from kr270_milling.path.trajectory_csv import read_csv

    run, target = read_csv(Path(path))[0], path_of(cell).target
    if run.duration_ns != target.duration_ns:
        both = f"{run.duration_ns * 1e-9:.9g} s, but the path of this cell {target.duration_ns * 1e-9:.9g} s"
        raise InputError(path, f"is no reference for this cell: it lasts {both}")
    far = float(np.max(np.linalg.norm(run.position - target.sample(run.time_ns), axis=1)))
    if not far <= FARTHEST:
        raise InputError(path, f"is no reference for this cell: it goes {far:.3g} m away from its path")
    return run


def _summary(cell, ran) -> dict:
    from kr270_milling.cell import jobs

    result = ran.result
    duration = float(result.time[-1])
    return {
        **ran.row(),
        "commanded_joints_deg": jobs.joint_ranges(cell, ran.reference),
        "cut": cell.cutting.detail,
        "steps": result.micro_steps,
        "duration_s": duration,
        "wall_s": result.wall_time,
        "real_time_factor": duration / result.wall_time,
        "mean_force_n": jobs.mean_force(result),
        "removed_area_mm2": result.removed_area * 1e6,
        "removed_volume_mm3": result.removed_volume * 1e9,
        "largest_pose_correction_um": float(result.correction.max()) * 1e6,
        "ringing_damping": ran.scores.ringing_damping,
    }
