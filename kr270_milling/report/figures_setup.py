"""Figures of what was set up: force law (Fig. 3), posture (Fig. 10), tool and workpiece at the start (Fig. 11)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, Rectangle

from kr270_milling.base.frames import Pose
from kr270_milling.cutting import Cutting, Stock, Tool
from kr270_milling.report.style import COLOURS, GREY, SHADE, new_figure, styled
from kr270_milling.robot import LinkFrames

__all__ = ["arm_posture", "force_law", "start_position"]

MATERIAL = "#EFE3D3"
AXIS_COLOURS = {"x": "#D55E00", "y": "#009E73", "z": "#0072B2"}


@styled
def force_law(cutting: Cutting, depth_of_cut: float, feed_per_tooth: float) -> Figure:
    """F_c(h) of one tooth at depth_of_cut [m], Fig. 3; feed_per_tooth [m] is marked."""
    figure, ((axes,),) = new_figure(3.0)
    h = np.linspace(0.0, 1.3 * feed_per_tooth, 400)
    h[0] = 1e-9  # the edge forces of the linear-edge law begin with contact
    tangential, radial = cutting.force_per_depth(h)
    axes.plot(h * 1e6, tangential * depth_of_cut, color=COLOURS[0], label="tangential $F_t$", linewidth=1.5)
    axes.plot(h * 1e6, radial * depth_of_cut, color=COLOURS[2], label="radial $F_r$")
    top = 1.08 * float(np.max(tangential)) * depth_of_cut
    if cutting.law == "fractional":
        law = cutting.fractional
        per_metre = law.stiffness * depth_of_cut * 1e3  # k_0 is per millimetre of depth
        far = law.ratio * h + (1 - law.ratio) * law.specific_chip_thickness
        axes.plot(h * 1e6, per_metre * h, color=COLOURS[1], linestyle="--", label="slope $k_0$ at $h = 0$")
        axes.plot(
            h * 1e6, per_metre * far, color=COLOURS[3], linestyle="--", label="asymptote, slope $k_\\infty = r k_0$"
        )
        _upright(axes, law.specific_chip_thickness * 1e6, "$h_s$", top)
    _upright(axes, feed_per_tooth * 1e6, "feed per tooth", top)
    axes.set(
        xlabel="uncut chip thickness h [µm]", ylabel="force of one tooth [N]", ylim=(0, top), xlim=(0, h[-1] * 1e6)
    )
    axes.legend(loc="center right")
    return figure


def _upright(axes: Axes, x: float, text: str, top: float) -> None:
    axes.axvline(x, color=GREY, linestyle=":", linewidth=0.8)
    axes.annotate(text, (x, top), (3, -2), textcoords="offset points", va="top", color=GREY, fontsize=8)


@styled
def arm_posture(frames: LinkFrames, workpiece: Pose, stock: Stock) -> Figure:
    """The arm at one posture from the side (the vertical plane through the tool) and from above, Fig. 10."""
    figure, ((side, top),) = new_figure(3.7, 1, 2)
    tool = frames.tool.position
    out = np.array([tool[0], tool[1], 0.0])
    out = out / np.linalg.norm(out) if np.linalg.norm(out) > 1e-9 else np.array([1.0, 0.0, 0.0])
    up = np.array([0.0, 0.0, 1.0])
    views = (
        (side, up, "from the side", "height above the base [m]"),
        (top, np.cross(up, out), "from above", "to the left of the arm [m]"),
    )
    for axes, vertical, title, y_label in views:
        view = np.stack([out, vertical])
        _draw_arm(axes, frames, view)
        _draw_workpiece(axes, workpiece, stock, view)
        axes.set(title=title, xlabel="distance from axis 1 [m]", ylabel=y_label, aspect="equal")
        axes.margins(0.22, 0.14)
    top.set_ylim(-0.6, 0.6)
    side.axhline(0.0, color=GREY, linewidth=1.2)
    return figure


def _draw_arm(axes: Axes, frames: LinkFrames, view: np.ndarray) -> None:
    """view: (2, 3), base_link coordinates to those of the sheet."""
    nodes = frames.nodes @ view.T
    axes.plot(*nodes.T, color="#B8BDC4", linewidth=7, solid_capstyle="round", zorder=2)
    axes.plot(*nodes.T, color=COLOURS[0], linewidth=0.8, marker="o", markersize=4, markerfacecolor="white", zorder=3)
    seen_from_side = abs(view[1, 2]) > 0.5
    for text, index in (("A1", 0), ("A2", 1), ("A3", 2), ("A4 to A6", 4)) if seen_from_side else (("A1", 0),):
        axes.annotate(text, nodes[index], (8, 5), textcoords="offset points", fontsize=8, color=GREY, zorder=5)
    mounted = np.stack([frames.flange.position, frames.tool.position]) @ view.T
    axes.plot(*mounted.T, color=COLOURS[1], linewidth=2.5, zorder=4)
    axes.plot(*mounted[1], color=COLOURS[1], marker="D", markersize=4, zorder=4, linestyle="none")
    axes.annotate("tool tip", mounted[1], (8, -4), textcoords="offset points", fontsize=8, zorder=5)


def _draw_workpiece(axes: Axes, workpiece: Pose, stock: Stock, view: np.ndarray) -> None:
    low, high = stock.min, stock.max
    corners = np.array([[(low, high)[(c >> k) & 1][k] for k in range(3)] for c in range(8)])
    sheet = workpiece.apply(corners) @ view.T
    edges = [(a, a | 1 << k) for a in range(8) for k in range(3) if not a >> k & 1]
    for a, b in edges:
        axes.plot(*sheet[[a, b]].T, color="#A0703C", linewidth=0.8, zorder=2)
    origin = workpiece.position @ view.T
    for name, direction in zip("xyz", workpiece.rotation.T, strict=True):
        end = (workpiece.position + 0.35 * direction) @ view.T
        if np.linalg.norm(end - origin) > 0.02:
            axes.annotate("", end, origin, arrowprops=dict(arrowstyle="->", color=AXIS_COLOURS[name], lw=1.2), zorder=6)
            text = origin + 1.25 * (end - origin)
            axes.plot(*text, alpha=0)  # for the limits of the axes
            axes.annotate(name, text, color=AXIS_COLOURS[name], ha="center", va="center", zorder=6)


@styled
def start_position(tool: Tool, stock: Stock, start: np.ndarray, feed: np.ndarray) -> Figure:
    """Tool and workpiece border at t = 0 from +z of the workpiece, Fig. 11; start [m] and feed (2+,) x and y first."""
    figure, ((axes,),) = new_figure(3.6)
    centre, r = np.asarray(start)[:2] * 1e3, tool.radius * 1e3
    way = np.asarray(feed)[:2] / max(np.linalg.norm(np.asarray(feed)[:2]), 1e-300)
    low, high = stock.min * 1e3, stock.max * 1e3
    axes.add_patch(Rectangle(low[:2], *(high - low)[:2], facecolor=MATERIAL, edgecolor="#A0703C", linewidth=0.8))
    axes.add_patch(Circle(centre, r, facecolor=SHADE, edgecolor=COLOURS[2], linewidth=1.0, alpha=0.9))
    for number, (angle, radius) in enumerate(zip(tool.angles, tool.radii * 1e3, strict=True)):
        tip = centre + radius * np.array([np.cos(angle), tool.sense * np.sin(angle)])
        axes.plot(*np.stack([centre, tip]).T, color=COLOURS[0], linewidth=1.6, solid_capstyle="butt")
        axes.annotate(str(number + 1), tip, centre + 1.14 * (tip - centre), ha="center", va="center", fontsize=8)
    left = r * np.array([-way[1], way[0]])
    for side in (left, -left):
        edge = np.stack([centre + side, centre + side + 4.5 * r * way])
        axes.plot(*edge.T, color=GREY, linestyle="--", linewidth=0.8)
    axes.annotate("feed", centre + 2.9 * r * way, centre + 2.0 * r * way, color=COLOURS[1], va="center", ha="center",
                  arrowprops=dict(arrowstyle="->", color=COLOURS[1], lw=1.5),
                  bbox=dict(facecolor="white", edgecolor="none", pad=1.5))  # fmt: skip
    at = [centre + 0.55 * r * np.array([np.cos(a), np.sin(a)]) for a in (2.6, 2.6 + 1.1 * tool.sense)]
    bend = 0.3 * tool.sense
    axes.add_patch(FancyArrowPatch(*at, connectionstyle=f"arc3,rad={bend}", arrowstyle="->", mutation_scale=10,
                                   color=COLOURS[2], linewidth=1.5))  # fmt: skip
    span = np.stack([centre - 1.4 * r, centre + 1.4 * r, centre + 3.2 * r * way])
    axes.set_xlim(span[:, 0].min(), span[:, 0].max())
    axes.set_ylim(span[:, 1].min(), span[:, 1].max())
    axes.set(xlabel="x of the workpiece [mm]", ylabel="y of the workpiece [mm]", aspect="equal")
    return figure
