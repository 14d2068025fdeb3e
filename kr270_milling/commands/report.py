"""``kr270_milling report``: the report of one recording, or of several passes of one path on the same scales."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kr270_milling.commands.console import Answer, Table, command_line, fixed, now, output_directory
from kr270_milling.commands.options import option
from kr270_milling.commands.progress import progress

if TYPE_CHECKING:
    from kr270_milling.replay.recorded import RecordedPass

COLUMNS = ("pass", "static [um]", "max [um]", "lost", "complete")


def add_arguments(parser) -> None:
    what = "recordings, or directories that hold some; passes of one path are compared on the same scales"
    option(parser, "recordings FILE-or-DIR", what, nargs="+")
    option(parser, "--namespace NAME", "of the robot, where a recording holds several")
    option(parser, "--out DIR", "where the report goes (default: report in the first DIR, or beside the first FILE)")


def run(args) -> Answer:
    from kr270_milling.report import write_report
    from kr270_milling.report.series import write_series

    places = [Path(place) for place in args.recordings]
    found, copies = _read(places, args.namespace)
    cell, passes = found[0].cell, [one.scored for one in found]
    first = places[0]
    directory = output_directory(args.out or (first if first.is_dir() else first.parent) / "report")
    title = f"Milling pass{'es' * (len(passes) > 1)} of {cell.arm.name}, recorded"
    with progress("report"):
        page = write_report(
            directory, cell, passes, title=title, source=first.name, command=command_line(args), date=now(),
            program=found[0].program,
        )  # fmt: skip
        write_series(directory, cell, passes)
    rows = [{**one.scored.row(), "messages_lost": one.messages_lost, "complete": one.complete} for one in found]
    table = Table("Path deviation, from the recordings", COLUMNS, [_cells(row) for row in rows])
    skipped = [f"skipped, a copy of another pass: {copy}" for copy in copies]
    about = {"passes": rows, "copies": copies, "report": str(page), "out": str(directory)}
    return Answer(about, [table, *skipped, f"report: {page}"])


def _read(places: Sequence[Path], namespace: str | None) -> tuple[list[RecordedPass], list[str]]:
    """The passes, and the recordings that hold a pass that is there already. Raises InputError for another path."""
    from concurrent.futures import ThreadPoolExecutor

    import numpy as np

    from kr270_milling.base.errors import InputError
    from kr270_milling.replay.recorded import pass_from_recording

    paths = list(dict.fromkeys(path for place in places for path in recordings(place)))
    names = unique_names(paths)
    found: list[RecordedPass] = []
    copies: list[str] = []
    with progress("reading") as report, ThreadPoolExecutor(2) as pool:  # the sweep runs without the interpreter's lock
        read = pool.map(lambda path, name: pass_from_recording(path, name, namespace), paths, names)
        for number, (path, one) in enumerate(zip(paths, read, strict=True), 1):
            report(number, len(paths))
            if any(_same(one.scored, other.scored) for other in found):
                copies.append(str(path))
                continue
            target, first = one.cell.target(), (found or [one])[0].cell.target()
            if not np.array_equal(target.time_ns, first.time_ns) or not np.allclose(target.position, first.position):
                raise InputError(path, f"is a pass of another path than {paths[0]}: give each path a report of its own")
            found.append(one)
    return found, copies


def _same(one, other) -> bool:
    """Whether two recorded passes hold the same poses and wrenches: a copy, or what was recovered of one."""
    import numpy as np

    a, b = one.result, other.result
    return all(np.array_equal(getattr(a, key), getattr(b, key)) for key in ("time_ns", "tool", "wrench"))


def unique_names(paths: Sequence[Path]) -> list[str]:
    """The stem of each file, with its directories in front where stems are alike."""
    names = [path.stem for path in paths]
    for depth in range(1, 8):
        if len(set(names)) == len(names):
            break
        names = [
            "/".join((*path.parent.parts[-depth:], path.stem)) if names.count(name) > 1 else name
            for path, name in zip(paths, names, strict=True)
        ]
    return names


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
    numbers = [fixed(1e3 * row[f"{name}_deviation_mm"]) for name in ("static", "max")]
    return [row["name"], *numbers, str(row["messages_lost"]), "yes" if row["complete"] else "no"]
