"""Charts of all passes of a straight cut: the modified trajectory (Fig. 14), deviations (Fig. 15), the walls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.part import PartAssessment
from kr270_milling.report.charts import Chart, Curve, Panel, curve
from kr270_milling.report.series import deviation_of

__all__ = ["comparison_charts"]

SAMPLES = 1000  #: of a reference trajectory


def comparison_charts(cell: Cell, passes: Sequence[ScoredPass], parts: Sequence[PartAssessment]) -> list[Chart]:
    """What the compensations did to the trajectory, and what came of it."""
    charts = [_references(cell, passes[1:])] if len(passes) > 1 else []
    charts.append(_deviations(cell, passes))
    target = cell.target()
    if np.ptp(target.position[:, 1]) < 1e-9 and target.position[-1, 0] > target.position[0, 0]:
        charts += _walls(parts)
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
    span = (0.0, target.duration_ns * 1e-9)
    panels = (
        Panel("time [s]", "shift f_y [µm]", tuple(shift), x_range=span, levels=((0.0, ""),)),
        Panel("time [s]", "rate v_fy [mm/min]", tuple(rate), x_range=span, levels=((0.0, ""),)),
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


def _walls(parts: Sequence[PartAssessment]) -> list[Chart]:
    """The machined profile, where the path runs along +x: what the assessment of the part says of its walls."""
    panels: list[Panel] = []
    for title, normal in (("left wall", -1.0), ("right wall", 1.0)):
        curves = []
        for number, part in enumerate(parts):
            walls = part.surface.walls
            rows = np.flatnonzero(walls.normal[:, 1] * normal > 0.5)
            rows = rows[np.argsort(walls.position[rows, 0])]
            if rows.size:
                x, shift = walls.position[rows, 0] * 1e3, walls.error[rows] * normal * 1e6
                curves.append(curve(part.name, x, shift, number, legend=not panels))
        if curves:
            label = "error of the wall [µm]"
            panels.append(Panel("x [mm]", label, tuple(curves), title=title, levels=((0.0, ""),)))
    caption = (
        "What remains on the part: how far each wall stands from its nominal place, from the passages of the teeth. "
        "Positive is to the left of the feed."
    )
    return [Chart("machined_profile", "Machined profile", "", caption, tuple(panels))] if panels else []
