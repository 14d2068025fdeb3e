"""The pictures that are linked by place: everything that is known at each station of the passes of one path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_closing

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.part import PartAssessment
from kr270_milling.report.stations import stations

__all__ = ["Linked", "PassSeries", "SourceLine", "linked"]

LONGEST = 160  #: characters of a source line
MOST_LINES = 4000  #: of the source; beyond it only those on which a station lies


@dataclass(frozen=True, eq=False)
class PassSeries:
    """One pass at the stations."""

    name: str
    side: np.ndarray  #: deviation to the left of the path [um], (k,)
    height: np.ndarray  #: deviation upwards [um], (k,)
    force: np.ndarray  #: magnitude of the mean over an exchange period [N], (k,)
    correction: np.ndarray  #: reference minus target, to the left of the path [um], (k,)
    lift: np.ndarray  #: the same, upwards [um], (k,)

    def at(self, rows: np.ndarray) -> PassSeries:
        return PassSeries(self.name, *(values[rows] for values in list(vars(self).values())[1:]))


@dataclass(frozen=True)
class SourceLine:
    number: int  #: from 1
    text: str


@dataclass(frozen=True, eq=False)
class Linked:
    """k stations of the target in the order of time, and every pass there."""

    time: np.ndarray  #: [s], (k,)
    way: np.ndarray  #: along the path [mm], (k,)
    x: np.ndarray  #: of the target, workpiece frame [mm], (k,)
    y: np.ndarray
    z: np.ndarray
    line: np.ndarray  #: of the source, (k,); 0: none
    point: np.ndarray  #: number in the robot program, from 1, (k,): the knot that comes next
    feature: np.ndarray  #: index into ``features``, (k,)
    features: tuple[str, ...]
    cutting: np.ndarray  #: (k,) 0 or 1: material is removed in some pass, within a revolution
    scored: np.ndarray  #: (k,) 0 or 1: the tool cuts and is fully engaged
    passes: tuple[PassSeries, ...]
    source: tuple[SourceLine, ...]
    source_name: str


def linked(
    cell: Cell, passes: Sequence[ScoredPass], parts: Sequence[PartAssessment], program: str | None = None
) -> Linked:
    """Thin the passes to their common stations; the largest deviation and force of every pass are among them.

    Passes that were cut off are NaN beyond their end.
    """
    longest = max(range(len(passes)), key=lambda i: len(passes[i].result.time_ns))
    time_ns, path = passes[longest].result.time_ns, parts[longest].path
    cutting = np.zeros(time_ns.size, bool)
    series = []
    for one, part in zip(passes, parts, strict=True):
        rows = np.searchsorted(one.result.time_ns, time_ns)
        known = rows < one.result.time_ns.size
        known[known] = one.result.time_ns[rows[known]] == time_ns[known]
        series.append(_series(one, part, rows, known))
        cutting[known] |= part.cutting[rows[known]]
    shown = [np.where(cutting, values, np.nan) for one in series for values in (one.side, one.force)]
    chosen = stations(shown)
    engaged = passes[longest].result.time >= cell.full_engagement - 1e-9
    target, timed = passes[longest].result.target, cell.timed_path
    knots = cell.target().time_ns
    line = np.zeros(time_ns.size, np.int64) if timed is None else timed.toolpath.line[timed.block_at(time_ns)]
    return Linked(
        time=time_ns[chosen] * 1e-9,
        way=path.distance[chosen] * 1e3,
        x=target[chosen, 0] * 1e3,
        y=target[chosen, 1] * 1e3,
        z=target[chosen, 2] * 1e3,
        line=line[chosen],
        point=np.clip(np.searchsorted(knots, time_ns[chosen]), 0, knots.size - 1) + 1,
        feature=path.feature[chosen],
        features=tuple(path.features),
        cutting=_joined(cutting, cell)[chosen].astype(np.int64),
        scored=(cutting & engaged)[chosen].astype(np.int64),
        passes=tuple(s.at(chosen) for s in series),
        source=_source(cell, line[chosen], program),
        source_name=Path(cell.path.file).name if cell.path.file else "",
    )


def _joined(cutting: np.ndarray, cell: Cell) -> np.ndarray:
    """Without the moments in which no tooth of a tool at work is in the material."""
    turn = int(np.ceil(2 * np.pi / cell.tool.spindle_speed / cell.clock.period))
    return binary_closing(np.pad(cutting, turn + 1), np.ones(turn + 1, bool))[turn + 1 : -turn - 1] | cutting


def _series(one: ScoredPass, part: PartAssessment, rows: np.ndarray, known: np.ndarray) -> PassSeries:
    """Not yet thinned, at all times of the longest pass."""
    left = part.path.left
    shift = one.result.reference - one.result.target
    columns = (
        part.deviation[:, 1] * 1e6,
        part.deviation[:, 2] * 1e6,
        part.force,
        np.sum(shift[:, :2] * left, axis=1) * 1e6,
        shift[:, 2] * 1e6,
    )
    return PassSeries(one.name, *(np.where(known, values[np.where(known, rows, 0)], np.nan) for values in columns))


def _source(cell: Cell, used: np.ndarray, program: str | None) -> tuple[SourceLine, ...]:
    """Lines of the tool path file, or of its text: all of a short one, else those that are used."""
    if not cell.path.file or not used.any():
        return ()
    if program is None:
        try:
            program = Path(cell.path.file).read_text(encoding="utf-8", errors="replace")
        except OSError:  # it was attached to a recording
            return ()
    lines = program.splitlines()
    wanted = range(1, len(lines) + 1) if len(lines) <= MOST_LINES else np.unique(used[used > 0]).tolist()
    return tuple(SourceLine(n, lines[n - 1][:LONGEST]) for n in wanted if n <= len(lines))
