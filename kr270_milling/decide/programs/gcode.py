"""The G-code program of a cell with corrected coordinates, for KUKA.CNC, other robots and machine tools.

The points of a line are those that its part of the corrected path needs: the path through them is within
``program.tolerance`` of the corrected path, and the last point is the end of the line. G1 blocks are joined as LIN
motions are, by parabolas from ``program.blend_distance`` before a point, or by those that miss the point by P of G64.
N numbers, tool calls, cycles, comments and rapid moves stay; only a rapid move to the start of a cut ends at the
corrected start. Feeds stay as programmed. The tool axis stays, too: 3-axis G-code has no words for the small turns of a
correction.
"""

from __future__ import annotations

import hashlib
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling.base.column import column, computed
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import encoding_of, write_files
from kr270_milling.base.version import __version__
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import path_of, program_path
from kr270_milling.decide.programs.krl import trajectory_hash
from kr270_milling.decide.programs.krl_motion import WIDEST, printable_ascii
from kr270_milling.decide.programs.points import CURVED, dense_times, point_numbers
from kr270_milling.path.cam.gcode.rewriter import GcodeSource, read_source
from kr270_milling.path.cam.readers import GCODE, read_toolpath, reader_of
from kr270_milling.path.controller_motion import places_on_program
from kr270_milling.path.timing import TimedPath, time_path
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory

NO_GCODE = "corrected G-code needs path.file, a program in G-code"


@dataclass(frozen=True)
class WrittenGcode:
    """The G-code of one tool, read back by ``read_gcode``."""

    tool: str = column("tool")
    source_blocks: int = column("source_blocks")  #: lines with a feed move
    blocks: int = column("blocks")  #: G1 blocks in their place
    error: float = column("error_um", 1e6)  #: [m], distance of the read path from the planned path, in the feed moves
    blended: float = column("blended_um", 1e6)  #: [m], the same distance of the path with rounded corners
    deviation: float = column("max_deviation_um", 1e6)  #: [m], largest deviation of a pass along that path
    duration: float = column("duration_s")  #: [s], by the time law of the controller, without the limits of the joints
    planned_duration: float = column("planned_duration_s")  #: [s], duration of the source by the same law
    written_out: bool = column("written_out")  #: without the parameters, sub-programs and shifts of the source

    @computed("sentence")
    def text(self) -> str:
        """Return one line."""
        tool = f"{self.tool}: " if self.tool else ""
        return (
            f"{tool}{self.blocks} G1 blocks for {self.source_blocks} feed moves; read back, they are within "
            f"{1e6 * self.error:.2g} um of the planned path, with rounded corners within {1e6 * self.blended:.2g} um, "
            f"and take {self.duration:.4g} s by the time law (the source {self.planned_duration:.4g} s); a pass along "
            f"the rounded path has a largest deviation of {1e6 * self.deviation:.3g} um"
            + "; parameters, sub-programs and shifts of the source are written out"
            * self.written_out
        )


def check_gcode(cells: Sequence[Cell]) -> GcodeSource:
    """Return the program of the cells, one cell a tool; raise InputError where its G-code cannot be corrected."""
    file = cells[0].path.file
    if not file or reader_of(file) is not GCODE:
        raise InputError(file or "--gcode", NO_GCODE)
    if not cells[0].compensation.sag_compensated:
        reason = (
            "G-code states no joints, so the controller must compensate the sag: compensation.sag_compensated: true"
        )
        raise InputError("--gcode", reason)
    if any(cell.compensation.turn == "best" for cell in cells):
        raise InputError("--gcode", "has no words for a turn of the tool: compensation.turn must be keep")
    if not all(cell.path.source.spindle_speeds for cell in cells):
        raise InputError(file, "cuts without S and M3, so its corrected G-code would cut with the spindle off")
    if cells[0].path.offsets.size:
        raise InputError(file, "corrected G-code is written in one work offset, so path.offsets_mm must be left out")
    for path in (cell.path.read() for cell in cells):
        if isinstance(path, Toolpath) and np.any(path.quaternion != TOOL_DOWN):
            reason = "corrected G-code is written for a tool along z; the robot program takes a tilted one"
            raise InputError(file, reason)
    tools = {cell.path.source.tool for cell in cells}
    return read_source(file, tools, float(cells[0].stock.max[2]), cells[0].path.feed_rate)


