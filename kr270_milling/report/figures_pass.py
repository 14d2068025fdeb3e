"""Figures of one pass: forces (Fig. 12), displacement (Fig. 13), spectra."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from kr270_milling.report.derived import amplitude_spectrum, moving_mean, thinned_spectrum
from kr270_milling.report.style import COLOURS, GREY, line, marked, new_figure, styled

__all__ = ["displacement", "forces", "spectra"]


@styled
def forces(
    time: np.ndarray, wrench: np.ndarray, revolution: float, engaged_from: float, zoom: np.ndarray, micro_step: float
) -> Figure:
    """F_x and F_y over a pass, Fig. 12: means over exchange periods, and one revolution at micro-steps.

    time (n,) [s], wrench (n, 6) [N, N m] its means over the periods that end there; revolution, engaged_from [s];
    zoom (m, 3) [N]: force at each micro-step of a last stretch that ends with the pass, micro_step [s]; may be empty.
    """
    figure, grid = new_figure(4.4, 2, 2, width_ratios=[2.1, 1.0], sharex="col", sharey="row")
    period = time[1] - time[0]
    for k, (row, name) in enumerate(zip(grid, "xy", strict=True)):
        whole, turn = row
        marked(whole, engaged_from, time[-1])
        line(whole, time[1:], wrench[1:, k], COLOURS[5], "mean of each exchange period", linewidth=0.6)
        window = max(1, round(revolution / period))
        inner = slice(window // 2, max(len(time) - 1 - window // 2, window // 2 + 1))  # whole revolutions only
        smooth = moving_mean(wrench[1:, k], window)[inner]
        line(whole, time[1:][inner], smooth, COLOURS[0], "mean over one revolution", linewidth=1.3)
        whole.set_ylabel(f"$F_{name}$ on the tool [N]")
        _one_revolution(turn, zoom[:, k], micro_step, time, wrench[:, k], revolution)
    for axes in grid[1]:
        axes.legend(loc="best")
    grid[0, 0].set_title("the whole pass")
    grid[0, 1].set_title("the last revolution")
    grid[1, 0].set_xlabel("time [s]")
    grid[1, 1].set_xlabel("time before the end [ms]")
    return figure


def _one_revolution(axes: Axes, zoom, micro_step: float, time, means, revolution: float) -> None:
    end = time[-1]
    shown = time >= end - revolution - 1e-9
    axes.step((time[shown] - end) * 1e3, means[shown], where="pre", color=COLOURS[5], label="exchange period")
    if zoom.size:
        count = min(zoom.size, round(revolution / micro_step))
        before_end = (np.arange(-count, 0) + 0.5) * micro_step
        line(axes, before_end * 1e3, zoom[-count:], COLOURS[1], "micro-step")


@styled
def displacement(time: np.ndarray, deflection: np.ndarray, engaged_from: float) -> Figure:
    """Dynamic displacement of the tool over a pass, Fig. 13 (there x and y); deflection (n, 6) [m, rad]."""
    figure, ((axes,),) = new_figure(3.0)
    marked(axes, engaged_from, time[-1])
    line(axes, time, deflection[:, 0] * 1e6, COLOURS[1], "x, along the feed")
    line(axes, time, deflection[:, 1] * 1e6, COLOURS[2], "y, across the feed", linewidth=1.4)
    line(axes, time, deflection[:, 2] * 1e6, COLOURS[3], "z, along the spindle", linestyle="--")
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    axes.set(xlabel="time [s]", ylabel="displacement of the tool [µm]", xlim=(time[0], time[-1]))
    axes.legend(loc="best")
    return figure


@styled
def spectra(
    force: np.ndarray, force_step: float, lateral: np.ndarray, step: float, tooth_frequency: float, low_frequency: float
) -> Figure:
    """Amplitude spectra of the force (n, 3) [N] and of the displacement across the feed (m,) [m].

    Sampled every force_step and step [s]; tooth passing and lowest lateral mode [Hz] are marked.
    """
    figure, grid = new_figure(4.4, 2, 1, sharex=True)
    above, below = grid[:, 0]
    high = 4.0 * tooth_frequency
    for k, name in enumerate("xy"):
        frequency, amplitude = amplitude_spectrum(force[:, k], force_step)
        above.plot(*thinned_spectrum(frequency, amplitude, high), color=COLOURS[k + 1], label=f"$F_{name}$")
    frequency, amplitude = thinned_spectrum(*amplitude_spectrum(lateral * 1e6, step), high)
    below.plot(frequency, amplitude, color=COLOURS[2])
    for axes, decades in ((above, 1e5), (below, 1e6)):
        top = max((series.get_ydata().max(initial=0.0) for series in axes.lines), default=0.0) or 1.0
        axes.set(xlim=(1.0, high), ylim=(top / decades, 8 * top))  # before the scales: there may be nothing to scale
        axes.set(xscale="log", yscale="log")
        axes.axvline(tooth_frequency, color=COLOURS[1], linestyle="--", linewidth=0.9)
        axes.axvline(low_frequency, color=COLOURS[3], linestyle="--", linewidth=0.9)
    top = above.get_ylim()[1]
    for at, text, colour in ((tooth_frequency, "teeth", COLOURS[1]), (low_frequency, "arm", COLOURS[3])):
        above.annotate(f"{text} {at:.4g} Hz", (at, top), (-3, -2), textcoords="offset points", va="top", ha="right",
                       color=colour, fontsize=8)  # fmt: skip
    above.set(ylabel="force [N]")
    below.set(ylabel="displacement y [µm]", xlabel="frequency [Hz]")
    above.legend(loc="center left")
    return figure
