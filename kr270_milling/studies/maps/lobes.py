"""Stability lobes of a cell: limit depth of cut and chatter frequency over spindle speed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import path_of
from kr270_milling.decide.stability import modes_of
from kr270_milling.physics.motion.stability import Lobe, Modes, has_uniform_pitch, stability_limit
from kr270_milling.studies.identification.cuts import engagement_angles

__all__ = ["engagement_text", "lobes"]


def lobes(
    cell: Cell, speeds: Sequence[float], arm: bool = True, progress: Callable[[int, int], None] | None = None
) -> list[Lobe]:
    """Limit depth at each spindle speed [rad/s], for the immersion of ``path`` and the feed per tooth of the cell."""
    tool, modes = cell.tool, modes_of(cell, arm)
    if not has_uniform_pitch(tool):
        raise ParameterError("tool.pitch_deg", np.degrees(tool.pitch).tolist(), "uniform: the limit supposes one delay")
    results = []
    with ThreadPoolExecutor(max_workers=2) as pool:
        for lobe in pool.map(lambda speed: _lobe_at(cell, modes, speed), speeds):
            results.append(lobe)
            if progress is not None:
                progress(len(results), len(speeds))
    return results


def engagement_text(cell: Cell) -> str:
    """The cut of ``lobes`` in words."""
    path = cell.path
    if path.radial_immersion >= 1.0:
        return "a slot"
    return f"{100.0 * path.radial_immersion:.3g} % of the diameter, {path.mode}"


def _lobe_at(cell: Cell, modes: Modes, speed: float) -> Lobe:
    """The limit depth at one spindle speed [rad/s]; modes: in axes with x along the feed."""
    tool = cell.tool
    mode = "slot" if cell.path.radial_immersion >= 1.0 else cell.path.mode
    entry, leave = (float(angle) for angle in engagement_angles(mode, cell.path.radial_immersion, 1.0))
    feed_per_tooth = 2.0 * math.pi * path_of(cell).feed_rate / (tool.spindle_speed * tool.teeth)
    return Lobe(speed, *stability_limit(modes, tool, cell.cutting, feed_per_tooth, entry, leave, speed))