def write_gcode(
    directory,
    jobs: Sequence[tuple[Cell, Trajectory]],
    *,
    method: str,
    date: str,
    decision: Sequence[str] = (),
    released: bool = True,
) -> tuple[Path, list[WrittenGcode]]:
    """Write the program of the cells, one cell a tool, along their revised trajectories; return its path and what was
    read back of each tool that mills.

    method: for the name; date: ISO text; decision: its lines, for the header. A program that is not released has
    NOT_RELEASED in name and header. Raises InputError as ``check_gcode``.
    """
    source, every = check_gcode([cell for cell, _ in jobs]), 0
    cell = jobs[0][0]
    passes = cell.compensation.finish
    if source.written_out and (passes or cell.compensation.scheduled):
        reason = "parameters, sub-programs and shifts must be written out first, for compensation.finish and .feed"
        raise InputError(cell.path.file, reason)
    if passes:
        if len(jobs) > 1:
            raise InputError("--gcode", "writes compensation.finish for a program with one tool only")
        start, height = program_path(cell).position[0], float(cell.stock.max[2]) + cell.krl.safe_height
        source, every = source.repeated(passes, start, max(height, float(_timed(cell).toolpath.position[:, 2].max())))
    plans = [_Plan.of(cell, run, source, every) for cell, run in jobs if path_of(cell).mills]
    ends = {line: points for plan in plans for line, points in plan.ends.items()}
    feeds = {line: rates for plan in plans for line, rates in plan.feeds.items() if plan.cell.compensation.scheduled}
    hashes = [trajectory_hash(run) for _, run in jobs]
    mark = hashes[0] if len(hashes) == 1 else hashlib.sha256("".join(hashes).encode()).hexdigest()
    file = Path(jobs[0][0].path.file)
    name = f"gcode_{method}_{date[:10].replace('-', '')}_{mark[:8]}{file.suffix}"
    path = Path(directory) / (name if released else f"NOT_RELEASED_{name}")
    lines = source.rewritten(ends, feeds)
    notes = [
        *([] if released else ["NOT RELEASED: FOR INSPECTION ONLY"]),
        "SIMULATION RESULT: VERIFY WITH REDUCED OVERRIDE AND WITHOUT MATERIAL BEFORE MILLING",
        f"kr270_milling {__version__}, {date}, method {method}, feed moves are G1 blocks on the corrected path",
        f"sha256 of the source {jobs[0][0].path.sha256}",
        *decision,
    ]
    texts = [printable_ascii(note).replace("(", "[").replace(")", "]") for note in notes]
    lines[source.head : source.head] = [  # the first word shows a reader that they name no operation and no tool
        source.comment.format(f"part program: {line}") for text in texts for line in textwrap.wrap(text, WIDEST)
    ]
    data = file.read_bytes()
    newline = "\r\n" if b"\r\n" in data[:4096] else "\n"
    write_files({path: [newline.join(lines).encode(encoding_of(data))]})
    return path, [plan.compared(path) for plan in plans]


