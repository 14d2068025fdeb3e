"""``kr270_milling map``: where to clamp the part, how to turn the tool, in which posture."""

from __future__ import annotations

from kr270_milling.commands.console import Answer, Table, output_directory
from kr270_milling.commands.options import add_cell, option
from kr270_milling.commands.progress import progress
from kr270_milling.nodes.option_types import bounded, grid

MOST = 10_000_000
BEST = 5  #: placements that are written as cells
COLUMNS = ("x_mm", "y_mm", "z_mm", "turn_deg", "tool_turn_deg", "branch", "error_max_um", "compensated_max_um")
AXES = {
    "x": ("mm", "of the workpiece's origin on base_link"),
    "y": ("mm", "likewise"),
    "z": ("mm", "likewise"),
    "turn": ("deg", "of the workpiece about z of base_link, on top of the cell's"),
    "tool-turn": ("deg", "of the tool about its own axis"),
}


def add_arguments(parser) -> None:
    add_cell(parser)
    for name, (unit, text) in AXES.items():
        option(parser, f"--{name} LOW:HIGH:COUNT", f"[{unit}] {text}", grid(-1e5, 1e5, 1_000_000))
    option(parser, "--out DIR", "where rows, cells and picture go", default="map")
    option(parser, "--scheduler ADDRESS", "a running Dask scheduler, tcp://host:port")
    option(parser, "--chunk N", "placements a file", bounded(1, 100_000, int), 500)
    along = parser.add_argument_group("along a path")
    turn = "turn the tool about its axis along this tool path (default: that of the cell), where the workpiece is"
    option(along, "--along PATH", turn, nargs="?", const="")
    option(along, "--smooth UM", "how much error [um] a turn of 1 deg/s is worth", bounded(0.001, 1e6), 1.0)
    option(along, "--places N", "along the path", bounded(3, 5000, int), 200)


def run(args) -> Answer:
    if args.along is not None:
        from kr270_milling.commands.map_along import run_along

        return run_along(args)
    import numpy as np

    from kr270_milling.base.errors import ParameterError
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.studies.engine import Study, content, run_chunks
    from kr270_milling.studies.placements import Placements, Summary, course_of, write_cells, write_picture

    source = find_file(args.cell).resolve()
    cell = read_cell(source, args.set)
    here = [*(1e3 * cell.workpiece.xyz).tolist(), 0.0, 0.0]
    given = [args.x, args.y, args.z, args.turn, args.tool_turn]
    scales = [1e-3] * 3 + [np.pi / 180.0] * 2
    axes = tuple(
        scale * (np.array([value]) if axis is None else np.linspace(*axis))
        for axis, value, scale in zip(given, here, scales, strict=True)
    )
    placements = Placements(cell, course_of(cell), axes, args.chunk)
    if len(placements) > MOST:
        raise ParameterError("map", len(placements), f"at most {MOST} placements in all")
    plan = {"study": "map", "cell": content(source, cell), "set": args.set, "axes": given, "chunk": args.chunk}
    study = Study(output_directory(args.out), plan)
    made = len(study.missing(placements.chunks)) / placements.chunks  # share of the rows that this run makes
    postures = 8 * args.chunk * len(placements.course.position)
    with progress("map", unit="chunks", rate="postures", each=postures) as report:
        seconds = run_chunks(study, placements.chunks, placements, args.scheduler, report)
    summary = Summary(axes[0], axes[1], BEST)
    for table in study.tables(placements.chunks):
        summary.add(table)
    cells = write_cells(args.out, source, args.set, cell, placements.course, summary.best)
    rate = made * summary.rows / seconds if seconds else None
    found = {
        "rows": summary.rows,
        "rows_per_s": rate,
        "postures_per_s": rate and rate * len(placements.course.position),
        "feasible": summary.feasible,
        "best": [row | {"cell": str(path)} for row, path in zip(summary.best, cells, strict=True)],
        "picture": str(write_picture(args.out, summary)),
        "out": args.out,
    }
    rows = [[f"{row[name]:.4g}" for name in COLUMNS] for row in found["best"]]
    return Answer(found, [
        Table("Best placements: largest static error across the feed [um]", COLUMNS, rows),
        f"{found['rows']} rows, {found['feasible']} feasible: {found['out']}",
        *(row["cell"] for row in found["best"]),
        found["picture"],
    ])  # fmt: skip
