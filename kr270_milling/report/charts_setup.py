"""Charts of what was set up: the force law (Fig. 3), tool and workpiece at the start (Fig. 11)."""

from __future__ import annotations

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cutting import Cutting, Stock, Tool
from kr270_milling.report.charts import Chart, Curve, Panel

__all__ = ["force_law", "setup_charts", "start_position"]


def setup_charts(cell: Cell) -> list[Chart]:
    """The charts that hold for every pass of a cell; the start position only for a straight cut."""
    per_tooth = cell.feed_rate * 2 * np.pi / cell.tool.spindle_speed / cell.tool.teeth
    if cell.path.file:
        return [force_law(cell.cutting, 1e-3, per_tooth)]
    target = cell.target()
    start = start_position(cell.tool, cell.stock, target.position[0], target.sample_velocity(0))
    return [force_law(cell.cutting, cell.path.depth_of_cut, per_tooth), start]


def force_law(cutting: Cutting, depth_of_cut: float, feed_per_tooth: float) -> Chart:
    """F_c(h) of one tooth at depth_of_cut [m], Fig. 3; feed_per_tooth [m] is marked."""
    h = np.linspace(0.0, 1.3 * feed_per_tooth, 200)
    h[0] = 1e-9  # the edge forces of the linear-edge law begin with contact
    tangential, radial = cutting.force_per_depth(h)
    micrometres = h * 1e6
    curves = [
        Curve("tangential F_t", micrometres, tangential * depth_of_cut, 0),
        Curve("radial F_r", micrometres, radial * depth_of_cut, 2),
    ]
    uprights = [(feed_per_tooth * 1e6, "feed per tooth")]
    if cutting.law == "fractional":
        law = cutting.fractional
        per_metre = law.stiffness * depth_of_cut * 1e3  # k_0 is per millimetre of depth
        far = law.ratio * h + (1 - law.ratio) * law.specific_chip_thickness
        curves.append(Curve("slope k_0 at h = 0", micrometres, per_metre * h, 1, "dash"))
        curves.append(Curve("asymptote, slope k_∞ = r k_0", micrometres, per_metre * far, 3, "dash"))
        uprights.append((law.specific_chip_thickness * 1e6, "h_s"))
    top = 1.08 * float(np.max(tangential)) * depth_of_cut
    caption = (
        f"Force against uncut chip thickness h at a depth of cut of {depth_of_cut * 1e3:.4g} mm. A full chip is as "
        f"thick as the feed per tooth, {feed_per_tooth * 1e6:.0f} µm."
    )
    if cutting.law == "fractional":
        caption += " Thin chips take more force for their size."
    panel = Panel(
        "uncut chip thickness h [µm]", "force of one tooth [N]", tuple(curves), x_range=(0.0, float(micrometres[-1])),
        y_range=(0.0, top), uprights=tuple(uprights),
    )  # fmt: skip
    return Chart("force_law", "Cutting force of one tooth", "Fig. 3", caption, (panel,))


def start_position(tool: Tool, stock: Stock, start: np.ndarray, feed: np.ndarray) -> Chart:
    """Tool and workpiece border at t = 0 from +z of the workpiece, Fig. 11; start [m] and feed (2+,) x and y first."""
    centre, r = np.asarray(start)[:2] * 1e3, tool.radius * 1e3
    ahead = np.asarray(feed)[:2] / max(np.linalg.norm(np.asarray(feed)[:2]), 1e-300)
    low, high = stock.min * 1e3, stock.max * 1e3
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]], [low[0], low[1]]])
    angle = np.linspace(0.0, 2 * np.pi, 91)
    circle = centre + r * np.column_stack([np.cos(angle), np.sin(angle)])
    curves = [
        _through("stock", corners, 7, "area"),
        _through("tool", circle, 2),
    ]
    for number, (phi, radius) in enumerate(zip(tool.angles, tool.radii * 1e3, strict=True), 1):
        way = np.array([np.cos(phi), tool.sense * np.sin(phi)])
        curves.append(_through(f"tooth {number}", np.stack([centre, centre + radius * way]), 0, legend=False))
        beside = centre + 1.2 * r * np.array([np.cos(phi + 0.15), tool.sense * np.sin(phi + 0.15)])
        curves.append(_through(f"number {number}", beside[None], 0, text=str(number), legend=False))
    left = r * np.array([-ahead[1], ahead[0]])
    for side, shown in ((left, True), (-left, False)):
        edge = np.stack([centre + side, centre + side + 4.5 * r * ahead])
        curves.append(_through("walls that the cut should leave", edge, 6, "dash", legend=shown))
    arrow = np.stack([centre, centre + 2.4 * r * ahead])
    curves.append(_through("feed", arrow, 1, text="feed ▸"))
    span = np.stack([centre - 1.5 * r, centre + 1.5 * r, centre + 3.2 * r * ahead])
    panel = Panel(
        "x of the workpiece [mm]", "y of the workpiece [mm]", tuple(curves), equal=True,
        x_range=(float(span[:, 0].min()), float(span[:, 0].max())),
        y_range=(float(span[:, 1].min()), float(span[:, 1].max())),
    )  # fmt: skip
    turn = "clockwise" if tool.sense < 0 else "counterclockwise"
    caption = f"Seen from above the part. Numbered: the teeth at t = 0; the tool turns {turn}."
    return Chart("start_position", "Tool and workpiece at the start", "Fig. 11", caption, (panel,))


def _through(name: str, points: np.ndarray, colour: int, look: str = "", **more) -> Curve:
    """A curve through points (n, 2)."""
    return Curve(name, points[:, 0], points[:, 1], colour, look, **more)
