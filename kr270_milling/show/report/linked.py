"""The pictures that are linked by place: everything that is known at each station of the passes, and the part.

The dictionaries are for the scripts of the page: arrays by station, lengths in mm, errors in um, forces in N.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_closing

from kr270_milling.cell.arm import PlacedArm, commanded_joints
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.paths import CellPath
from kr270_milling.decide.part import PartAssessment
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.physics.cutting import Stock
from kr270_milling.physics.robot.urdf import COLOURS, links_of, urdf
from kr270_milling.show.report.charts import envelope_index, stations


def linked(
    programmed: CellPath, passes: Sequence[ScoredPass], parts: Sequence[PartAssessment], program: str | None = None
) -> dict:
    """Thin the passes to their k common stations; the largest deviation and force of every pass are among them.

    program: text of the tool path file, if the file is missing. Series of a pass are NaN beyond its end.
    """
    result, part = max(zip((p.result for p in passes), parts, strict=True), key=lambda both: len(both[0].time_ns))
    time_ns, target, path = result.time_ns, result.target, part.path
    cutting = np.zeros(time_ns.size, bool)
    series = []
    for scored, assessed in zip(passes, parts, strict=True):
        rows = np.searchsorted(scored.result.time_ns, time_ns)
        known = rows < scored.result.time_ns.size
        known[known] = scored.result.time_ns[rows[known]] == time_ns[known]
        series.append(np.where(known, _series(scored, assessed)[:, np.where(known, rows, 0)], np.nan))
        cutting[known] |= assessed.cutting[rows[known]]
    chosen = stations([np.where(cutting, values, np.nan) for side, _, force, *_ in series for values in (side, force)])
    engaged, knots = result.time >= programmed.full_engagement - 1e-9, programmed.target.time_ns
    line = programmed.line_at(time_ns)
    names = "side", "height", "force", "correction", "lift"  # of the rows of ``_series``
    return {
        "time": time_ns[chosen] * 1e-9,
        "distance": path.distance[chosen] * 1e3,
        "x": target[chosen, 0] * 1e3,
        "y": target[chosen, 1] * 1e3,
        "z": target[chosen, 2] * 1e3,
        "line": line[chosen],  # of the source; 0: none
        "point": np.clip(np.searchsorted(knots, time_ns[chosen]), 0, knots.size - 1) + 1,  # the knot that comes next
        "feature": path.feature[chosen],  # index into ``features``
        "features": path.features,
        "cutting": _joined(cutting, programmed)[chosen].astype(np.int64),  # in some pass, within a revolution
        "scored": (cutting & engaged)[chosen].astype(np.int64),  # the tool cuts and is fully engaged
        "passes": [
            {"name": p.name, **dict(zip(names, rows[:, chosen], strict=True))}
            for p, rows in zip(passes, series, strict=True)
        ],
        "source": _source(programmed.path.file, line[chosen], program),
        "source_name": programmed.path.file_name,
    }


def _joined(cutting: np.ndarray, programmed: CellPath) -> np.ndarray:
    """Return ``cutting`` without the moments in which no tooth of a tool at work is in the material."""
    turn = int(np.ceil(2 * np.pi / programmed.tool.spindle_speed / programmed.clock.period))
    return binary_closing(np.pad(cutting, turn + 1), np.ones(turn + 1, bool))[turn + 1 : -turn - 1] | cutting


def _series(scored: ScoredPass, part: PartAssessment) -> np.ndarray:
    """Deviation to the left of the path and upwards, force, and correction to the left and upwards, (5, n)."""
    shift = scored.result.reference - scored.result.target
    across = np.sum(shift[:, :2] * part.path.left, axis=1)
    _, side, height = part.deviation.T * 1e6
    return np.stack([side, height, part.force, across * 1e6, shift[:, 2] * 1e6])


def _source(file: str, used: np.ndarray, program: str | None) -> list[dict]:
    """Return the lines of the tool path file or its text: all of up to 4000 lines, else those with a station."""
    if not used.any():
        return []
    if program is None:
        try:
            program = Path(file).read_text(encoding="utf-8", errors="replace")
        except OSError:  # it was attached to a recording
            return []
    lines = program.splitlines()
    wanted = range(1, len(lines) + 1) if len(lines) <= 4000 else np.unique(used[used > 0]).tolist()
    return [{"number": n, "text": lines[n - 1][:160]} for n in wanted if n <= len(lines)]


def part_surface(parts: Sequence[PartAssessment]) -> dict:
    """The surfaces of all passes on one thinned grid, rows along y; each cell shows its largest floor error."""
    floors, walls = parts[0].floors, parts[0].walls
    share = max(1, -(-max(floors.height.shape) // 120))  # nodes of the part's map along its longer side
    x, y = (np.nanmean(_blocks(axis[None], 1, share), axis=-1)[0] * 1e3 for axis in (floors.x, floors.y))
    height = np.nanmean(_blocks(floors.height, share, share), axis=-1) * 1e3
    errors = [part.walls.error for part in parts]
    same = [error for error in errors if error.size == walls.error.size]
    chosen = np.unique(np.concatenate([envelope_index(error, 400) for error in same]))
    wall_x, wall_y, wall_z = walls.position[chosen].T * 1e3
    top = wall_z + walls.height[chosen] * 1e3
    unknown = np.full(chosen.size, np.nan)
    passes = [
        {
            "name": part.name,
            "floor": _largest(_blocks(part.floors.error, share, share)).T * 1e6,  # NaN: no floor
            "wall": error[chosen] * 1e6 if error.size == walls.error.size else unknown,
        }
        for part, error in zip(parts, errors, strict=True)
    ]
    return {"x": x, "y": y, "z": height.T, "wall_x": wall_x, "wall_y": wall_y, "wall_z": top, "passes": passes}


def _blocks(values: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Blocks of rows x columns cells, (b, a, rows * columns); those at the far edges are filled up with NaN."""
    down, across = -(-values.shape[0] // rows), -(-values.shape[1] // columns)
    padded = np.full((down * rows, across * columns), np.nan)
    padded[: values.shape[0], : values.shape[1]] = values
    return padded.reshape(down, rows, across, columns).transpose(0, 2, 1, 3).reshape(down, across, -1)


def _largest(blocks: np.ndarray) -> np.ndarray:
    """The value of the largest magnitude, with its sign; NaN where there is none."""
    size = np.where(np.isnan(blocks), -1.0, np.abs(blocks))
    best = np.argmax(size, axis=-1)
    return np.take_along_axis(blocks, best[..., None], axis=-1)[..., 0]


def robot_model(placed: PlacedArm, settings: CompensationSettings, stock: Stock, shown: ScoredPass) -> dict:
    """Return links, parents first, and the commanded postures [rad] at p times of a pass; base_link, lengths in m."""
    run = shown.reference
    time_ns = np.unique(np.linspace(0, run.duration_ns, 240).round().astype(np.int64))  # postures
    thinned = Trajectory(time_ns, run.sample(time_ns), run.sample_orientation(time_ns), None, run.frame)
    joints, low, high = commanded_joints(placed, settings, thinned), stock.min, stock.max
    corners = np.array([[(low, high)[(c >> k) & 1][k] for k in range(3)] for c in range(8)])
    colours = {name: "#" + "".join(f"{round(255 * v):02x}" for v in rgb) for name, rgb in COLOURS.items()}
    return {
        "name": placed.arm.name,
        "links": links_of(urdf(placed.arm, placed.mount, placed.tool.radius)),
        "colours": colours,
        "pass_name": shown.name,
        "time": thinned.time,
        "joints": joints,
        "stock_corners": placed.place.apply(corners),
        "workpiece_rotation": placed.place.rotation,
        "workpiece_xyz": placed.place.position,
    }
