"""Figures of several passes side by side: revised trajectories (Fig. 14), path deviation (Fig. 15), slot walls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kr270_milling.report.derived import Walls
from kr270_milling.report.style import GREY, colour, line, marked, new_figure, plain, styled
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["deviations", "revised_trajectories", "walls"]


@styled
def revised_trajectories(target: Trajectory, references: Sequence[tuple[str, Trajectory]]) -> Figure:
    """f_y and v_fy of each revised trajectory against the target, Fig. 14: at the controller step, and between."""
    figure, grid = new_figure(4.8, 2, 1, sharex=True)
    place, rate = grid[:, 0]
    fine = np.unique(np.concatenate([np.linspace(0, target.duration_ns, 1201).astype(np.int64), target.time_ns]))
    for number, (name, reference) in enumerate(references, 1):
        shift = (reference.sample(fine) - target.sample(fine))[:, 1]
        knots = (reference.sample(reference.time_ns) - target.sample(reference.time_ns))[:, 1]
        line(place, fine * 1e-9, shift * 1e6, colour(number), plain(name))
        place.plot(reference.time, knots * 1e6, color=colour(number), marker="o", markersize=3, linestyle="none")
        speed = (reference.sample_velocity(fine) - target.sample_velocity(fine))[:, 1]
        line(rate, fine * 1e-9, speed * 60e3, colour(number))
    place.axhline(0.0, color=GREY, linewidth=0.6)
    rate.axhline(0.0, color=GREY, linewidth=0.6)
    place.set_ylabel("shift of the reference $f_y$ [µm]")
    rate.set(ylabel="its rate $v_{fy}$ [mm/min]", xlabel="time [s]", xlim=(0, target.duration_ns * 1e-9))
    if references:
        place.legend(loc="best", title="dots: points at the controller step", title_fontsize=8)
    return figure


@styled
def deviations(passes: Sequence[tuple[str, np.ndarray, np.ndarray]], engaged_from: float) -> Figure:
    """Path deviation of every pass, Fig. 15: all in one, then each compensated one on its own scale.

    passes: name, time (n,) [s], deviation (n,) [m], the original first; engaged_from [s]: scored from here on.
    """
    rows = max(1, len(passes))
    heights = [1.6] + [1.0] * (rows - 1)
    figure, grid = new_figure(1.6 + 1.25 * rows, rows, 1, sharex=True, height_ratios=heights)
    for number, (name, time, deviation) in enumerate(passes):
        line(grid[0, 0], time, deviation * 1e6, colour(number), plain(name), linewidth=1.2)
        if number:
            _own_scale(grid[number, 0], name, time, deviation * 1e6, engaged_from, colour(number))
    for axes in grid[:, 0]:
        marked(axes, engaged_from, max(time[-1] for _, time, _ in passes))
        axes.axhline(0.0, color=GREY, linewidth=0.6)
        axes.set_ylabel("deviation\n[µm]")
    grid[0, 0].legend(loc="best", ncols=2)
    grid[-1, 0].set(xlabel="time [s]", xlim=(0, max(time[-1] for _, time, _ in passes)))
    return figure


def _own_scale(axes: Axes, name: str, time, deviation, engaged_from: float, shade: str) -> None:
    scored = deviation[time >= engaged_from - 1e-9]
    largest = float(np.max(np.abs(scored))) if scored.size else float(np.abs(deviation[-1]))
    line(axes, time, deviation, shade)
    for border in (-largest, largest):
        axes.axhline(border, color=shade, linestyle=":", linewidth=0.8)
    limit = 1.35 * max(largest, 1e-6)
    axes.set_ylim(-limit, limit)
    axes.set_title(f"{plain(name)}: within ±{largest:.2f} µm where fully engaged")


@styled
def walls(passes: Sequence[tuple[str, Walls]], left_y: float | None, right_y: float | None, x_range) -> Figure:
    """Deviation of the slot's walls from nominal along x, the machined profile: all passes, then the compensated ones.

    left_y, right_y: nominal y of the walls [m], None where there is no material; x_range (2,) [m]: shown.
    """
    sides = [(s, y) for s, y in (("left", left_y), ("right", right_y)) if y is not None]
    rows, columns = 1 + (len(passes) > 1), max(1, len(sides))
    figure, grid = new_figure(0.8 + 1.9 * rows, rows, columns, sharex=True, sharey="row")
    for column, (side, nominal) in zip(grid.T, sides, strict=False):
        for number, (name, wall) in enumerate(passes):
            shown = (wall.x >= x_range[0]) & (wall.x <= x_range[1]) & np.isfinite(getattr(wall, side))
            x, error = wall.x[shown] * 1e3, (getattr(wall, side)[shown] - nominal) * 1e6
            for axes in column[: 1 if number == 0 else 2]:
                line(axes, x, error, colour(number), plain(name), buckets=150, linewidth=0.8)
        outward = "cut too deep" if side == "left" else "material left"
        column[0].set_title(f"{side} wall, nominal y = {nominal * 1e3:g} mm\n(above 0: {outward})")
        column[-1].set(xlabel="x of the workpiece [mm]", xlim=np.asarray(x_range) * 1e3)
    for axes in grid.ravel():
        axes.axhline(0.0, color=GREY, linewidth=0.6)
    for axes, text in zip(grid[:, 0], ("all passes", "compensated"), strict=False):
        axes.set_ylabel(f"{text}\nwall off by [µm]")
    grid[0, 0].legend(loc="best", ncols=2)
    return figure
