"""Softer ramps of the path: a lever beside the correction, because an arm swings after each stop and corner.

The swing of the slowest mode follows from the acceleration of the path. A ramp that lasts longer than a period of this
mode leaves little. Scaling the acceleration by s and the jerk by s^2 makes all ramps 1/s times as long; the feed stays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.column import column
from kr270_milling.base.errors import InputError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import compensated, compensator, simulate
from kr270_milling.cell.models import path_of
from kr270_milling.decide.decision import ENOUGH
from kr270_milling.decide.programs.written import written_trajectory
from kr270_milling.decide.verdict import drawn_errors
from kr270_milling.path.timing import Timing

__all__ = ["Lever", "levers", "softened"]

RATIOS = (1.0, 1.1, 1.25, 1.5)  #: cycle times that are tried, of the programmed one; ramps take no more than the last
SOFTEST = 0.02  #: share of the programmed acceleration


@dataclass(frozen=True)
class Lever:
    """A path and its correction, run by the simulated robots of a verdict."""

    name: str = column("lever", short="lever")
    within: int = column("within_tolerance", short="within")
    robots: int = column("robots", short="of")
    median: float = column("median_um", 1e6, unit="um", short="median")
    high: float = column("q95_um", 1e6, unit="um", short="95 %")
    duration: float = column("duration_s", unit="s", short="time")
    timing: Timing = column("")

    @property
    def enough(self) -> bool:
        return self.within >= ENOUGH * self.robots

    @property
    def keys(self) -> tuple[str, ...]:
        """The values of the cell file, as behind ``--set``."""
        timing = self.timing
        return (
            f"timing.acceleration_m_per_s2={timing.acceleration:.3g}",
            f"timing.jerk_m_per_s3={timing.jerk:.3g}",
        )


def softened(cell: Cell, ratio: float) -> Cell:
    """Return the cell with softer ramps, so that its path takes at most ``ratio`` times as long."""
    limit, low, high = ratio * path_of(cell).target.duration_ns, SOFTEST, 1.0
    for _ in range(12):  # to 0.1 % of the acceleration
        share = 0.5 * (low + high)
        slow = path_of(_with_share(cell, share)).target.duration_ns > limit
        low, high = (share, high) if slow else (low, share)
    return _with_share(cell, high) if ratio > 1.0 else cell


def _with_share(cell: Cell, share: float) -> Cell:
    rounded = (float(f"{value:.3g}") for value in (share * cell.timing.acceleration, share**2 * cell.timing.jerk))
    acceleration, jerk = rounded
    return cell.replace(timing=cell.timing.replace(acceleration=acceleration, jerk=jerk))


def levers(
    cell: Cell, robots: int, seed: int, motion: str, progress: Callable[[int, int], None] | None = None
) -> list[tuple[Lever, Cell]]:
    """Try softer and softer ramps, without and with the correction, until enough robots meet the tolerance.

    Returns two rows for each time of the path, each with its cell; the last row is the cheapest that is enough, or
    else the softest one. Raises InputError for a straight cut and for a cell without a tolerance.
    """
    fed = path_of(cell).fed
    if fed is None or fed.timed_by_source or not any(cell.tolerances.of()):
        raise InputError("--reach", "needs part.tolerance_um, and a program without times in path.file")
    rows: list[tuple[Lever, Cell]] = []
    done = 0

    def count(robot: int) -> None:
        if progress:
            progress(done + robot, len(RATIOS) * robots)

    for ratio in RATIOS:
        count(0)
        softer = softened(cell, ratio)
        path, original = path_of(softer), simulate(softer)
        by = compensator(softer, path.target)
        planned = compensated(softer, original, by.method, None, by)
        program = written_trajectory(softer, planned.reference, motion)
        errors = drawn_errors(softer, (path.target, program), robots, seed, count)
        done += robots
        seconds = path.target.duration_ns * 1e-9
        for name, (error, share) in zip(("as programmed", by.method), np.moveaxis(errors, 0, -1), strict=True):
            shown = name if ratio == 1.0 else f"{name}, softer ramps"
            median, high = np.quantile(np.nan_to_num(error, nan=1.0), (0.5, 0.95)).tolist()
            within = int(np.sum(share <= 1.0))
            rows.append((Lever(shown, within, robots, median, high, seconds, softer.timing), softer))
        if rows[-1][0].enough:
            break
    return rows
