"""The cutter: where its teeth stand, how far they reach, which way and how fast they turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter
from kr270_milling.cutting.tool_modes import ToolModes

__all__ = ["Tool"]


@dataclass(frozen=True, eq=False)
class Tool(Record):
    """A cylindrical end mill: straight edges, or edges that a helix makes lag the more the higher above the tip."""

    diameter: float = parameter(unit="mm", above=0.0, high=200.0, text="cutter diameter")
    teeth: int = parameter(low=1, high=100, text="number of teeth")
    spindle_speed: float = parameter(
        0.0, unit="rpm", low=0.0, high=200_000.0, text="spindle speed; 0: that of the program in path.file"
    )
    pitch: np.ndarray = parameter(
        [], unit="deg", above=0.0, high=360.0, text="angle from each tooth to the next ahead of it; empty: uniform"
    )
    runout: np.ndarray = parameter(
        [], unit="um", low=-1000.0, high=1000.0, text="radius of each tooth beyond half the diameter; empty: none"
    )
    rotation: str = parameter(
        "clockwise", choices=("clockwise", "counterclockwise"), text="sense of rotation seen from +z of the workpiece"
    )
    start_angle: float = parameter(
        0.0, unit="deg", low=-360.0, high=360.0, text="tooth 0 at t = 0, from +x in the sense of rotation"
    )
    helix: float = parameter(
        0.0, unit="deg", low=0.0, high=75.0, text="helix angle: at z above the tip an edge lags by z tan(helix) / R"
    )

    flute_length: float = parameter(0.0, unit="mm", low=0.0, high=500.0, text="of the cutting edges; 0: not known")
    centre_cutting: bool = parameter(True, text="whether the tool can plunge straight into material")
    max_feed_per_tooth: float = parameter(0.0, unit="mm", low=0.0, high=10.0, text="its maker's limit; 0: not known")
    max_cutting_speed: float = parameter(
        0.0, unit="m_per_min", low=0.0, high=2e4, text="its maker's limit; 0: not known"
    )

    modes: ToolModes = ToolModes()

    def check(self) -> None:
        for name, unit in (("pitch", "deg"), ("runout", "um")):
            if getattr(self, name).size not in (0, self.teeth):
                shown = f"empty or one number for each of the {self.teeth} teeth"
                raise ParameterError(f"{name}_{unit}", getattr(self, name).tolist(), shown)
        if abs(self.pitches.sum() - 2 * np.pi) > 1e-6:
            raise ParameterError("pitch_deg", np.degrees(self.pitch).tolist(), "angles that sum up to 360")
        if self.radii.min() <= 0.0:
            raise ParameterError("runout_um", (1e6 * self.runout).tolist(), "less than the radius of the cutter")

    @property
    def radius(self) -> float:
        """Nominal radius R [m]."""
        return self.diameter / 2

    @property
    def radii(self) -> np.ndarray:
        """Distance of each tooth's tip from the spindle axis [m], (teeth,)."""
        return self.radius + (self.runout if self.runout.size else np.zeros(self.teeth))

    @property
    def pitches(self) -> np.ndarray:
        """Angle from tooth i to tooth i + 1, which runs ahead of it [rad], (teeth,)."""
        return self.pitch if self.pitch.size else np.full(self.teeth, 2 * np.pi / self.teeth)

    @property
    def angles(self) -> np.ndarray:
        """phi_i of each tooth at t = 0 [rad], (teeth,), from +x in the sense of rotation."""
        return self.start_angle + np.concatenate([[0.0], np.cumsum(self.pitches)[:-1]])

    @property
    def sense(self) -> float:
        """+1 counterclockwise, -1 clockwise: a tooth at phi stands at (cos phi, sense * sin phi)."""
        return 1.0 if self.rotation == "counterclockwise" else -1.0
