"""``kr270_milling simulate``: one pass of a cell, as programmed or along a given reference."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_cell, add_common, output_directory, print_json, progress


def add_arguments(parser) -> None:
    add_cell(parser)
    parser.add_argument("--reference", metavar="FILE.csv", help="run along this trajectory, as written by compensate")
    parser.add_argument("--out", metavar="DIR", help="write the series of the pass here as CSV")
    add_common(parser)


def run(args) -> None:
    from kr270_milling.cell import read_cell
    from kr270_milling.config import find_file
    from kr270_milling.passes import simulate

    cell = read_cell(find_file(args.cell), args.set)
    reference = _reference(args.reference)
    with progress("milling") as report:
        ran = simulate(cell, reference, "original" if reference is None else Path(args.reference).stem, report)
    found = summary(cell, ran)
    if args.out:
        from kr270_milling.report.series import write_series

        found["files"] = [str(p) for p in write_series(output_directory(args.out), cell, [ran])]
    if args.json:
        print_json(found)
        return
    x, y, z = found["mean_force_n"]
    print(f"static deviation    {found['static_deviation_mm'] * 1e3:10.3f} um   mean over the last quarter")
    print(f"max deviation       {found['max_deviation_mm'] * 1e3:10.3f} um   once fully engaged")
    ringing = found["ringing_frequency_hz"]
    print(f"low frequency       {found['low_frequency_hz']:10.3f} Hz   model; ringing {ringing:.3f} Hz")
    print(f"mean force          {x:10.3f} {y:.3f} {z:.3f} N   last quarter, workpiece axes")
    print(f"removed area        {found['removed_area_mm2']:10.3f} mm2")
    print(f"{found['steps']} micro-steps in {found['wall_s']:.3f} s, {found['real_time_factor']:.1f} x real time")
    for name in found.get("files", []):
        print(name)


def _reference(path: str | None):
    if path is None:
        return None
    from kr270_milling.trajectory.trajectory_csv import read_csv

    return read_csv(Path(path))[0]


def summary(cell, ran) -> dict:
    """What ``--json`` prints of one pass."""
    from kr270_milling.passes import mean_force

    result = ran.result
    duration = float(result.time[-1])
    return {
        **ran.row(),
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
