"""Figures of a part milled along a tool path: the path, deviations along it, errors of what remains, the load."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from kr270_milling.cutting import Stock
from kr270_milling.decision.part import PartAssessment
from kr270_milling.report.style import COLOURS, GREY, SHADE, colour, line, new_figure, plain, styled
from kr270_milling.trajectory.toolpath import Toolpath

__all__ = ["along_path", "deviation_maps", "loads", "surface_maps", "tool_path"]

MAP = "RdBu_r"  # diverging: white is no error
EMPTY = "#DADADA"
MATERIAL, EDGE = "#EFE3D3", "#A0703C"
POINTS = 3000  # of a path in a map
DOTS = 200  # per inch of what is drawn as an image


def _from_above(axes: Axes, stock: Stock, margin: float, face: str = MATERIAL) -> None:
    low, size = stock.min[:2] * 1e3, (stock.max - stock.min)[:2] * 1e3
    axes.add_patch(Rectangle(low, *size, facecolor=face, edgecolor=EDGE, linewidth=0.8, zorder=0))
    axes.set(xlabel="x [mm]", aspect="equal")
    axes.set_xlim(low[0] - margin, low[0] + size[0] + margin)
    axes.set_ylim(low[1] - margin, low[1] + size[1] + margin)
    axes.grid(False)


def _scale(largest: Sequence[float]) -> float:
    """[um] for both ends of the colours; something where nothing was cut or nothing deviates."""
    known = [value for value in largest if value > 1e-9]
    return max(known, default=1e-6) * 1e6


@styled
def tool_path(path: Toolpath, stock: Stock) -> Figure:
    """The tool path and the stock from above, coloured by feature, and its height along its length."""
    figure, ((above, height),) = new_figure(3.9, 1, 2, width_ratios=[1.0, 0.8])
    ends = path.position * 1e3
    reach = float(np.abs(ends[:, :2]).max() - np.abs(stock.max[:2]).max() * 1e3)
    _from_above(above, stock, max(5.0, reach + 5.0))
    length = np.cumsum(path.block_length) * 1e3
    pieces, ways = np.stack([ends[:-1], ends[1:]], axis=1), np.stack([length[:-1], length[1:]], axis=1)
    rapid, feature = path.rapid[1:], path.feature[1:]
    for k, name in [(-1, "rapid"), *enumerate(path.features)]:
        mine = rapid if k < 0 else ~rapid & (feature == k)
        if not mine.any():
            continue
        look = dict(colors=GREY, linewidths=0.7, linestyles="--") if k < 0 else dict(
            colors=COLOURS[k % len(COLOURS)], linewidths=1.4)  # fmt: skip
        above.add_collection(LineCollection(pieces[mine][:, :, :2], label=plain(name or "unnamed"), **look))
        height.add_collection(LineCollection(np.stack([ways[mine], pieces[mine][:, :, 2]], axis=2), **look))
    above.plot(*ends[0, :2], marker="o", color=COLOURS[0], markersize=4, linestyle="none", label="start")
    height.axhline(stock.max[2] * 1e3, color=EDGE, linewidth=0.8)
    height.annotate("top of the stock", (0.99, stock.max[2] * 1e3), (0, 3), xycoords=("axes fraction", "data"),
                    textcoords="offset points", ha="right", color=EDGE, fontsize=8)  # fmt: skip
    height.autoscale_view()
    above.set_ylabel("y [mm]")
    height.set(xlabel="way along the path [mm]", ylabel="z of the tool tip [mm]")
    figure.legend(*above.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


@styled
def deviation_maps(parts: Sequence[PartAssessment], actual: Sequence[np.ndarray], stock: Stock) -> Figure:
    """Paths from above coloured by their deviation to the side while cutting, one map for each pass.

    actual: tool centres of each pass [m], (n + 1, 3).
    """
    figure, (maps,) = new_figure(3.9, 1, len(parts), sharey=True)
    figure.set_dpi(DOTS)
    most = _scale([part.whole.max_normal for part in parts])
    for axes, part, centre in zip(maps, parts, actual, strict=True):
        _from_above(axes, stock, 12.0)
        chosen = np.flatnonzero(part.cutting)
        chosen = chosen[:: max(1, chosen.size // POINTS)]
        shown = axes.scatter(*centre[chosen, :2].T * 1e3, c=part.deviation[chosen, 1] * 1e6, s=5, cmap=MAP,
                             vmin=-most, vmax=most, linewidths=0, rasterized=True)  # fmt: skip
        axes.set_title(f"{plain(part.name)}: at most {part.whole.max_normal * 1e6:.1f} µm")
    maps[0].set_ylabel("y [mm]")
    figure.colorbar(shown, ax=list(maps), label="deviation to the left of the path [µm]", shrink=0.85)
    return figure


@styled
def surface_maps(parts: Sequence[PartAssessment], stock: Stock) -> Figure:
    """Errors of floors (areas) and walls (lines) that remain, from above, one map for each pass."""
    figure, (maps,) = new_figure(3.9, 1, len(parts), sharey=True)
    figure.set_dpi(DOTS)
    most = _scale([value for part in parts for value in (part.whole.max_wall, part.whole.max_floor)])
    for axes, part in zip(maps, parts, strict=True):
        _from_above(axes, stock, 4.0, EMPTY)
        floors, walls = part.surface.floors, part.surface.walls
        extent = [side[axis] * 1e3 for axis in (0, 1) for side in (stock.min, stock.max)]
        axes.imshow(floors.error.T * 1e6, extent=extent, origin="lower", cmap=MAP, vmin=-most, vmax=most,
                    interpolation="nearest", zorder=1)  # fmt: skip
        place = walls.position[:, :2] * 1e3
        joined = np.flatnonzero(np.hypot(*np.diff(place, axis=0).T) < 1.0)  # [mm]: neighbours on one wall
        pieces = np.stack([place[joined], place[joined + 1]], axis=1)
        axes.add_collection(LineCollection(pieces, colors=GREY, linewidths=3.0, rasterized=True, zorder=2))
        shown = LineCollection(pieces, cmap=MAP, linewidths=2.0, capstyle="round", rasterized=True, zorder=3)
        shown.set(array=walls.error[joined] * 1e6, clim=(-most, most))
        axes.add_collection(shown)
        whole = part.whole
        axes.set_title(f"{plain(part.name)}: walls {whole.max_wall * 1e6:.1f} µm, floor {whole.max_floor * 1e6:.1f} µm")
    maps[0].set_ylabel("y [mm]")
    figure.colorbar(shown, ax=list(maps), label="material left (+), cut too deep (−) [µm]", shrink=0.85)
    return figure


def _features(grid: Sequence[Axes], part: PartAssessment) -> None:
    """Shade every other feature of the path and write their names above."""
    path = part.path
    edges = np.flatnonzero(np.diff(path.feature)) + 1
    edges = np.concatenate([[0], edges, [path.feature.size]])
    cuts = [(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True) if part.cutting[a:b].any()]
    for number, (a, b) in enumerate(cuts):
        start, end = path.distance[[a, b - 1]] * 1e3
        for axes in grid:
            if number % 2:
                axes.axvspan(start, end, color=SHADE, linewidth=0, zorder=0)
        name = plain(path.features[path.feature[a]])
        grid[0].annotate(name, (0.5 * (start + end), 1.0), (0, 3), xycoords=("data", "axes fraction"), color=GREY,
                         textcoords="offset points", ha="center", fontsize=7.5)  # fmt: skip


@styled
def along_path(parts: Sequence[PartAssessment]) -> Figure:
    """Deviation to the side and in height while cutting, over the way along the path, all passes."""
    figure, grid = new_figure(4.6, 2, 1, sharex=True)
    for number, part in enumerate(parts):
        way = part.path.distance * 1e3
        for axes, k in zip(grid[:, 0], (1, 2), strict=True):
            shown = np.where(part.cutting, part.deviation[:, k] * 1e6, np.nan)
            line(axes, way, shown, colour(number), plain(part.name), linewidth=0.8)
    for axes, name in zip(grid[:, 0], ("to the left", "upwards"), strict=True):
        axes.axhline(0.0, color=GREY, linewidth=0.6)
        axes.set_ylabel(f"deviation {name} [µm]")
    _features(grid[:, 0], parts[0])
    grid[1, 0].set(xlabel="way along the path [mm]", xlim=(0.0, way[-1]))
    grid[1, 0].legend(loc="best", ncols=4)
    return figure


@styled
def loads(part: PartAssessment) -> Figure:
    """Force, torque and power of one pass over the way along the path."""
    figure, grid = new_figure(4.8, 3, 1, sharex=True)
    way = part.path.distance * 1e3
    rows = ((part.force, "force [N]"), (part.torque, "torque [N m]"), (part.power, "power [W]"))
    for axes, (values, name), paint in zip(grid[:, 0], rows, COLOURS[1:4], strict=True):
        line(axes, way, values, paint, linewidth=0.6)
        axes.set(ylabel=name, ylim=(0.0, None))
    _features(grid[:, 0], part)
    grid[2, 0].set(xlabel="way along the path [mm]", xlim=(0.0, way[-1]))
    figure.align_ylabels(grid[:, 0])
    return figure
