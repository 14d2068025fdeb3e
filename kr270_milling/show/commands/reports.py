"""``kr270_milling report``: the report of one or several recordings."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from kr270_milling.base.column import columns_of, table_of, yes
from kr270_milling.base.errors import InputError, one_line
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.exchange.replay.recorded import RecordedFacts, passes_from_recording
from kr270_milling.physics.motion.scores import Scores
from kr270_milling.recordings.bag.files import find_recording
from kr270_milling.recordings.bag.reader import remapping
from kr270_milling.show.commands.console import Answer, command_line, now, output_directory, say_replaced, steps
from kr270_milling.show.report import write_report
from kr270_milling.show.report.series import write_series

#: suffix of the title of the report by the stamps of the poses
STAMPS = {
    "exchange": "",
    "driver's": "; poses at the driver's stamps",
    "place": "; RSI: poses by their place, without the deflection",
}


def run_report(args) -> Answer:
    """Report one recording, or several passes of one path on the same scales."""
    first = Path(args.recordings[0])
    with steps() as whole:
        recorded, copies = _read([Path(place) for place in args.recordings], args, whole)
        cell, passes = recorded[0][1].cell, [scored for scored, _ in recorded]
        beside = first if first.is_dir() else first.parent
        there = (beside / "report.html").is_file()  # of the run; the report of its recordings replaces it
        directory = output_directory(args.out or (beside if there else beside / "report"))
        say_replaced(directory)
        title = f"Milling pass{'es' * (len(passes) > 1)} of {cell.arm.name}, recorded"
        title += "".join(STAMPS[kind] for kind in sorted({about.stamps for _, about in recorded}))
        with whole("report"):
            page = write_report(
                directory,
                cell,
                passes,
                title=title,
                source=first.name,
                command=command_line(args),
                date=now(),
                program=recorded[0][1].program,
            )
            write_series(directory, arm_of(cell), path_of(cell).target, passes)
    rows = [
        {**scored.row(), "messages_lost": about.messages_lost, "complete": about.complete, "stamps": about.stamps}
        for scored, about in recorded
    ]
    reasons = {name: reason for _, facts in recorded for name, reason in facts.unused.items()}
    unused = [f"{name} is not used: {one_line(reason)}" for name, reason in reasons.items()]
    columns = [("pass", "name", 0), *columns_of(Scores)]
    columns += [("lost", "messages_lost", 0), ("complete", "complete", yes), ("stamps", "stamps", str)]
    table = table_of("Path deviation, from the recordings", columns, rows)
    skipped = [f"skipped, a copy of another pass: {copy}" for copy in copies]
    about = {"passes": rows, "copies": copies, "unused": unused, "report": str(page), "out": str(directory)}
    return Answer(about, [table, *skipped, *unused, f"report: {page}"])


def _read(places: Sequence[Path], args, whole) -> tuple[list[tuple[ScoredPass, RecordedFacts]], list[str]]:
    """The passes, and the recordings that hold a pass that is there already. Raises InputError for another path."""
    chosen = args.namespace, remapping(args.remap), args.cell
    paths = list(dict.fromkeys(path for place in places for path in _recordings(place)))
    names = unique_names(paths)
    recorded: list[tuple[ScoredPass, RecordedFacts]] = []
    copies: list[str] = []
    with whole("reading") as count, ThreadPoolExecutor(2) as pool:  # the sweep runs without the interpreter's lock
        read = pool.map(lambda path, name: passes_from_recording(path, name, *chosen), paths, names)
        for number, (path, passes) in enumerate(zip(paths, read, strict=True), 1):
            count(number, len(paths))
            for scored, about in passes:
                if any(_same(scored, other) for other, _ in recorded):
                    copies.append(str(path))
                elif recorded and _other_path(about, recorded[0][1]):
                    reason = f"is a pass of another path than {paths[0]}: give each path a separate report"
                    raise InputError(path, reason)
                else:
                    recorded.append((scored, about))
    return recorded, copies


def _other_path(about: RecordedFacts, other: RecordedFacts) -> bool:
    """Return whether two recordings have different targets."""
    same = np.array_equal(about.target.time_ns, other.target.time_ns)
    return not same or not np.allclose(about.target.position, other.target.position)


def _same(scored: ScoredPass, known: ScoredPass) -> bool:
    """Return whether two recordings have the same pass: start, poses and wrenches; a copy, or a recovered recording."""
    alike = (np.array_equal(getattr(scored.result, k), getattr(known.result, k)) for k in ("time_ns", "tool", "wrench"))
    return scored.reference.start_ns == known.reference.start_ns and all(alike)


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


def _recordings(path: Path) -> list[Path]:
    """The .mcap files of a file, a recording's directory or a directory of such, in the order of their writing."""
    if path.is_file():
        return [path]
    if (path / "metadata.yaml").is_file():
        return [find_recording(path)]
    files = sorted([*path.glob("*.mcap"), *path.glob("*/*.mcap")], key=lambda p: (p.stat().st_mtime_ns, p))
    if not files:
        raise InputError(path, "holds no recording (.mcap)" if path.is_dir() else "is no such file or directory")
    return files
