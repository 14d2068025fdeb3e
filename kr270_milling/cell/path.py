"""Checks of a tool path against exchange, tool and stock: implausible effort, spindle, tilt, place and feed.

The cost of a pass is estimated before the pass starts: a wrong unit must not occupy a machine for days.
"""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.blocks import blocks
from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.base.frames import tool_axis
from kr270_milling.path.timing import TimedPath
from kr270_milling.path.toolpath import Toolpath
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import Stock, Tool
from kr270_milling.physics.motion.periods import Exchange

__all__ = [
    "BY_TEETH",
    "MOST_STEPS",
    "UPRIGHT",
    "check_duration",
    "check_effort",
    "check_feed",
    "check_moves",
    "check_path",
    "check_postures",
    "sinking",
    "tilt_of",
]

MOST_STEPS = 1e7  #: exchange periods or reference points of one pass; its series take some 250 bytes a step
UPRIGHT = math.radians(0.01)  #: the heel of a flat end of 10 mm then rises by 1 um
BY_TEETH = math.radians(1.0)  #: the sweep is that of a tool along z: beyond this its floors and chips are others
MOST_VISITS = 1e13  #: nodes under the footprint, each time that it is swept as a whole, some ns each


def check_duration(
    file: str, run: Trajectory, exchange: Exchange, tool: Tool, stock: Stock, by_teeth: bool = True
) -> None:
    """Raise InputError or ParameterError for a path of days, a mistake of the feed: cost grows with the steps."""
    steps = run.duration_ns * 1e-9 / exchange.period
    if not steps <= MOST_STEPS:
        shown = f"{run.duration_ns * 1e-9:.4g} s, {steps:.3g} exchange periods, more than {MOST_STEPS:g}"
        raise InputError(file, f"would take {shown}: cut it in pieces, or raise exchange.period_ms")
    sinks = sinking(run.time, run.position[:, 2], float(stock.max[2]))
    if by_teeth:
        check_effort(exchange, tool, stock, run.duration_ns * 1e-9, sinks)


def check_effort(exchange: Exchange, tool: Tool, stock: Stock, duration: float, sinks: tuple = (0.0, 0.0)) -> None:
    """Raise ParameterError for a pass of an implausible duration [s]; sinks: the result of ``sinking``."""
    turns = duration * tool.spindle_speed / (2.0 * math.pi)
    teeth = turns * 2.0 * math.pi / exchange.micro_step * tool.teeth * exchange.iterations
    most_tooth_steps = 1e10  # micro-steps of single teeth in one pass, some 0.1 us each
    if not teeth <= most_tooth_steps:
        shown = math.degrees(exchange.micro_step)
        allowed = f"larger: the pass would take {teeth:.3g} micro-steps of a tooth, more than {most_tooth_steps:g}"
        raise ParameterError("exchange.micro_step_deg", shown, allowed)
    seconds, depth = sinks
    times = min(seconds * tool.spindle_speed / (2.0 * math.pi), depth / max(stock.floor_tolerance, stock.level_step))
    nodes = math.pi * float(tool.radii.max()) ** 2 / stock.grid_step**2
    visits = nodes * times * tool.teeth * exchange.iterations
    if not visits <= MOST_VISITS:
        allowed = f"larger: the sinking tool would sweep {visits:.3g} nodes, more than {MOST_VISITS:g}"
        raise ParameterError("stock.grid_step_um", stock.grid_step * 1e6, allowed)


def sinking(time: np.ndarray, height: np.ndarray, top: float) -> tuple[float, float]:
    """Return how long [s] and how deep in all [m] a tool sinks below ``top``; time [s], height [m], (n,)."""
    down = -np.diff(np.minimum(height, top))
    return float(np.diff(time)[down > 0].sum()), float(down[down > 0].sum())


def check_postures(count: int, spacing: float) -> None:
    """Raise ParameterError for implausibly many postures along a path; spacing [m]: distance between two postures."""
    most_postures = 100_000  # at which the arm's modes are computed, some ms and 3 kB each
    if count > most_postures:
        allowed = f"larger: the arm would be modelled at {count} postures, more than {most_postures}"
        raise ParameterError("dynamics.posture_spacing_mm", spacing * 1e3, allowed)


def check_path(file: str, timed: TimedPath, tool: Tool, stock: Stock, by_teeth: bool = True) -> None:
    """Raise InputError, with the line where there is one, for a path that does not belong to tool and stock."""
    path = timed.toolpath
    check_moves(file, path, by_teeth)
    wrong = _other_spindle(path, tool)
    if not wrong and not (tilt_of(path) > UPRIGHT).any():  # the side of a leaning tool cuts beside its tip
        wrong = _beside_stock(timed, tool, stock)
    if wrong:
        reason, block = wrong
        raise InputError(file, reason, int(path.line[block]) or None)


