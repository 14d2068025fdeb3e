"""``kr270_milling sweep``: full passes with other values of any keys, scores to Parquet, on all cores."""

from __future__ import annotations

from kr270_milling.commands.console import Answer, output_directory
from kr270_milling.commands.options import add_cell, option
from kr270_milling.commands.progress import progress
from kr270_milling.nodes.option_types import bounded


def add_arguments(parser) -> None:
    add_cell(parser)
    vary = "values of a key, also KEY=A,B,C; may be given several times"
    option(parser, "--vary KEY=LOW:HIGH:STEP", vary, action="append", required=True)
    option(parser, "--samples N", "with --latin: that many rows", int)
    option(parser, "--latin", "a Latin hypercube between the values instead of a grid", bool)
    option(parser, "--seed N", "of --latin", int, 1)
    option(parser, "--out DIR", "where the rows go", default="sweep")
    option(parser, "--scheduler ADDRESS", "a running Dask scheduler, tcp://host:port")
    option(parser, "--chunk N", "rows a file (default: 1 to 8)", bounded(1, 100_000, int), 0)


def run(args) -> Answer:
    from kr270_milling.base.errors import ParameterError
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.studies.engine import Study, content, run_chunks
    from kr270_milling.studies.sweep import Sweep, parse_axis

    if args.latin != (args.samples is not None):
        raise ParameterError("--samples", args.samples, "given together with --latin")
    cell = find_file(args.cell).resolve()
    hashed = content(cell, read_cell(cell, args.set))  # what no row could run is refused before anything is started
    axes = tuple(parse_axis(text) for text in args.vary)
    sweep = Sweep(str(cell), tuple(args.set), axes, args.samples, args.seed, args.chunk)
    plan = {"study": "sweep", "cell": hashed, "set": args.set, "vary": args.vary, "samples": args.samples,
            "seed": args.seed, "chunk": args.chunk}  # fmt: skip
    study = Study(output_directory(args.out), plan)
    with progress("sweep", unit="chunks", rate="passes", each=sweep.chunk) as report:
        seconds = run_chunks(study, sweep.chunks, sweep, args.scheduler, report)
    failed = sum(bool(text) for table in study.tables(sweep.chunks, ["error"]) for text in table["error"].to_pylist())
    found = {"rows": len(sweep), "failed": failed, "out": args.out, "wall_s": seconds}
    return Answer(found, [f"{len(sweep)} rows, {failed} failed (column error), in {seconds:.1f} s: {args.out}"])
