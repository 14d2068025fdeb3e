"""Stability lobes of a cell: limit depth of cut and chatter frequency over spindle speed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from kr270_milling.cell.paths import CellPath
from kr270_milling.cell.sections import PathSection
from kr270_milling.decide.stability import refuse_without_limit
from kr270_milling.physics.cutting import Cutting
from kr270_milling.physics.motion.stability import Lobe, Modes, stability_limit
from kr270_milling.studies.identification.forces import engagement_angles


def lobes(
    path: CellPath,
    cutting: Cutting,
    modes: Modes,
    speeds: Sequence[float],
    progress: Callable[[int, int], None] | None = None,
) -> list[Lobe]:
    """Limit depth at each spindle speed [rad/s], for the immersion and the feed per tooth of a path.

    modes: in axes with x along the feed. Raises ParameterError where no limit holds.
    """
    refuse_without_limit(path)
    results = []
    for speed in speeds:
        results.append(_lobe_at(path, cutting, modes, speed))
        if progress is not None:
            progress(len(results), len(speeds))
    return results


def engagement_text(path: PathSection) -> str:
    """The cut of ``lobes`` in words."""
    if path.radial_immersion >= 1.0:
        return "a slot"
    return f"{100.0 * path.radial_immersion:.3g} % of the diameter, {path.mode}"


def _lobe_at(path: CellPath, cutting: Cutting, modes: Modes, speed: float) -> Lobe:
    """The limit depth at one spindle speed [rad/s]."""
    tool, immersion = path.tool, path.path.radial_immersion
    mode = "slot" if immersion >= 1.0 else path.path.mode
    entry, leave = (float(angle) for angle in engagement_angles(mode, immersion, 1.0))
    feed_per_tooth = 2.0 * math.pi * path.feed_rate / (tool.spindle_speed * tool.teeth)
    return Lobe(speed, *stability_limit(modes, tool, cutting, feed_per_tooth, entry, leave, speed))
