"""``simulate``: one pass of a cell, as programmed or along a reference; ``check``: whether that may be run."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import staged
from kr270_milling.cell import jobs
from kr270_milling.commands.console import Answer, cell_of, joints_text, plant_of, table_of
from kr270_milling.commands.progress import progress
from kr270_milling.decision import check as decision
from kr270_milling.decision.check_cut import stability_of
from kr270_milling.decision.part import assess, write_part
from kr270_milling.decision.tolerance import judge
from kr270_milling.report.series import write_series
from kr270_milling.trajectory.trajectory_csv import read_csv

FARTHEST = 0.05  #: [m] from the path that a reference may be, the most that compensation.max_correction_mm may say
FEATURES = "Deviation to the side of the path while cutting, and largest errors of what remains [um]"
COLUMNS = (
    ("feature", "feature", 1), ("cut [mm]", "cut_length_mm", 1), ("max", "max_normal_um", 1),
    ("mean", "mean_normal_um", 1), ("95 %", "q95_normal_um", 1), ("wall", "max_wall_error_um", 1),
    ("floor", "max_floor_error_um", 1), ("force [N]", "max_force_n", 1), ("power [W]", "max_power_w", 1),
)  # fmt: skip


def simulate(args) -> Answer:
    cell = cell_of(args)
    reference = None if args.reference is None else _reference(cell, args.reference)
    name = "original" if reference is None else Path(args.reference).stem
    plant = plant_of(args, cell)
    with staged(args.out) if args.out else contextlib.nullcontext((None, None)) as (draft, final):
        with progress("milling") as report:
            ran = jobs.simulate(cell, reference, name, report, plant)
        found = _summary(cell, ran)
        stability = stability_of(cell, ran.result)
        found["stability"] = stability.as_dict()
        part = None if cell.programmed.straight else assess(cell, ran)
        tolerance = judge(cell, ran, part)
        found["tolerance"] = tolerance.as_dict()
        if part:
            found |= {key: value for key, value in part.as_dict().items() if key != "name"}
        if draft and final:
            files = write_series(draft, cell, [ran])
            if not cell.programmed.straight:
                files.append(draft / "part.stl")
                write_part(files[-1], cell, ran.result)
            found["files"] = [str(final(path)) for path in files]
    return Answer(found, [
        *([table_of(FEATURES, COLUMNS, (*found["features"], found["whole_part"]))] if part else _scores(found)),
        f"tolerance: {tolerance.words}",
        stability.text,
        joints_text(found["commanded_joints_deg"]),
        f"removed area        {found['removed_area_mm2']:10.3f} mm2",
        f"{found['steps']} micro-steps in {found['wall_s']:.3f} s, {found['real_time_factor']:.1f} x real time",
        *found.get("files", []),
    ])  # fmt: skip


def check(args) -> Answer:
    """Exit code 1 if the path must not be run."""
    cell = cell_of(args)
    reference = None if args.reference is None else read_csv(Path(args.reference))[0]
    with progress("checking") as report:
        checked = decision.check(cell, reference, args.motion, progress=report)
        tolerance = judge(cell, checked.ran) if checked.ran else None
    found = {"cell": args.cell, "reference": args.reference, **checked.as_dict()}
    found["tolerance"] = tolerance and tolerance.as_dict()
    words = [f"{'as programmed' if reference is None else 'corrected'}: {tolerance.words}"] if tolerance else []
    return Answer(found, [*words, *checked.lines()], code=int(not checked.may_be_run))


def _scores(found: dict) -> list[str]:
    x, y, z = found["mean_force_n"]
    ringing = found["ringing_frequency_hz"]
    return [
        f"static deviation    {found['static_deviation_mm'] * 1e3:10.3f} um   mean over the last quarter",
        f"max deviation       {found['max_deviation_mm'] * 1e3:10.3f} um   once fully engaged",
        f"low frequency       {found['low_frequency_hz']:10.3f} Hz   model; ringing {ringing:.3f} Hz",
        f"mean force          {x:10.3f} {y:.3f} {z:.3f} N   last quarter, workpiece axes",
    ]


def _reference(cell, path: str):
    run, target = read_csv(Path(path))[0], cell.target()
    if run.duration_ns != target.duration_ns:
        both = f"{run.duration_ns * 1e-9:.9g} s, but the path of this cell {target.duration_ns * 1e-9:.9g} s"
        raise InputError(path, f"is no reference for this cell: it lasts {both}")
    far = float(np.max(np.linalg.norm(run.position - target.sample(run.time_ns), axis=1)))
    if not far <= FARTHEST:
        raise InputError(path, f"is no reference for this cell: it goes {far:.3g} m away from its path")
    return run


def _summary(cell, ran) -> dict:
    result = ran.result
    duration = float(result.time[-1])
    return {
        **ran.row(),
        "commanded_joints_deg": jobs.joint_ranges(cell, ran.reference),
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