@dataclass(frozen=True, eq=False)
class _Plan:
    """The points of one tool: of each row of feed moves its start and the ends of its blocks."""

    cell: Cell
    run: Trajectory
    time_ns: np.ndarray  #: [ns], (p,)
    row: np.ndarray  #: (p,), number of the row
    block: np.ndarray  #: (p,) bool: end of a block; else the start of a row, to which a rapid move leads
    feed: np.ndarray  #: [m/s], (p,)
    ends: dict[int, np.ndarray]  #: line -> points [m]
    feeds: dict[int, np.ndarray]  #: line -> feeds of the points [m/s]
    source_blocks: int
    written_out: bool

    @classmethod
    def of(cls, cell: Cell, run: Trajectory, source: GcodeSource, every: int) -> _Plan:
        """every: lines from one pass along the same path to the next."""
        timed = _timed(cell)
        path = timed.toolpath
        cuts = ~path.rapid & ~path.drilling
        lines = path.line if every else source.lines_of(path, cell.path.file, cell.path.feed_rate)
        if every:
            again = np.arange(len(path)) - len(program_path(cell))  # blocks after the first pass
            count = (again[-1] + 1) // cell.compensation.finish
            lines = lines + every * np.where(again < 0, 0, 1 + again // count)
        other = (lines[2:] != lines[1:-1]) | (cuts[2:] != cuts[1:-1])
        if cell.compensation.scheduled:
            other |= (path.feed[2:] != path.feed[1:-1]) & cuts[2:]
        last = np.flatnonzero(np.append(other, True)) + 1  #: block at the end of each move
        line, feed = lines[last].tolist(), cuts[last]
        times = np.append(0, _time_at(timed, np.cumsum(path.block_length)[last]))
        points = _point_times(cell, run, times[np.append(feed, False) | np.append(False, feed)])
        after = np.searchsorted(points, times, side="right")
        ends: dict[int, list] = {}
        feeds: dict[int, list] = {}
        rows: list[tuple] = []  #: of each move the number of its row, times, whether these are ends of blocks, feed
        same_place = 0.05e-6  # [m], half of the last digit in mm

        def add(number: int, places: np.ndarray, rate: float) -> None:
            ends.setdefault(number, []).append(places)
            feeds.setdefault(number, []).append(np.full(len(places), rate))

        for move in np.flatnonzero(feed).tolist():
            rate = float(path.feed[last[move]])
            inside = points[after[move] : after[move + 1]]
            begins = move == 0 or not feed[move - 1]
            number = (rows[-1][0] if rows else 0) + begins
            if begins:
                start, time_ns = path.position[last[move - 1] if move else 0], times[move : move + 1]
                moved = np.abs(run.sample(time_ns[0]) - start).max() > same_place
                before = line[move - 1] if move else int(lines[0])
                rapid = before in source.moves and source.moves[before].kind == "rapid"
                if moved or rapid:
                    add(before if rapid else line[move], run.sample(time_ns), rate)
                rows.append((number, time_ns, moved and not rapid, rate))
            add(line[move], run.sample(inside), rate)
            rows.append((number, inside, True, rate))
        numbers, stamps, blocks, rates = zip(*rows, strict=True)
        count = list(map(len, stamps))
        return cls(
            cell,
            run,
            np.concatenate(stamps),
            np.repeat(numbers, count),
            np.repeat(blocks, count),
            np.repeat(rates, count),
            {number: np.concatenate(parts) for number, parts in ends.items()},
            {number: np.concatenate(parts) for number, parts in feeds.items()},
            len(set(np.array(line)[feed])),
            source.written_out,
        )

    def compared(self, file: Path) -> WrittenGcode:
        """Read the program back and compare its path with the planned one; raise InputError for another program."""
        cell, tool = self.cell, self.cell.path.source.tool
        read = read_toolpath(file, tool, cell.path.feed_rate)
        ends = np.flatnonzero(~read.rapid & ~read.drilling)
        if len(ends) != self.block.sum():
            raise InputError(file, f"read back, it has {len(ends)} feed moves where {self.block.sum()} were written")
        settings = cell.compensation
        same_rate = 0.01  # share: feeds are written with one decimal in mm/min
        other = np.abs(read.feed[ends] - self.feed[self.block]) > same_rate * self.feed[self.block]
        stopped = read.spindle_speed[ends] == 0.0
        if (settings.scheduled or settings.finish) and (other.any() or stopped.any()):
            block = int(np.argmax(other | stopped))
            what = "the spindle is off" if stopped[block] else "another feed is read than was written"
            reason = f"read back, {what}: compensation.feed and .finish need feeds per minute and S, M3 that stay on"
            raise InputError(file, reason, int(read.line[ends[block]]))
        places = np.empty((len(self.block), 3))
        places[self.block] = read.position[ends]
        starts = np.flatnonzero(~self.block)
        places[starts] = read.position[ends[np.cumsum(self.block)[starts]] - 1]
        motion = self._motion(places)
        missed = np.linalg.norm(motion.position - self.run.sample(motion.time_ns), axis=1)
        return WrittenGcode(
            tool,
            self.source_blocks,
            len(ends),
            self._error(places),
            float(missed.max()),
            simulate(cell, motion).scores.max_deviation,
            _duration(cell, read),
            _duration(cell, _timed(cell).toolpath),
            self.written_out,
        )

    def _motion(self, places: np.ndarray) -> Trajectory:
        """Return the motion through places (p, 3) [m] with rounded corners, and the planned one on the other moves."""
        run, program = self.run, self.cell.krl
        times = np.union1d(np.concatenate([run.time_ns, self.time_ns]), dense_times(run, program.tolerance))
        fine = Trajectory(times, run.sample(times), run.quaternion[0], None, run.frame)
        time_ns, first = np.unique(self.time_ns, return_index=True)
        ends = times[[0, -1]][~np.isin(times[[0, -1]], time_ns)]
        at = np.argsort(np.concatenate([time_ns, ends]), kind="stable")
        points = np.concatenate([places[first], run.sample(ends)])[at]
        row = np.concatenate([self.row[first], np.full(len(ends), -1)])[at]
        knots = np.searchsorted(times, np.concatenate([time_ns, ends])[at])
        stops = np.concatenate([[True], (row[1:] != row[:-1])[:-1] | (row[1:] != row[:-1])[1:], [True]])
        stops |= np.isin(times[knots], run.time_ns[run.standing])
        blend: float | np.ndarray = program.blend_distance
        if rounding := self.cell.path.source.rounding:
            direction = np.diff(points, axis=0)
            direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
            turn = np.linalg.norm(np.diff(direction, axis=0), axis=1)
            blend = np.pad(4.0 * rounding / np.maximum(turn, 1e-9), 1)
        place = places_on_program(fine, knots, points, stops, False, blend)
        span = np.clip(np.searchsorted(knots, np.arange(len(times)), side="right") - 1, 0, len(knots) - 2)
        between = (row[span] != row[span + 1]) | (row[span] < 0)  # rapid moves and drilling
        return fine.with_position(np.where(between[:, None], fine.position, place))

    def _error(self, places: np.ndarray) -> float:
        """Return the largest distance [m] of the planned path from the straight lines between places (p, 3)."""
        times = dense_times(self.run, self.cell.krl.tolerance)
        times = np.union1d(times, (times[1:] + times[:-1]) // 2)
        span = np.clip(np.searchsorted(self.time_ns, times, side="right") - 1, 0, len(places) - 2)
        inside = (times >= self.time_ns[span]) & (times <= self.time_ns[span + 1])
        inside &= self.row[span] == self.row[span + 1]
        span = span[inside]
        way, move = self.run.sample(times[inside]) - places[span], places[span + 1] - places[span]
        share = np.sum(way * move, axis=1) / np.maximum(np.sum(move**2, axis=1), 1e-30)
        return float(np.linalg.norm(way - np.clip(share, 0.0, 1.0)[:, None] * move, axis=1).max(initial=0.0))


def _timed(cell: Cell) -> TimedPath:
    timed = path_of(cell).timed
    if timed is None:
        raise InputError("--gcode", NO_GCODE)
    return timed


def _duration(cell: Cell, path: Toolpath) -> float:
    """[s], under the limits of the controller alone."""
    return 1e-9 * time_path(path, cell.timing).trajectory.duration_ns


def _time_at(timed: TimedPath, distance: np.ndarray) -> np.ndarray:
    """Return the times [ns] at distances [m] along the path; at a knot the time of the knot."""
    time_ns = timed.trajectory.time_ns
    after = np.clip(np.searchsorted(timed.distance, distance), 1, len(time_ns) - 1)
    low, high = time_ns[after - 1], time_ns[after]
    same_knot = 1e-9  # [m], along the path
    for knot in (after, after - 1):
        at = np.abs(timed.distance[knot] - distance) < same_knot
        low, high = np.where(at, time_ns[knot], low), np.where(at, time_ns[knot], high)
    while np.any(high - low > 1):
        middle = (low + high) // 2
        below = timed.distance_at(middle) < distance
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return high


def _point_times(cell: Cell, run: Trajectory, needed: np.ndarray) -> np.ndarray:
    """Return the times [ns] of the points of a run; needed [ns]: of the ends of the moves."""
    times = np.union1d(dense_times(run, cell.krl.tolerance), needed)
    fine = Trajectory(times, run.sample(times), run.quaternion[0], None, run.frame)
    fixed = np.isin(times, needed) | np.isin(times, run.time_ns[run.standing])
    blend = 0.0 if cell.path.source.rounding else cell.krl.blend_distance
    program = cell.krl.replace(motion="LIN", tolerance=(1.0 - CURVED) * cell.krl.tolerance, blend_distance=blend)
    return times[point_numbers(program, fine, fine, fixed)]
