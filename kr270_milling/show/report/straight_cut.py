"""The charts of a straight cut, with the paper's figures 3 and 11 to 15: the setup, one pass, all passes compared."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.models import cut_of, low_frequency_of, path_of
from kr270_milling.cell.paths import CellPath
from kr270_milling.decide.part import PartAssessment
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import CutModel, Cutting
from kr270_milling.show.report.charts import (
    Chart,
    Curve,
    Panel,
    amplitude_spectrum,
    curve,
    moving_mean,
    thinned_spectrum,
)
from kr270_milling.show.report.series import deviation_of

ZERO = ((0.0, ""),)  #: a level


def charts_of(cell: Cell, passes: Sequence[ScoredPass], parts: Sequence[PartAssessment]) -> list[Chart]:
    """Return all charts of a straight cut; for a tool path the force law alone."""
    path, target = path_of(cell), path_of(cell).target
    feed_per_tooth = path.feed_rate * 2 * np.pi / cell.tool.spindle_speed / cell.tool.teeth
    if not path.straight:
        return [force_law(cell.cutting, feed_per_tooth, 1e-3)]
    result, engaged = passes[0].result, path.full_engagement
    end = float(result.time[-1])
    shade = (engaged, end) if engaged < end else None
    charts = [force_law(cell.cutting, feed_per_tooth, cell.path.depth_of_cut), _start_position(path)]
    charts += _of_pass(cell, passes[0], shade)
    charts += [_references(path, passes[1:])] if len(passes) > 1 else []
    charts.append(_deviations(target, passes, shade))
    along = target.position[[0, -1]]
    if np.ptp(target.position[:, 1]) < 1e-9 and along[1, 0] > along[0, 0]:
        charts += machined_profile(parts)
    return charts


def force_law(cutting: Cutting, feed_per_tooth: float, depth_of_cut: float) -> Chart:
    """F_c(h) of one tooth at depth_of_cut [m], Fig. 3; the feed per tooth [m] is marked."""
    h = np.linspace(0.0, 1.3 * feed_per_tooth, 200)
    h[0] = 1e-9  # edge forces begin with contact
    tangential, radial = cutting.force_per_depth(h)
    micrometres = h * 1e6
    curves = [
        Curve("tangential F_t", micrometres, tangential * depth_of_cut, 0),
        Curve("radial F_r", micrometres, radial * depth_of_cut, 2),
    ]
    uprights = [(feed_per_tooth * 1e6, "feed per tooth")]
    caption = (
        f"Force against uncut chip thickness h at a depth of cut of {depth_of_cut * 1e3:.4g} mm. A full chip is as "
        f"thick as the feed per tooth, {feed_per_tooth * 1e6:.0f} µm."
    )
    law = cutting.active
    curves += [
        Curve(line.name, micrometres, line.per_depth * depth_of_cut, line.colour, "dash") for line in law.lines(h)
    ]
    uprights += [(thickness * 1e6, name) for thickness, name in law.marks()]
    caption = f"{caption} {law.caption}".rstrip()
    top = 1.08 * float(np.max(tangential)) * depth_of_cut
    panel = Panel(
        "uncut chip thickness h [µm]",
        "force of one tooth [N]",
        curves,
        x_range=(0.0, float(micrometres[-1])),
        y_range=(0.0, top),
        uprights=uprights,
    )
    return Chart("force_law", "Cutting force of one tooth", "Fig. 3", caption, [panel])


def _start_position(path: CellPath) -> Chart:
    """Tool and workpiece border at t = 0 from +z of the workpiece, Fig. 11."""
    tool, centre = path.tool, path.target.position[0, :2] * 1e3
    r, feed = tool.radius * 1e3, path.target.sample_velocity(0)[:2]
    ahead = feed / max(np.linalg.norm(feed), 1e-300)
    (x0, y0), (x1, y1) = path.stock.min[:2] * 1e3, path.stock.max[:2] * 1e3
    angle = np.linspace(0.0, 2 * np.pi, 91)

    def at(phi) -> np.ndarray:
        """Direction of a tooth's angle, (..., 2)."""
        return np.stack([np.cos(phi), tool.sense * np.sin(phi)], -1)

    curves = [
        _through("stock", [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]], 7, "area"),
        _through("tool", centre + r * np.column_stack([np.cos(angle), np.sin(angle)]), 2),
    ]
    for number, (phi, radius) in enumerate(zip(tool.angles, tool.radii * 1e3, strict=True), 1):
        curves.append(_through(f"tooth {number}", [centre, centre + radius * at(phi)], legend=False))
        beside = centre + 1.2 * r * at(phi + 0.15)
        curves.append(_through(f"number {number}", [beside], text=str(number), legend=False))
    left = r * np.array([-ahead[1], ahead[0]])
    for side, legend in ((left, True), (-left, False)):
        edge = [centre + side, centre + side + 4.5 * r * ahead]
        curves.append(_through("walls that the cut should leave", edge, 6, "dash", legend=legend))
    curves.append(_through("feed", [centre, centre + 2.4 * r * ahead], 1, text="feed ▸"))
    span = np.stack([centre - 1.5 * r, centre + 1.5 * r, centre + 3.2 * r * ahead])
    x_range, y_range = zip(span.min(axis=0).tolist(), span.max(axis=0).tolist(), strict=True)
    labels = "x of the workpiece [mm]", "y of the workpiece [mm]"
    panel = Panel(*labels, curves, equal=True, x_range=x_range, y_range=y_range)
    turn = "clockwise" if tool.sense < 0 else "counterclockwise"
    caption = f"Seen from above the part. Numbered: the teeth at t = 0; the tool turns {turn}."
    return Chart("start_position", "Tool and workpiece at the start", "Fig. 11", caption, [panel])


