"""What a pass costs, reckoned before it starts: a wrong unit must not keep a machine busy for days."""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.cutting import Stock, Tool
from kr270_milling.simulation.exchange import Exchange

__all__ = ["MOST_STEPS", "check_effort", "check_postures", "sinking"]

MOST_STEPS = 5e6  #: exchange periods or reference points of one pass; its series take some 250 bytes a step
MOST_TOOTH_STEPS = 1e10  #: micro-steps of single teeth in one pass, some 0.1 us each
MOST_VISITS = 1e13  #: nodes under the footprint, each time that it is swept as a whole, some ns each
MOST_POSTURES = 100_000  #: at which the arm's modes are computed, some ms and 3 kB each


def check_effort(exchange: Exchange, tool: Tool, stock: Stock, duration: float, sinks: tuple = (0.0, 0.0)) -> None:
    """Raise ParameterError for a pass of a duration [s] that nobody can mean; sinks: what ``sinking`` says of it."""
    turns = duration * tool.spindle_speed / (2.0 * math.pi)
    teeth = turns * 2.0 * math.pi / exchange.micro_step * tool.teeth * exchange.iterations
    if not teeth <= MOST_TOOTH_STEPS:
        shown = math.degrees(exchange.micro_step)
        allowed = f"larger: the pass would take {teeth:.3g} micro-steps of a tooth, more than {MOST_TOOTH_STEPS:g}"
        raise ParameterError("exchange.micro_step_deg", shown, allowed)
    seconds, depth = sinks
    times = min(seconds * tool.spindle_speed / (2.0 * math.pi), depth / max(stock.floor_tolerance, stock.level_step))
    nodes = math.pi * float(tool.radii.max()) ** 2 / stock.grid_step**2
    visits = nodes * times * tool.teeth * exchange.iterations
    if not visits <= MOST_VISITS:
        allowed = f"larger: the sinking tool would sweep {visits:.3g} nodes, more than {MOST_VISITS:g}"
        raise ParameterError("stock.grid_step_um", stock.grid_step * 1e6, allowed)


def sinking(time: np.ndarray, height: np.ndarray, top: float) -> tuple[float, float]:
    """How long [s] and how deep in all [m] a tool sinks below ``top``; times [s] and heights [m] of its path, (n,)."""
    down = -np.diff(np.minimum(height, top))
    return float(np.diff(time)[down > 0].sum()), float(down[down > 0].sum())


def check_postures(count: int, spacing: float) -> None:
    """Raise ParameterError for more postures along a path than anybody can mean; spacing [m]: what was asked for."""
    if count > MOST_POSTURES:
        allowed = f"larger: the arm would be modelled at {count} postures, more than {MOST_POSTURES}"
        raise ParameterError("dynamics.posture_spacing_mm", spacing * 1e3, allowed)
