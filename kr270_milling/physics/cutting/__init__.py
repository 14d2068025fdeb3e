"""The cut: tool, force laws, workpiece grid, sweep of the teeth [Klimchik2014, section 4]."""

from kr270_milling.physics.cutting.cut import Cut, CutModel, EngagementCut
from kr270_milling.physics.cutting.force_law import ForceLaw
from kr270_milling.physics.cutting.grid import Stock
from kr270_milling.physics.cutting.laws import (
    AL7075_T6,
    LAWS,
    Cutting,
    FractionalLaw,
    LinearEdgeLaw,
    fractional,
    linear_edge,
)
from kr270_milling.physics.cutting.state import Params, State, make_params, make_state
from kr270_milling.physics.cutting.sweep import NO_FORCES, sweep, undo
from kr270_milling.physics.cutting.tool import Tool

__all__ = [
    "AL7075_T6",
    "LAWS",
    "NO_FORCES",
    "Cut",
    "CutModel",
    "Cutting",
    "EngagementCut",
    "ForceLaw",
    "FractionalLaw",
    "LinearEdgeLaw",
    "Params",
    "State",
    "Stock",
    "Tool",
    "fractional",
    "linear_edge",
    "make_params",
    "make_state",
    "sweep",
    "undo",
]