def _through(name: str, points, colour: int = 0, look: str = "", **more) -> Curve:
    """A curve through points (n, 2)."""
    x, y = np.asarray(points).T
    return Curve(name, x, y, colour, look, **more)


def _of_pass(cell: Cell, scored: ScoredPass, shade) -> list[Chart]:
    """Force (Fig. 12), displacement (Fig. 13) and their spectra."""
    result, end = scored.result, float(scored.result.time[-1])
    clock = path_of(cell).clock
    revolution, micro_step = 2 * np.pi / cell.tool.spindle_speed, clock.period / clock.micro_steps
    engaged = result.time >= min(path_of(cell).full_engagement, 0.5 * end)
    wrench, force, step = result.wrench[:, :3], result.wrench[engaged, :3], clock.period
    axes = [k for k in range(3) if k < 2 or wrench[:, 2].any()]
    window = max(1, round(revolution / (result.time[1] - result.time[0])))
    curves = []
    for k in axes:
        name = f"F_{'xyz'[k]}"
        curves.append(curve(f"{name} of a period", result.time, wrench[:, k], k + 1, "thin", legend=False))
        curves.append(curve(name, result.time, moving_mean(wrench[:, k], window), k + 1))
    panels = [Panel("time [s]", "force [N]", curves, "the whole pass", shade=shade)]
    if result.micro_steps <= 500_000:  # a longer pass is not swept a second time for its micro-step forces
        fine = micro_step_forces(cut_of(cell), result.tool, clock.micro_steps)
        count = min(len(fine), round(revolution / micro_step))
        time = (end - micro_step * np.arange(count)[::-1]) * 1e3
        last = [Curve(f"F_{'xyz'[k]}", time, fine[-count:, k], k + 1, legend=False) for k in axes]
        panels.append(Panel("time [ms]", "force [N]", last, "the last revolution"))
        force, step = fine[np.repeat(engaged[1:], clock.micro_steps)], micro_step
    forces = (
        f"Pass '{scored.name}'. Thin: means over one exchange period of {clock.period * 1e3:g} ms, so the peaks "
        "within a tooth's engagement are lower there than in the last revolution, which is shown at micro-steps of the "
        "spindle. Bold: mean over a revolution. Shaded: fully engaged."
    )
    rows = zip(("x, along the feed", "y, across the feed", "z, along the spindle"), ("", "", "dash"), strict=True)
    moved = [
        curve(name, result.time, result.deflection[:, k] * 1e6, k + 1, look) for k, (name, look) in enumerate(rows)
    ]
    swings = (
        f"Pass '{scored.name}'. The arm deflects, swings at its low frequency and settles at its static deflection. "
        "What happens before the shaded part is cut away by the teeth that follow."
    )
    panel = Panel("time [s]", "displacement of the tool [µm]", moved, shade=shade, levels=ZERO)
    return [
        Chart("forces", "Force on the tool", "Fig. 12", forces, panels, columns=2),
        Chart("displacement", "Displacement of the tool", "Fig. 13", swings, [panel]),
        _spectra(cell, scored, force, step, result.deflection[engaged, 1]),
    ]


def micro_step_forces(cut: CutModel, tool: np.ndarray, micro_steps: int) -> np.ndarray:
    """Force [N], (n * micro_steps, 3), of every micro-step of a pass, by sweeping a fresh workpiece once more.

    tool: the positions (n + 1, 3) [m] that the cut was given, micro_steps: from one to the next.
    """
    periods = len(tool) - 1
    forces = np.zeros((periods, micro_steps, 3))
    for n in range(periods):
        cut.sweep(tool[n], tool[n + 1], n * micro_steps, micro_steps, forces[n])
    return forces.reshape(-1, 3)


