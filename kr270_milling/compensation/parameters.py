"""Parameters of the compensator."""

from __future__ import annotations

from dataclasses import dataclass

from kr270_milling.compensation.methods import METHODS
from kr270_milling.config import Record, parameter

__all__ = ["Compensation", "METHODS"]


@dataclass(frozen=True, eq=False)
class Compensation(Record):
    """YAML ``compensation``: how the reference trajectory is revised."""

    method: str = parameter(text="how the revised trajectory is made", choices=METHODS)
    relaxation: float = parameter(0.9, above=0.0, high=1.0, text="alpha of (32)")
    sag_compensated: bool = parameter(True, text="the controller already compensates the sag under the link weights")
    criterion: str = parameter("min_max", text="what 'learned' minimises", choices=("min_max", "least_squares"))
    max_passes: int = parameter(12, low=1, high=1000, text="simulated passes that 'learned' may take")
    max_correction: float = parameter(
        2e-3, unit="mm", above=0.0, high=50.0, text="largest correction that is let through"
    )
