"""Charts of one pass: force (Fig. 12), displacement (Fig. 13), their spectra."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.report.charts import Chart, Curve, Panel, curve
from kr270_milling.report.derived import amplitude_spectrum, micro_step_forces, moving_mean, thinned_spectrum

__all__ = ["pass_charts"]

#: a longer pass is not swept a second time for its micro-step forces
MOST_MICRO_STEPS = 500_000


def pass_charts(cell: Cell, one: ScoredPass) -> list[Chart]:
    """Force, displacement and spectra of a pass along a straight cut."""
    result, engaged = one.result, cell.full_engagement
    micro_step = cell.clock.period / cell.clock.micro_steps
    revolution = 2 * np.pi / cell.tool.spindle_speed
    shade = (engaged, float(result.time[-1])) if engaged < result.time[-1] else None
    scored = result.time >= min(engaged, 0.5 * result.time[-1])
    force, step = result.wrench[scored, :3], cell.clock.period
    panels = _mean_forces(result, revolution, shade)
    if result.micro_steps <= MOST_MICRO_STEPS:
        fine = micro_step_forces(cell.cut(), result.tool, cell.clock.micro_steps)
        panels = (*panels, _last_revolution(fine, micro_step, revolution, float(result.time[-1])))
        force, step = fine[np.repeat(scored[1:], cell.clock.micro_steps)], micro_step
    caption = (
        f"Pass '{one.name}'. Thin: means over one exchange period of {cell.clock.period * 1e3:g} ms, so the peaks "
        "within a tooth's engagement are lower there than in the last revolution, which is shown at micro-steps of the "
        "spindle. Bold: mean over a revolution. Shaded: fully engaged."
    )
    return [
        Chart("forces", "Force on the tool", "Fig. 12", caption, panels, columns=2),
        _displacement(one, shade),
        _spectra(cell, one, force, step, result.deflection[scored, 1]),
    ]


def _mean_forces(result, revolution: float, shade) -> tuple[Panel, ...]:
    window = max(1, round(revolution / (result.time[1] - result.time[0])))
    curves = []
    for k, name in enumerate("xyz"):
        if k == 2 and not result.wrench[:, 2].any():
            continue
        curves.append(curve(f"F_{name} of a period", result.time, result.wrench[:, k], k + 1, "thin", legend=False))
        mean = moving_mean(result.wrench[:, k], window)
        curves.append(curve(f"F_{name}", result.time, mean, k + 1))
    return (Panel("time [s]", "force [N]", tuple(curves), title="the whole pass", shade=shade),)


def _last_revolution(force: np.ndarray, step: float, revolution: float, end: float) -> Panel:
    count = min(len(force), round(revolution / step))
    time = (end - step * np.arange(count)[::-1]) * 1e3
    shown = [k for k in range(3) if k < 2 or force[:, 2].any()]
    curves = tuple(Curve(f"F_{'xyz'[k]}", time, force[-count:, k], k + 1, legend=False) for k in shown)
    return Panel("time [ms]", "force [N]", curves, title="the last revolution")


def _displacement(one: ScoredPass, shade) -> Chart:
    names = ("x, along the feed", "y, across the feed", "z, along the spindle")
    looks = ("", "", "dash")
    time, moved = one.result.time, one.result.deflection
    curves = tuple(curve(names[k], time, moved[:, k] * 1e6, k + 1, looks[k]) for k in range(3))
    caption = (
        f"Pass '{one.name}'. The arm gives way, swings at its low frequency and settles at its static deflection. "
        "What happens before the shaded part is cut away by the teeth that follow."
    )
    panel = Panel("time [s]", "displacement of the tool [µm]", curves, shade=shade, levels=((0.0, ""),))
    return Chart("displacement", "Displacement of the tool", "Fig. 13", caption, (panel,))


def _spectra(cell: Cell, one: ScoredPass, force: np.ndarray, step: float, lateral: np.ndarray) -> Chart:
    """force (n, 3) [N] every ``step`` [s]; lateral (m,) [m] every exchange period."""
    passing, low = cell.tool.teeth * cell.tool.spindle_speed / (2 * np.pi), cell.low_frequency
    high = 4.0 * passing
    of_force = []
    for k, name in enumerate("xy"):
        frequency, amplitude = amplitude_spectrum(force[:, k], step)
        of_force.append(Curve(f"F_{name}", *thinned_spectrum(frequency, amplitude, high), k + 1))
    frequency, amplitude = amplitude_spectrum(lateral * 1e6, cell.clock.period)
    of_arm = Curve("y, across the feed", *thinned_spectrum(frequency, amplitude, high), 2)
    marks = ((passing, f"teeth {passing:.4g} Hz"), (low, f"arm {low:.4g} Hz"))
    panels = tuple(
        Panel("frequency [Hz]", label, curves, log=True, x_range=(1.0, high), y_range=_decades(curves, span),
              uprights=marks)
        for label, curves, span in (("force [N]", tuple(of_force), 1e5), ("displacement y [µm]", (of_arm,), 1e6))
    )  # fmt: skip
    caption = (
        f"Pass '{one.name}', fully engaged part. Force lives at the tooth passing frequency, {passing:.1f} Hz, and its "
        f"multiples; the arm follows only near its lowest lateral mode, {low:.2f} Hz."
    )
    of_paper = "Figs. 12 and 13 in the frequency domain"
    return Chart("spectra", "Frequencies in force and displacement", of_paper, caption, panels)


def _decades(curves: tuple[Curve, ...], span: float) -> tuple[float, float]:
    top = max((float(c.y.max(initial=0.0)) for c in curves), default=0.0) or 1.0
    return top / span, 8 * top
