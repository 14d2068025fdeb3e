"""Charts of all passes of a straight cut: the modified trajectory (Fig. 14), deviations (Fig. 15), the walls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.report.charts import Chart, Curve, Panel, curve
from kr270_milling.report.derived import slot_walls
from kr270_milling.report.series import deviation_of

__all__ = ["comparison_charts"]

SAMPLES = 1000  #: of a reference trajectory


def comparison_charts(cell: Cell, passes: Sequence[ScoredPass]) -> list[Chart]:
    """What the compensations did to the trajectory, and what came of it."""
    charts = [_references(cell, passes[1:])] if len(passes) > 1 else []
    charts.append(_deviations(cell, passes))
    target = cell.target()
    if np.ptp(target.position[:, 1]) < 1e-9 and target.position[-1, 0] > target.position[0, 0]:
        charts += _walls(cell, passes)
    return charts


def _references(cell: Cell, passes: Sequence[ScoredPass]) -> Chart:
    """Shift of the reference across the feed and its rate; linear ones jump at the knots."""
    target = cell.target()
    stamps = np.unique(np.linspace(0, target.duration_ns, SAMPLES).round().astype(np.int64))
    shift, rate = [], []
    for number, one in enumerate(passes, 1):
        run = one.reference
        if run.velocity is None:  # the rate of a straight line is a staircase: both sides of each knot
            at = np.sort(np.concatenate([run.time_ns[1:-1] - 1, run.time_ns]))
        else:
            at = stamps
        moved = (run.sample(stamps) - target.sample(stamps))[:, 1] * 1e6
        speed = (run.sample_velocity(at) - target.sample_velocity(at))[:, 1] * 60e3
        knots = (run.position - target.sample(run.time_ns))[:, 1] * 1e6
        shift.append(curve(one.name, stamps * 1e-9, moved, number))
        shift.append(Curve(f"{one.name}, points", run.time, knots, number, "points", legend=False))
        rate.append(curve(one.name, at * 1e-9, speed, number, legend=False))
    caption = (
        "What the controller is told beyond the target, made from the displacement in earlier passes: points every "
        f"{cell.timing.controller_step * 1e3:g} ms. 'linear' joins them by straight lines, so that its rate jumps; the "
        "others join them smoothly."
    )
    panels = (
        Panel("time [s]", "shift f_y [µm]", tuple(shift), levels=((0.0, ""),)),
        Panel("time [s]", "rate v_fy [mm/min]", tuple(rate), levels=((0.0, ""),)),
    )
    return Chart("revised_trajectories", "Modified trajectory and its feed rate", "Fig. 14", caption, panels)


def _deviations(cell: Cell, passes: Sequence[ScoredPass]) -> Chart:
    """All passes on one scale, and the compensated ones on their own."""
    target, engaged = cell.target(), cell.full_engagement
    end = float(passes[0].result.time[-1])
    shade = (engaged, end) if engaged < end else None
    curves = [curve(p.name, p.result.time, deviation_of(p.result, target) * 1e6, k) for k, p in enumerate(passes)]
    panels = [_deviation_panel(curves, passes, shade, "all passes")]
    if len(passes) > 1:
        again = [Curve(c.name, c.x, c.y, c.colour, legend=False) for c in curves[1:]]
        largest = 1.15e6 * max(p.scores.max_deviation for p in passes[1:])
        panels.append(_deviation_panel(again, passes[1:], shade, "compensated passes, on their own scale", largest))
    caption = (
        "Tool centre minus target, across the feed. Shaded: fully engaged, the part that stays on the workpiece and is "
        "scored. Dotted: the largest deviation there."
    )
    title = "Path deviation before and after compensation"
    return Chart("path_deviation", title, "Fig. 15", caption, tuple(panels))


def _deviation_panel(curves, passes: Sequence[ScoredPass], shade, title: str, reach: float | None = None) -> Panel:
    """reach [um]: of the axis to both sides; the first pass's largest deviation is marked."""
    largest = passes[0].scores.max_deviation * 1e6
    levels = ((largest, f"{passes[0].name}: {largest:.2f} µm"), (-largest, ""))
    span = None if reach is None or not reach > 0.0 else (-reach, reach)
    return Panel(
        "time [s]", "path deviation [µm]", tuple(curves), title=title, shade=shade, levels=levels, y_range=span
    )


def _walls(cell: Cell, passes: Sequence[ScoredPass]) -> list[Chart]:
    """The machined profile, where the path runs along +x."""
    path, low, high = cell.target().position, cell.stock.min, cell.stock.max
    span = (max(path[0, 0], low[0]), min(path[-1, 0], high[0]))
    nominal = [path[0, 1] + side * cell.tool.radius for side in (1, -1)]
    sides = [(k, y) for k, y in enumerate(nominal) if low[1] < y < high[1]]
    if not span[0] < span[1] or not sides:
        return []
    found = [(p.name, slot_walls(p.result.time, p.result.actual, cell.tool)) for p in passes]
    panels = []
    for k, y in sides:
        curves = []
        for number, (name, walls) in enumerate(found):
            inside = (walls.x >= span[0]) & (walls.x <= span[1])
            error = ((walls.left, walls.right)[k][inside] - y) * 1e6
            curves.append(curve(name, walls.x[inside] * 1e3, error, number, legend=k == sides[0][0]))
        title = ("left wall", "right wall")[k]
        panels.append(Panel("x [mm]", "error of the wall [µm]", tuple(curves), title=title, levels=((0.0, ""),)))
    caption = (
        "What remains on the part: each wall's distance from its nominal place, from the passages of the teeth. The "
        "fine teeth of the curves are the cusps between two passages of a tooth. Positive is to the left of the feed."
    )
    return [Chart("machined_profile", "Machined profile", "", caption, tuple(panels))]
