"""The page of stability lobes: limit depth and chatter over spindle speed, the cut and the modes of the cell."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kr270_milling.base.column import TextTable, fixed
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import path_of
from kr270_milling.decide.arcs import arcs_along
from kr270_milling.decide.stability import modes_of
from kr270_milling.show.report.decision_block import cut_text
from kr270_milling.show.report.study_page import COLOURS, points, write_page
from kr270_milling.studies.maps.lobes import engagement_text

__all__ = ["write_lobes"]

RPM = 30.0 / math.pi


def write_lobes(
    folder, cell: Cell, name: str, rows: Sequence[dict], summary: str, *, arm: bool, self_contained: bool = False
) -> Path:
    """Write ``lobes.html``; returns its path.

    name: of the cell file; rows: of ``Lobe`` as in JSON; summary: a sentence; arm: whether its modes are part of the
    limit; self_contained: as of ``write_page``.
    """
    speeds, limit, chatter = (
        [row[key] for row in rows] for key in ("spindle_speed_rpm", "depth_limit_mm", "chatter_hz")
    )
    ends = min(*speeds, cell.tool.spindle_speed * RPM), max(*speeds, cell.tool.spindle_speed * RPM)
    speed, depth = cell.tool.spindle_speed * RPM, 1e3 * _deepest(cell)
    own = f"the cell's cut: {depth:.3g} mm at {speed:.0f} rpm"
    lines = {"limit depth": (speeds, limit), own: ([speed], [depth])}
    style = {own: (COLOURS[1], "diamond")}
    across = "spindle speed [rpm]"
    figures = [points("Below the line the cut is stable", across, "depth of cut [mm]", lines, ("limit depth",), style)]
    figures[0].update_yaxes(rangemode="tozero")
    modes = _modes(cell, arm)
    if any(map(math.isfinite, chatter)):  # where nothing chatters there is no frequency to show
        ends_of = {owner: np.repeat([hertz for hertz, _ in of], 3) for owner, of in modes.items()}
        series = {f"modes of the {owner}": (np.resize([*ends, np.nan], of.size), of) for owner, of in ends_of.items()}
        names = "chatter", "modes of the tool", "modes of the arm"
        style = {name: (COLOURS[k], "circle") for k, name in enumerate(names)}
        both = series | {"chatter": (speeds, chatter)}
        figures.append(points("Chatter at the limit", across, "frequency [Hz]", both, tuple(series), style))
        shown = [*filter(math.isfinite, chatter), *(mode[0] for rows in modes.values() for mode in rows)]
        if max(shown) > 20.0 * min(shown):  # ratio of two frequencies beyond which their axis is logarithmic
            figures[1].update_yaxes(type="log", dtick="D2")
    for figure in figures:  # one above the other
        figure.update_xaxes(range=ends)
    listed = [(owner, fixed(hertz), fixed(ratio, 4)) for owner, of in modes.items() for hertz, ratio in of]
    table = TextTable("Modes", ("of", "frequency [Hz]", "damping ratio"), listed)
    sentences = [
        f"{name}: {cell.arm.name} mills {cut_text(path_of(cell))}",
        f"engagement of the lobes: {engagement_text(cell.path)}",
        summary,
    ]
    title = f"Stability lobes of {name}"
    return write_page(Path(folder) / "lobes.html", title, sentences, [table], figures, self_contained=self_contained)


def _modes(cell: Cell, arm: bool) -> dict[str, list[tuple[float, float]]]:
    """Frequency [Hz] and damping ratio of each mode of the limit, by "arm" and "tool"; without modes no entry."""
    modes, tools = modes_of(cell, arm), cell.tool.modes.frequency.size
    rows = list(zip((modes.frequency / (2.0 * math.pi)).tolist(), modes.damping_ratio.tolist(), strict=True))
    return {owner: of for owner, of in (("tool", rows[:tools]), ("arm", rows[tools:])) if of}


def _deepest(cell: Cell) -> float:
    """Return the depth of cut [m], for a program the largest."""
    if path_of(cell).straight:
        return cell.path.depth_of_cut
    return float(arcs_along(path_of(cell), cell.earlier).depth.max(initial=0.0))
