"""The cutter: angles and radii of the teeth, sense and speed of rotation, how far a lateral force bends it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter, section


@dataclass(frozen=True, eq=False)
class ToolModes(Record):
    """YAML ``tool.modes``: a list with one group a mode, or one group of lists; at the tool tip, workpiece axes.

    A mode of modal mass m along the unit vector d answers a force F at the tip with d (d . F) / m / (omega^2 - s^2 +
    2 i zeta omega s). The exchange of the nodes is too slow for tool modes; the stability limits
    use them together with the modes of the arm.
    """

    direction: np.ndarray = parameter([], low=-1.0, high=1.0, text="unit vector x, y, z of each mode")
    frequency: np.ndarray = parameter([], unit="hz", above=0.0, high=1e5, text="undamped natural frequency of each")
    damping_ratio: np.ndarray = parameter([], low=0.0, high=0.99, text="damping ratio of each mode")
    mass: np.ndarray = parameter([], unit="kg", above=0.0, high=1e4, text="modal mass of each mode")

    def check(self) -> None:
        n = self.frequency.size
        for key, size in (("damping_ratio", n), ("mass", n), ("direction", 3 * n)):
            values = getattr(self, key)
            if values.size != size:
                raise ParameterError(key, values.tolist(), f"a list of {size} numbers for {n} modes")
        length = np.linalg.norm(self.direction.reshape(n, 3), axis=1)
        if n and not np.allclose(length, 1.0, atol=1e-3):
            raise ParameterError("direction", self.direction.tolist(), "unit vectors")

    @property
    def shapes(self) -> np.ndarray:
        """Mass-normalised shapes [kg^-1/2], (n, 3)."""
        n = self.frequency.size
        return self.direction.reshape(n, 3) / np.sqrt(self.mass)[:, None]


@dataclass(frozen=True, eq=False)
class Tool(Record):
    """A cylindrical end mill: straight edges, or edges that a helix makes lag the more the higher above the tip."""

    diameter: float = parameter(unit="mm", low=0.05, high=200.0, text="cutter diameter")
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

    type: str = parameter(
        "program",
        choices=("program", "flat", "indexable", "ball", "bull_nose", "tapered", "points"),
        text="program: the shape that the comments of the program state, else flat; any other: this shape, whatever "
        "they say; indexable: a flat mill with inserts; tapered: also a chamfer mill and the point of a drill",
    )
    corner_radius: float = parameter(
        0.0, unit="mm", low=0.0, high=100.0, text="corner radius of a bull nose, or of the tip of a tapered tool"
    )
    taper: float = parameter(
        0.0,
        unit="deg",
        low=0.0,
        high=89.0,
        text="angle between side and axis of a tapered tool: half the angle of a point",
    )
    tip_diameter: float = parameter(
        0.0,
        unit="mm",
        low=0.0,
        high=200.0,
        text="diameter of a tapered tool at its tip; 0: a point, or the ball of corner_radius",
    )
    profile: np.ndarray = parameter(
        [], unit="mm", low=0.0, high=500.0, text="radius, height, radius, height, ... from the tip up, for type: points"
    )
    # assumed: a sharp ground edge of carbide for aluminium; honed edges are rounder
    edge_radius: float = parameter(
        3e-6,
        unit="um",
        above=0.0,
        high=100.0,
        text="roundness of the edges: the end edge presses in proportion to a layer a tooth that is thinner",
    )
    flute_length: float = parameter(
        0.0, unit="mm", low=0.0, high=500.0, text="length of the cutting edges; 0: not known"
    )
    centre_cutting: bool = parameter(True, text="whether the tool can plunge straight into material")
    max_feed_per_tooth: float = parameter(
        0.0,
        unit="mm",
        low=0.0,
        high=10.0,
        text="limit of the tool's maker; 0: a tenth of the diameter, at most 0.94 mm",
    )
    max_cutting_speed: float = parameter(
        0.0, unit="m_per_min", low=0.0, high=2e4, text="limit of the tool's maker; 0: not known"
    )

    stick_out: float = parameter(
        0.0, unit="mm", low=0.0, high=500.0, text="from the holder to the tip; 0: not known, the tool is rigid"
    )
    shank_diameter: float = parameter(
        0.0, unit="mm", low=0.0, high=200.0, text="above the flutes, from 0.001; 0: diameter"
    )
    holder: np.ndarray = parameter(
        [],
        unit="mm",
        low=0.0,
        high=1000.0,
        text="corners of holder and spindle nose: radius, height, radius, height, ...; heights are above the end of "
        "stick_out, the first is 0, the last radius has no end; empty: 3 mm wider than the shank",
    )
    # assumed: cemented carbide; high-speed steel has 210
    modulus: float = parameter(600e9, unit="gpa", above=0.0, high=1000.0, text="Young's modulus")
    # [Kops1990]: the equivalent diameter of end mills, from their measured compliance
    flute_section: float = parameter(
        0.8, low=0.01, high=1.0, text="diameter of a round bar as stiff as the flutes, a share of the diameter"
    )
    stiffness: float = parameter(
        0.0, unit="n_per_um", low=0.0, high=1e4, text="lateral, measured at the tip, from 0.001; 0: not known"
    )

    modes: ToolModes = section(ToolModes)

    def check(self) -> None:
        if self.stiffness and self.stick_out:
            allowed = "0 where tool.stick_out_mm is given: the stiffness is measured or that of a beam"
            raise ParameterError("stiffness_n_per_um", 1e-6 * self.stiffness, allowed)
        if 0.0 < self.stiffness < 1e3:
            raise ParameterError("stiffness_n_per_um", 1e-6 * self.stiffness, "0, or 0.001 to 10000")
        if 0.0 < self.shank_diameter < 1e-6:
            raise ParameterError("shank_diameter_mm", 1e3 * self.shank_diameter, "0, or 0.001 to 200")
        for key, values in (("pitch_deg", np.degrees(self.pitch)), ("runout_um", 1e6 * self.runout)):
            if values.size not in (0, self.teeth):
                raise ParameterError(key, values.tolist(), f"empty or one number for each of the {self.teeth} teeth")
        if abs(self.pitches.sum() - 2 * np.pi) > 1e-6:
            raise ParameterError("pitch_deg", np.degrees(self.pitch).tolist(), "angles that sum up to 360")
        if self.radii.min() <= 0.0:
            raise ParameterError("runout_um", (1e6 * self.runout).tolist(), "less than the radius of the cutter")

        if self.holder.size:
            rows = self.holder.reshape(-1, 2) if self.holder.size % 2 == 0 else np.full((1, 2), np.nan)
            begins = rows[0, 0] > 0.0 and rows[0, 1] == 0.0
            if not begins or not (np.diff(rows, axis=0) >= 0.0).all() or not self.stick_out:
                allowed = "corners as radius, height, that do not fall, the first at height 0, with tool.stick_out_mm"
                raise ParameterError("holder_mm", (1e3 * self.holder).tolist(), allowed)
        self._check_profile()

    def _check_profile(self) -> None:
        """Raise ParameterError for a profile that the keys of a tool do not describe."""
        radius, corner = self.radius, self.corner_radius
        rounded = 1e-9  # [m], of lengths in a file
        if self.type == "bull_nose" and not 0.0 < corner <= radius + rounded:
            raise ParameterError(
                "corner_radius_mm", 1e3 * corner, f"above 0 and at most {1e3 * radius:g} for a bull nose"
            )
        if self.type == "ball" and corner and abs(corner - radius) > rounded:
            raise ParameterError(
                "corner_radius_mm", 1e3 * corner, f"0 or {1e3 * radius:g}, half the diameter of the ball"
            )
        if self.type in ("program", "flat", "indexable", "points") and corner:
            raise ParameterError("corner_radius_mm", 1e3 * corner, f"0 where tool.type is {self.type}")
        if (self.type == "tapered") != (self.taper > 0.0):
            allowed = (
                "above 0, the angle between side and axis" if self.type == "tapered" else "0 without type: tapered"
            )
            raise ParameterError("taper_deg", math.degrees(self.taper), allowed)
        if self.tip_diameter and (self.type != "tapered" or self.tip_diameter >= self.diameter):
            raise ParameterError(
                "tip_diameter_mm", 1e3 * self.tip_diameter, "0, or below the diameter of a tapered tool"
            )
        if self.type == "tapered":
            least = 2.0 * corner * math.tan(0.25 * math.pi - 0.5 * self.taper)
            if self.tip_diameter and self.tip_diameter < least - rounded:
                raise ParameterError(
                    "tip_diameter_mm", 1e3 * self.tip_diameter, f"0 or at least {1e3 * least:.4g}: corner"
                )
            if least >= self.diameter or corner * math.cos(self.taper) >= radius:
                raise ParameterError(
                    "corner_radius_mm", 1e3 * corner, "smaller: no cone is left between tip and diameter"
                )
        points = self.profile
        if bool(points.size) != (self.type == "points"):
            allowed = "radius, height, radius, height, ..." if self.type == "points" else "empty without type: points"
            raise ParameterError("profile_mm", (1e3 * points).tolist(), allowed)
        if self.type == "points":
            rows = points.reshape(-1, 2) if points.size % 2 == 0 else np.full((1, 2), np.nan)
            steps = np.diff(rows, axis=0)
            sound = rows[0, 1] == 0.0 and rows[0, 0] >= 0.0 and (steps >= 0.0).all() and (steps > 0.0).any(axis=1).all()
            if not sound or abs(rows[-1, 0] - radius) > rounded:
                allowed = (
                    "pairs of radius and height from the height 0 upwards to half the diameter; neither may fall, "
                    "since an upright tool hides what is below its largest radius"
                )
                raise ParameterError("profile_mm", (1e3 * points).tolist(), allowed)

    @property
    def radius(self) -> float:
        """Nominal radius R [m]."""
        return self.diameter / 2

    @property
    def lateral_compliance(self) -> float:
        """Static displacement of the tip in the direction of a lateral force there [m/N]; 0: the tool is rigid.

        Measured, or that of a stepped cantilever of length L whose last part l has the section of the flutes:

            C = [(L^3 - l^3) / I_shank + l^3 / I_flutes] / (3 E),   I = pi d^4 / 64   [Kops1990]

        An unknown length of the flutes counts as the whole stick-out.
        """
        if self.stiffness:
            return 1.0 / self.stiffness
        fluted = min(self.flute_length or self.stick_out, self.stick_out)
        shank, flutes = (
            math.pi * d**4 / 64.0 for d in (self.shank_diameter or self.diameter, self.flute_section * self.diameter)
        )
        return ((self.stick_out**3 - fluted**3) / shank + fluted**3 / flutes) / (3.0 * self.modulus)

    @property
    def bending_stress(self) -> float:
        """Largest bending stress by a lateral force at the tip [1/m^2], in the beam of ``lateral_compliance``.

            sigma / F = 32 x / (pi d^3)

        where x is the distance of the section from the tip: the holder, or the end of the flutes. 0: not known.
        """
        if not self.stick_out:
            return 0.0
        flutes, shank = self.flute_section * self.diameter, self.shank_diameter or self.diameter
        fluted = min(self.flute_length or self.stick_out, self.stick_out)
        root = flutes if fluted == self.stick_out else shank
        return 32.0 / math.pi * max(fluted / flutes**3, self.stick_out / root**3)

    @property
    def compliance_text(self) -> str:
        """The lateral compliance of the tool in a few words."""
        if not self.lateral_compliance:
            return "tool taken as rigid"
        kind = "measured" if self.stiffness else f"beam of {1e3 * self.stick_out:.3g} mm"
        return f"tool compliance {1e6 * self.lateral_compliance:.3g} um/N lateral ({kind})"

    @property
    def radii(self) -> np.ndarray:
        """Distance of each tooth's tip from the spindle axis [m], (teeth,)."""
        return self.radius + (self.runout if self.runout.size else np.zeros(self.teeth))

    @property
    def has_flat_end(self) -> bool:
        """Return whether the end of the cutter is flat and its side a cylinder."""
        return self.type in ("program", "flat", "indexable")

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
        """+1 counterclockwise, -1 clockwise: a tooth at phi is at (cos phi, sense * sin phi)."""
        return 1.0 if self.rotation == "counterclockwise" else -1.0
