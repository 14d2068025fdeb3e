"""``kr270_milling simulate``: one pass of a cell, as programmed or along a given reference."""

from __future__ import annotations

import contextlib
from pathlib import Path

from kr270_milling.commands.console import Answer, Table, fixed, joints_text
from kr270_milling.commands.options import add_cell, add_plant, cell_of, option, plant_of
from kr270_milling.commands.progress import progress

FARTHEST = 0.05  #: [m] from the path that a reference may be, the most that compensation.max_correction_mm may say
COLUMNS = {
    "feature": "feature", "cut [mm]": "cut_length_mm", "max": "max_normal_um", "mean": "mean_normal_um",
    "95 %": "q95_normal_um", "wall": "max_wall_error_um", "floor": "max_floor_error_um", "force [N]": "max_force_n",
    "power [W]": "max_power_w",
}  # fmt: skip


def add_arguments(parser) -> None:
    add_cell(parser)
    add_plant(parser)
    option(parser, "--reference FILE.csv", "run along this trajectory, as written by compensate")
    option(parser, "--out DIR", "write the series of the pass here as CSV; of a tool path also the part as STL")


def run(args) -> Answer:
    from kr270_milling.base.files import staged
    from kr270_milling.cell.jobs import simulate
    from kr270_milling.decision.part import assess
    from kr270_milling.decision.stability import stability_of
    from kr270_milling.decision.tolerance import judge

    cell = cell_of(args)
    reference = _reference(cell, args.reference)
    plant = plant_of(args, cell)
    with staged(args.out) if args.out else contextlib.nullcontext((None, None)) as (draft, final):
        with progress("milling") as report:
            name = "original" if reference is None else Path(args.reference).stem
            ran = simulate(cell, reference, name, report, plant)
        found = summary(cell, ran)
        stability = stability_of(cell, ran.result)
        found["stability"] = stability.as_dict()
        part = assess(cell, ran) if cell.path.file else None
        tolerance = judge(cell, ran, part)
        found["tolerance"] = tolerance.as_dict()
        if part:
            found |= {key: value for key, value in part.as_dict().items() if key != "name"}
        if draft and final:
            found["files"] = [str(final(path)) for path in _write(draft, cell, ran)]
    return Answer(found, [
        *([_features(found)] if part else _scores(found)),
        f"tolerance: {tolerance.words}",
        stability.text,
        joints_text(found["commanded_joints_deg"]),
        f"removed area        {found['removed_area_mm2']:10.3f} mm2",
        f"{found['steps']} micro-steps in {found['wall_s']:.3f} s, {found['real_time_factor']:.1f} x real time",
        *found.get("files", []),
    ])  # fmt: skip


def _scores(found: dict) -> list[str]:
    x, y, z = found["mean_force_n"]
    ringing = found["ringing_frequency_hz"]
    return [
        f"static deviation    {found['static_deviation_mm'] * 1e3:10.3f} um   mean over the last quarter",
        f"max deviation       {found['max_deviation_mm'] * 1e3:10.3f} um   once fully engaged",
        f"low frequency       {found['low_frequency_hz']:10.3f} Hz   model; ringing {ringing:.3f} Hz",
        f"mean force          {x:10.3f} {y:.3f} {z:.3f} N   last quarter, workpiece axes",
    ]


def _write(directory: Path, cell, ran) -> list[Path]:
    """The series, and of a tool path the machined part."""
    from kr270_milling.decision.part import write_part
    from kr270_milling.report.series import write_series

    files = write_series(directory, cell, [ran])
    if cell.path.file:
        files.append(directory / "part.stl")
        write_part(files[-1], cell, ran.result)
    return files


def _features(found: dict) -> Table:
    rows = [
        [value if isinstance(value := row[key], str) else fixed(value, 1) for key in COLUMNS.values()]
        for row in (*found["features"], found["whole_part"])
    ]
    title = "Deviation to the side of the path while cutting, and largest errors of what remains [um]"
    return Table(title, list(COLUMNS), rows)


def _reference(cell, path: str | None):
    if path is None:
        return None
    import numpy as np

    from kr270_milling.base.errors import InputError
    from kr270_milling.trajectory.trajectory_csv import read_csv

    run, target = read_csv(Path(path))[0], cell.target()
    if run.duration_ns != target.duration_ns:
        both = f"{run.duration_ns * 1e-9:.9g} s, but the path of this cell {target.duration_ns * 1e-9:.9g} s"
        raise InputError(path, f"is no reference for this cell: it lasts {both}")
    far = float(np.max(np.linalg.norm(run.position - target.sample(run.time_ns), axis=1)))
    if not far <= FARTHEST:
        raise InputError(path, f"is no reference for this cell: it goes {far:.3g} m away from its path")
    return run


def summary(cell, ran) -> dict:
    """What ``--json`` prints of one pass."""
    from kr270_milling.cell.jobs import joint_ranges, mean_force

    result = ran.result
    duration = float(result.time[-1])
    return {
        **ran.row(),
        "commanded_joints_deg": joint_ranges(cell, ran.reference),
        "steps": result.micro_steps,
        "duration_s": duration,
        "wall_s": result.wall_time,
        "real_time_factor": duration / result.wall_time,
        "mean_force_n": mean_force(result),
        "removed_area_mm2": result.removed_area * 1e6,
        "removed_volume_mm3": result.removed_volume * 1e9,
        "largest_correction_um": float(result.correction.max()) * 1e6,
        "ringing_damping": ran.scores.ringing_damping,
    }
