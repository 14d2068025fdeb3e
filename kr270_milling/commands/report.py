"""``kr270_milling report``: the report of one recording, or of a directory of recordings."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_common, fixed, output_directory, print_json, print_table, progress


def add_arguments(parser) -> None:
    parser.add_argument("recording", metavar="FILE-or-DIR", help="a recording, or a directory that holds some")
    parser.add_argument("--namespace", metavar="NAME", help="of the robot, where a recording holds several")
    parser.add_argument(
        "--out", metavar="DIR", help="where the report goes (default: report in DIR, or beside the FILE)"
    )
    add_common(parser)


def run(args) -> None:
    import datetime

    from kr270_milling.replay.recorded import pass_from_recording
    from kr270_milling.report import write_report
    from kr270_milling.report.series import write_series

    place = Path(args.recording)
    paths = recordings(place)
    with progress("reading") as report:
        found = []
        for number, path in enumerate(paths, 1):
            found.append(pass_from_recording(path, path.stem, args.namespace))
            report(number, len(paths))
    cell, passes = found[0].cell, [one.scored for one in found]
    directory = output_directory(args.out or (place if place.is_dir() else place.parent) / "report")
    date = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    title, command = f"Milling passes of {cell.arm.name}, recorded", f"kr270_milling report {args.recording}"
    page = write_report(directory, cell, passes, title=title, source=args.recording, command=command, date=date)
    write_series(directory, cell, passes)
    rows = [{**one.scored.row(), "messages_lost": one.messages_lost, "complete": one.complete} for one in found]
    if args.json:
        print_json({"passes": rows, "report": str(page), "out": str(directory)})
        return
    columns = ["pass", "static [um]", "max [um]", "lost", "complete"]
    print_table("Path deviation, from the recordings", columns, [_cells(row) for row in rows])
    print(f"report: {page}")


def recordings(path: Path) -> list[Path]:
    """The .mcap files of a file, a recording's directory or a directory of such, in the order of their writing."""
    from kr270_milling.base.errors import InputError

    if path.is_file():
        return [path]
    found = sorted([*path.glob("*.mcap"), *path.glob("*/*.mcap")], key=lambda p: (p.stat().st_mtime_ns, p))
    if not found:
        raise InputError(path, "holds no recording (.mcap)" if path.is_dir() else "is no such file or directory")
    return found


def _cells(row: dict) -> list[str]:
    static, largest = row["static_deviation_mm"] * 1e3, row["max_deviation_mm"] * 1e3
    return [
        row["name"],
        fixed(static),
        fixed(largest),
        str(row["messages_lost"]),
        "yes" if row["complete"] else "no",
    ]
