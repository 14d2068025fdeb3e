"""Studies: ``stability`` (lobes), ``map`` (where to clamp the part, how to turn the tool) and ``sweep`` (any keys)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from kr270_milling.base.column import as_dict, columns_of, table_of
from kr270_milling.base.errors import ParameterError
from kr270_milling.base.extensions import require_extra
from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.decide.stability import FeatureLimit, feature_limits, modes_of
from kr270_milling.path.trajectory import write_csv
from kr270_milling.physics.motion.stability import Lobe
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.cdr import TRAJECTORY
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.show.commands.console import Answer, output_directory, progress, shown_path, steps
from kr270_milling.show.report.study_page import gain_text, sweep_tables, write_lobes, write_map, write_sweep
from kr270_milling.studies.maps import along as turning
from kr270_milling.studies.maps.engine import Study, content, run_chunks
from kr270_milling.studies.maps.lobes import engagement_text, lobes
from kr270_milling.studies.maps.placements import (
    PlacementRow,
    Placements,
    Summary,
    grid_axes,
    path_places,
    place_of,
    places_at,
    present_row,
    write_cells,
    write_placement,
)
from kr270_milling.studies.maps.sweep import Sweep, SweepSummary, parse_axis

OTHERS = (
    "the path itself: check and --along take the engagement, feed direction and posture of each feature, so that their "
    "limits differ from the lobes"
)


def _rigid(cell) -> str:
    """Return the words about a limit without ``tool.modes``."""
    return "" if cell.tool.modes.frequency.size else ", with tool and spindle taken as rigid (no tool.modes)"


def run_stability(args) -> Answer:

    cell = read_cell(find_file(args.cell), args.set)
    about = {"cell": args.cell, "arm": not args.no_arm}
    if args.along:
        rows = list(map(as_dict, feature_limits(cell, not args.no_arm)))
        rpm = cell.tool.spindle_speed * 30.0 / math.pi
        title = f"Limit depth along the path, as in check, at {rpm:.0f} rpm{_rigid(cell)}"
        *engagement, stable = columns_of(FeatureLimit)
        columns = *engagement, *columns_of(Lobe)[1:], stable
        return Answer(about | {"features": rows}, [table_of(title, columns, rows)])
    nominal = cell.tool.spindle_speed * 30.0 / math.pi
    low, high, count = args.speeds or (0.5 * nominal, 1.5 * nominal, 60)
    with progress("stability") as report:
        speeds = (np.linspace(low, high, count) * np.pi / 30.0).tolist()
        results = lobes(path_of(cell), cell.cutting, modes_of(cell, not args.no_arm), speeds, report)
    rows = list(map(as_dict, results))
    (_, speed, speed_text), (_, depth, depth_text), _ = shown = columns_of(Lobe)
    best = max(rows, key=lambda row: row[depth])
    summary = f"deepest stable cut: {depth_text(best[depth])} mm at {speed_text(best[speed])} rpm{_rigid(cell)}"
    files = _write_lobes(args, cell, rows, summary) if args.out else []
    about |= {"radial_immersion": cell.path.radial_immersion, "mode": cell.path.mode, "lobes": rows, "files": files}
    cut = engagement_text(cell.path)
    title = f"Stability lobes of {cut} (path.radial_immersion, path.mode) at the start of the path"
    # rows of the printed table
    table = table_of(title, shown, rows[:: max(1, -(-len(rows) // 24))])
    return Answer(about, [table, summary, OTHERS, *files])


def _write_lobes(args, cell, rows: list[dict], summary: str) -> list[str]:
    """Write table and page; return their paths."""
    with staged(args.out) as (draft, final):
        table = draft / "lobes.csv"
        text = [",".join(repr(float(value)) for value in row.values()) for row in rows]
        table.write_text("\n".join([",".join(rows[0]), *text]) + "\n", encoding="utf-8")
        page = write_lobes(
            draft, cell, Path(args.cell).name, rows, summary, arm=not args.no_arm, self_contained=args.self_contained
        )
        return [str(final(table)), str(final(page))]


STUDIES = ("pyarrow", "dask", "distributed")  #: Dask with --scheduler only
TURNED_RECORDING, TURNED_TABLE, TURNED_CELL = "along", "along.csv", "along.yaml"


def run_map(args) -> Answer:
    if args.along is None:
        require_extra("map", "studies", *STUDIES[: 3 if args.scheduler else 1])

    if args.along is not None:
        return _along(args)
    source = find_file(args.cell).resolve()
    cell = read_cell(source, args.set)
    ranges = [args.x, args.y, args.z, args.turn, args.tool_turn]
    axes = grid_axes(cell.workpiece, [None if axis is None else np.linspace(*axis) for axis in ranges])
    path = path_of(cell)
    plan = {
        "study": "map",
        "cell": content(source, path.path.sha256),
        "set": args.set,
        "axes": ranges,
        "chunk": args.chunk,
    }
    study = Study(output_directory(args.out), plan)
    with steps() as whole:
        with whole("pass of the cell") as report:
            places = path_places(path, simulate(cell, progress=report).result)
            left = cell.uncertainty.left
            placements = Placements(arm_of(cell), left, places, axes, args.chunk)
        share = len(study.missing(placements.chunks)) / placements.chunks  # share of the rows that this run makes
        with whole("map") as report:
            seconds = run_chunks(study, placements.chunks, placements, args.scheduler, report)
    summary = Summary(axes[0], axes[1], 5)  # placements that are written as cells
    for table in study.tables(placements.chunks):
        summary.add(table)
    cells = write_cells(args.out, source, args.set, placements, summary.best, cell.posture_key)
    rate = share * summary.rows / seconds if seconds else None
    present = present_row(placements, path.target)
    page = write_map(args.out, cell.arm, path, source.name, summary, present, self_contained=args.self_contained)
    result = {
        "rows": summary.rows,
        "rows_per_s": rate,
        "present": present,
        "postures_per_s": rate and rate * len(placements.places.position),
        "feasible": summary.feasible,
        "best": [row | {"cell": str(path)} for row, path in zip(summary.best, cells, strict=True)],
        "picture": str(page),
        "out": args.out,
    }
    shown = [
        table_of("Best placements: largest static error across the feed", columns_of(PlacementRow), result["best"]),
        gain_text(summary, present),
        f"{result['rows']} rows, {result['feasible']} feasible: {result['out']}",
    ]
    return Answer(result, [*shown, *(row["cell"] for row in result["best"]), result["picture"]])


def _along(args) -> Answer:
    """Turn the tool about its axis along a path."""
    if any(axis is not None for axis in (args.x, args.y, args.z, args.turn)):
        raise ParameterError("--along", args.along, "without --x, --y, --z and --turn: the workpiece stays")
    source = find_file(args.cell).resolve()
    settings = [*args.set, *([f"path.file={Path(args.along).resolve()}"] if args.along else [])]
    cell = read_cell(source, settings)
    with progress("milling") as report:
        simulated = simulate(cell, progress=report).result
    chosen = np.linspace(0, len(simulated.time) - 1, min(args.places, len(simulated.time))).astype(int)
    step = float(simulated.time[-1] - simulated.time[0]) / (len(chosen) - 1)
    turns = turning.Turns(
        arm_of(cell), places_at(path_of(cell), simulated, chosen), step, np.degrees(1e-6 * args.smooth)
    )
    grid = np.radians(np.linspace(*(args.tool_turn or (-180.0, 180.0, 73))))
    path, same, own = (
        turning.best_turns(turns, grid),
        turning.constant_turn(turns, grid),
        turning.constant_turn(turns, np.zeros(1)),
    )
    run, q = turning.turned_run(arm_of(cell), path_of(cell).target, simulated.time_ns[chosen], path)
    files = _write(Path(args.out), source, args.set, cell, run, q, path)
    speed = np.abs(np.diff(q, axis=0)) / np.diff(run.time)[:, None] / cell.arm.joint_speed_limit
    result = {
        "rows": len(chosen),
        "rows_per_s": None,
        "branch": path.branch,
        "criterion_um": 1e6 * path.value,
        "criterion_constant_um": 1e6 * same.value if same else None,
        "criterion_unturned_um": 1e6 * own.value if own else None,
        "constant_turn_deg": float(np.degrees(same.turn[0])) if same else None,
        "error_max_um": 1e6 * float(path.error.max()),
        "error_max_constant_um": 1e6 * float(same.error.max()) if same else None,
        "turn_deg": np.degrees([path.turn.min(), path.turn.max()]).tolist(),
        "joint_speed_share": speed.max(axis=0).tolist(),
        "slower": float(run.duration_ns / path_of(cell).target.duration_ns),
        "best": [{"cell": str(files[0])}],
        "files": [str(path) for path in files],
    }
    low, high = result["turn_deg"]
    shown = [f"turning the tool from {low:.4g} to {high:.4g} deg along the path: {1e6 * path.value:.2f} um"]
    for name, other in (("the best turn that stays the same", same), ("not turned", own)):
        shown.append(f"{name}: " + (f"{1e6 * other.value:.2f} um" if other else "not within the limits of the joints"))
    shown += [
        "(root mean square of the static error across the feed and of what turning is worth by --smooth; what corners",
        "and teeth shake is not in it: compare `simulate` of both cells)",
        f"joints run at up to {100 * speed.max():.0f} % of their speeds, the path takes {result['slower']:.3f} times",
    ]
    return Answer(result, [*shown, *files])


def _write(out: Path, source: Path, settings, cell, run, q, path) -> list[Path]:
    """The turned trajectory as a recording, the cell that runs it, and a table with the joint angles."""
    changes = {
        "path": {"file": TURNED_RECORDING},
        "workpiece": place_of(cell.workpiece.pose, cell.workpiece.at_start_joints),
        cell.posture_key: np.degrees(q[0]).tolist(),
    }
    note = f"The tool turns about its axis along the path, from {np.degrees(path.turn[0]):.2f} deg on"
    with staged(out) as (draft, final):
        write_placement(draft / TURNED_CELL, source, settings, changes, note)
        write_csv(draft / TURNED_TABLE, run, q)
        with BagWriter(draft / TURNED_RECORDING) as writer:
            writer.add_topic("/target_trajectory", TRAJECTORY)
            writer.write("/target_trajectory", to_bytes(run), 0)
        return [final(draft / name) for name in (TURNED_CELL, TURNED_TABLE, TURNED_RECORDING)]


def run_sweep(args) -> Answer:
    """Full passes with other values of any keys, scores to Parquet."""
    read = "in Python: pyarrow.parquet.read_table({!r}).to_pandas()"
    require_extra("sweep", "studies", *STUDIES[: 3 if args.scheduler else 1])

    if args.latin != (args.samples is not None):
        raise ParameterError("--samples", args.samples, "given together with --latin")
    cell = find_file(args.cell).resolve()
    # what no row could run is refused before anything is started
    hashed = content(cell, read_cell(cell, args.set).path.sha256)
    axes = tuple(parse_axis(text) for text in args.vary)
    rows = Sweep(str(cell), tuple(args.set), axes, args.samples, args.seed, args.chunk)
    plan = {
        "study": "sweep",
        "cell": hashed,
        "set": args.set,
        "vary": args.vary,
        "samples": args.samples,
        "seed": args.seed,
        "chunk": args.chunk,
    }
    study = Study(output_directory(args.out), plan)
    with steps() as whole, whole("sweep") as report:

        def count(files: int, total: int) -> None:
            whole.label = f"sweep, {min(files * rows.chunk, len(rows))} of {len(rows)} rows"
            report(files, total)

        count(0, rows.chunks)
        seconds = run_chunks(study, rows.chunks, rows, args.scheduler, count)
    summary = SweepSummary(rows)
    for table in study.tables(rows.chunks):
        summary.add(table)
    sentence = f"{len(rows)} rows, {summary.failed} failed (column error), in {seconds:.1f} s: {args.out}"
    picture = shown_path(write_sweep(args.out, summary, [sentence, read.format(args.out)], args.self_contained))
    result = {
        "rows": len(rows),
        "failed": summary.failed,
        "best": summary.best,
        "worst": summary.worst,
        "picture": picture,
        "out": args.out,
        "wall_s": seconds,
    }
    return Answer(result, [*sweep_tables(summary), sentence, read.format(args.out), picture])
