"""``simulate``: one pass of a cell, as programmed or along a reference; ``check``: whether that may be run."""

from __future__ import annotations

import contextlib
from pathlib import Path

from kr270_milling.base.column import columns_of, table_of
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import staged
from kr270_milling.show.commands.command import CELL, MOTIONS, PLANT, REFERENCE, command, option
from kr270_milling.show.commands.console import Answer, cell_of, joints_text, plant_of
from kr270_milling.show.commands.progress import progress

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
    from kr270_milling.cell import jobs
    from kr270_milling.decide.check_cut import residue_of
    from kr270_milling.decide.part import FeatureRow, assess, write_part
    from kr270_milling.decide.tolerance import judge
    from kr270_milling.show.report.series import write_series

    cell = cell_of(args)
    reference = None if args.reference is None else _reference(cell, args.reference)
    name = "original" if reference is None else Path(args.reference).stem
    plant = plant_of(args, cell)
    with staged(args.out) if args.out else contextlib.nullcontext((None, None)) as (draft, final):
        with progress("milling") as report:
            ran = jobs.simulate(cell, reference, name, report, plant)
        summary = _summary(cell, ran)
        residue = residue_of(cell, ran.result)
        summary["simulated_pass"] = residue.as_dict()
        part = None if cell.programmed.straight else assess(cell, ran)
        tolerance = judge(cell, ran, part)
        summary["tolerance"] = tolerance.as_dict()
        if part:
            summary |= {key: value for key, value in part.as_dict().items() if key != "name"}
        if draft and final:
            files = write_series(draft, cell, [ran])
            if not cell.programmed.straight:
                files.append(draft / "part.stl")
                write_part(files[-1], cell, ran.result)
            summary["files"] = [str(final(path)) for path in files]
    columns = (("feature", "feature", 1), *columns_of(FeatureRow, unit="um"))
    return Answer(summary, [
        *([table_of(FEATURES, columns, (*summary["features"], summary["whole_part"]))] if part else _scores(summary)),
        f"tolerance: {tolerance.words}",
        residue.text,
        cell.cut_text,
        joints_text(summary["commanded_joints_deg"]),
        f"removed area        {summary['removed_area_mm2']:10.3f} mm2",
        f"{summary['steps']} micro-steps in {summary['wall_s']:.3f} s, {summary['real_time_factor']:.1f} x real time",
        *summary.get("files", []),
    ])  # fmt: skip


def run_check(args) -> Answer:
    """Exit code 1 if the path must not be run."""
    from kr270_milling.decide import check as decision
    from kr270_milling.decide.tolerance import judge
    from kr270_milling.path.trajectory_csv import read_csv

    cell = cell_of(args)
    reference = None if args.reference is None else read_csv(Path(args.reference))[0]
    with progress("checking") as report:
        checked = decision.check(cell, reference, args.motion, progress=report)
        tolerance = judge(cell, checked.ran) if checked.ran else None
    result = {"cell": args.cell, "reference": args.reference, "cut": cell.cutting.detail, **checked.as_dict()}
    result["tolerance"] = tolerance and tolerance.as_dict()
    words = [f"{'as programmed' if reference is None else 'corrected'}: {tolerance.words}"] if tolerance else []
    return Answer(result, [*words, cell.cut_text, *checked.lines()], code=int(not checked.may_be_run))


def _scores(summary: dict) -> list[str]:
    x, y, z = summary["mean_force_n"]
    ringing = summary["ringing_frequency_hz"]
    return [
        f"static deviation    {summary['static_deviation_mm'] * 1e3:10.3f} um   mean over the last quarter",
        f"max deviation       {summary['max_deviation_mm'] * 1e3:10.3f} um   once fully engaged",
        f"low frequency       {summary['low_frequency_hz']:10.3f} Hz   model; ringing {ringing:.3f} Hz",
        f"mean force          {x:10.3f} {y:.3f} {z:.3f} N   last quarter, workpiece axes",
    ]


def _reference(cell, path: str):
    import numpy as np

    from kr270_milling.path.trajectory_csv import read_csv

    run, target = read_csv(Path(path))[0], cell.target()
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
        "largest_correction_um": float(result.correction.max()) * 1e6,
        "ringing_damping": ran.scores.ringing_damping,
    }