def _spectra(cell: Cell, scored: ScoredPass, force: np.ndarray, step: float, lateral: np.ndarray) -> Chart:
    """Return the spectra of force (n, 3) [N], every ``step`` [s], and lateral (m,) [m], every exchange period."""
    passing, low = cell.tool.teeth * cell.tool.spindle_speed / (2 * np.pi), low_frequency_of(cell)
    high = 4.0 * passing

    def spectrum(name: str, values: np.ndarray, every: float, colour: int) -> Curve:
        return Curve(name, *thinned_spectrum(*amplitude_spectrum(values, every), high), colour)

    of_force = [spectrum(f"F_{name}", force[:, k], step, k + 1) for k, name in enumerate("xy")]
    of_arm = [spectrum("y, across the feed", lateral * 1e6, path_of(cell).clock.period, 2)]
    marks = ((passing, f"teeth {passing:.4g} Hz"), (low, f"arm {low:.4g} Hz"))
    panels = []
    for label, curves, span in (("force [N]", of_force, 1e5), ("displacement y [µm]", of_arm, 1e6)):
        top = max(float(c.y.max(initial=0.0)) for c in curves) or 1.0
        decades = (top / span, 8 * top)
        panels.append(
            Panel("frequency [Hz]", label, curves, log=True, x_range=(1.0, high), y_range=decades, uprights=marks)
        )
    caption = (
        f"Pass '{scored.name}', fully engaged part. Force lives at the tooth passing frequency, {passing:.1f} Hz, and "
        f"its multiples; the arm follows only near its lowest lateral mode, {low:.2f} Hz."
    )
    of_paper = "Figs. 12 and 13 in the frequency domain"
    return Chart("spectra", "Frequencies in force and displacement", of_paper, caption, panels)


def _references(path: CellPath, passes: Sequence[ScoredPass]) -> Chart:
    """Shift of the reference across the feed and its rate, Fig. 14; linear ones jump at the knots."""
    target = path.target
    stamps = np.unique(np.linspace(0, target.duration_ns, 1000).round().astype(np.int64))
    shift, rate = [], []
    for number, scored in enumerate(passes, 1):
        run = scored.reference
        at = stamps
        if run.velocity is None:  # the rate of a straight line is a staircase: both sides of each knot
            at = np.sort(np.concatenate([run.time_ns[1:-1] - 1, run.time_ns]))
        moved = (run.sample(stamps) - target.sample(stamps))[:, 1] * 1e6
        speed = (run.sample_velocity(at) - target.sample_velocity(at))[:, 1] * 60e3
        knots = (run.position - target.sample(run.time_ns))[:, 1] * 1e6
        shift.append(curve(scored.name, stamps * 1e-9, moved, number))
        shift.append(Curve(f"{scored.name}, points", run.time, knots, number, "points", legend=False))
        rate.append(curve(scored.name, at * 1e-9, speed, number, legend=False))
    caption = (
        "Reference minus target, computed from the displacement in earlier passes: points every "
        f"{path.timing.controller_step * 1e3:g} ms. 'linear' joins them by straight lines, so that its rate jumps; the "
        "others join them smoothly."
    )
    span = (0.0, target.duration_ns * 1e-9)
    panels = [
        Panel("time [s]", label, curves, x_range=span, levels=ZERO)
        for label, curves in (("shift f_y [µm]", shift), ("rate v_fy [mm/min]", rate))
    ]
    return Chart("revised_trajectories", "Modified trajectory and its feed rate", "Fig. 14", caption, panels)


def _deviations(target: Trajectory, passes: Sequence[ScoredPass], shade) -> Chart:
    """All passes on one scale, and the compensated ones on their own, Fig. 15."""
    curves = [curve(p.name, p.result.time, deviation_of(p.result, target) * 1e6, k) for k, p in enumerate(passes)]
    rows: list[tuple] = [("all passes", curves, passes, None)]
    if len(passes) > 1:
        again = [Curve(c.name, c.x, c.y, c.colour, legend=False) for c in curves[1:]]
        reach = 1.15e6 * max(p.scores.max_deviation for p in passes[1:])
        span = (-reach, reach) if reach > 0.0 else None
        rows.append(("compensated passes, on their own scale", again, passes[1:], span))
    panels = []
    for title, some, (first, *_), span in rows:
        largest = first.scores.max_deviation * 1e6
        levels = ((largest, f"{first.name}: {largest:.2f} µm"), (-largest, ""))
        label = "path deviation [µm]"
        panels.append(Panel("time [s]", label, some, title, y_range=span, shade=shade, levels=levels))
    caption = (
        "Tool centre minus target, across the feed. Shaded: fully engaged, the part that stays on the workpiece and is "
        "scored. Dotted: the largest deviation there."
    )
    return Chart("path_deviation", "Path deviation before and after compensation", "Fig. 15", caption, panels)


def machined_profile(parts: Sequence[PartAssessment]) -> list[Chart]:
    """Return sentences about the walls of a path along +x; empty without a wall."""
    panels: list[Panel] = []
    for title, normal in (("left wall", -1.0), ("right wall", 1.0)):
        curves = []
        for number, part in enumerate(parts):
            walls = part.walls
            rows = np.flatnonzero(walls.normal[:, 1] * normal > 0.5)
            rows = rows[np.argsort(walls.position[rows, 0])]
            if rows.size:
                x, shift = walls.position[rows, 0] * 1e3, walls.error[rows] * normal * 1e6
                curves.append(curve(part.name, x, shift, number, legend=not panels))
        if curves:
            panels.append(Panel("x [mm]", "error of the wall [µm]", curves, title, levels=ZERO))
    caption = (
        "Error that remains on the part: distance of each wall from its nominal place, from the passages of the teeth. "
        "Positive is to the left of the feed."
    )
    return [Chart("machined_profile", "Machined profile", "", caption, panels)] if panels else []