def check_moves(file: str, path: Toolpath, by_teeth: bool = True) -> None:
    """Raise InputError for a path without a cutting move, and for a tilt that the cut does not model."""
    if path.rapid[1:].all():
        raise InputError(file, "has no cutting move: every block is a rapid one")
    tilted = _tilted(path, by_teeth)
    if tilted:
        reason, block = tilted
        raise InputError(file, reason, int(path.line[block]) or None)


def _other_spindle(path: Toolpath, tool: Tool) -> tuple[str, int] | None:
    """Return the reason and the block where the programmed spindle differs from the spindle of the cell."""
    cutting = np.flatnonzero(~path.rapid[1:]) + 1
    speed = path.spindle_speed[cutting]
    same_speed = 0.1  # [rad/s], 1 rpm: spindle speeds that differ by less are one
    other = np.abs(np.abs(speed) - tool.spindle_speed) > same_speed
    if not speed.any():
        return None
    if other.any():
        block = cutting[np.argmax(other)]
        if path.spindle_speed[block] == 0.0:
            return "a cutting move while the spindle is off", block
        rpm = 30.0 / np.pi * np.array([abs(path.spindle_speed[block]), tool.spindle_speed])
        reason = f"the spindle speed S{rpm[0]:.6g} is not the tool.spindle_speed_rpm of the cell, {rpm[1]:.6g}"
        return reason, block
    turns = "clockwise (M3, CLW)" if speed[0] > 0 else "counterclockwise (M4, CCLW)"
    if turns.startswith(f"{tool.rotation} "):
        return None
    return (
        f"its spindle turns {turns}, but tool.rotation of the cell, the hand of the cutter, is {tool.rotation}",
        cutting[0],
    )


def tilt_of(path: Toolpath) -> np.ndarray:
    """Return the angle between the tool and z of the workpiece at each block [rad], (n,); 0 for rapid moves."""
    axis = tool_axis(path.quaternion)
    return np.where(path.rapid, 0.0, np.arctan2(np.hypot(axis[:, 0], axis[:, 1]), axis[:, 2]))


def _tilted(path: Toolpath, by_teeth: bool) -> tuple[str, int] | None:
    """Return the reason and the block where the tool tilts by more than the model of the cut supports."""
    tilt = tilt_of(path)
    # assumed: beyond 75 deg the side of the tool hides most of the material from the height map
    most = BY_TEETH if by_teeth else math.radians(75.0)
    if not (tilt > most).any():
        return None
    block = int(np.argmax(tilt > most))
    model = "cutting.detail: teeth is the cut" if by_teeth else "the height map of cutting.detail: engagement is that"
    advice = "; cutting.detail: engagement cuts with a tilted axis" if by_teeth else ""
    reason = (
        f"point {block + 1} of the path: the tool is tilted by {np.degrees(tilt[block]):.4g} deg, but {model} "
        f"of a tool along z of the workpiece (within {np.degrees(most):g} deg){advice}"
    )
    return reason, block


def _beside_stock(timed: TimedPath, tool: Tool, stock: Stock) -> tuple[str, int] | None:
    """Return the reason and the block of a path that misses the stock: a wrong placement, or a wrong unit."""
    run = timed.trajectory
    step = tool.radius / 8 / max(float(np.max(run.feed(run.time_ns))), 1e-6)
    count, radius = 2 + int(min(run.time[-1] / step, MOST_STEPS)), tool.radii.max()
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for part in blocks(count):
        at = run.sample((np.arange(part.start, part.stop) / (count - 1) * run.duration_ns).astype(np.int64))
        beside = np.maximum(np.maximum(stock.min - at, at - stock.max), 0.0)[:, :2]
        if np.any((np.hypot(*beside.T) < radius) & (at[:, 2] < stock.max[2])):
            return None
        low, high = np.minimum(low, at.min(axis=0)), np.maximum(high, at.max(axis=0))
    path_box, box = _extent(low, high), _extent(stock.min, stock.max)
    hint = "check the datum and the unit (G20, G21)"
    reason = f"the tool never reaches the stock: it goes through {path_box} mm, the stock fills {box} mm; {hint}"
    return reason, int(np.flatnonzero(~timed.toolpath.rapid[1:])[0]) + 1


def _extent(low: np.ndarray, high: np.ndarray) -> str:
    """A box [m] in words, in mm."""
    return ", ".join(f"{axis} {1e3 * a:.6g} to {1e3 * b:.6g}" for axis, a, b in zip("xyz", low, high, strict=True))


def check_feed(file: str, path: Toolpath, feed: float) -> None:
    """Raise InputError where the feeds of the program differ from the feed of the cell [m/s]; 0: the cell has none."""
    same_feed = 1e-6  # [m/s]
    other = ~path.rapid & (np.abs(path.feed - feed) > same_feed)
    if feed and other.any():
        block = int(np.argmax(other))
        reason = (
            f"its feed is {6e4 * path.feed[block]:.6g} mm/min, but path.feed_rate_m_per_min of the cell says "
            f"{6e4 * feed:.6g}; leave that key out"
        )
        raise InputError(file, reason, int(path.line[block]))
