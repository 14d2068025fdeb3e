"""What each kind of finding is measured in, and what to do about it."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["KINDS", "Kind"]

DEG = 180.0 / math.pi


@dataclass(frozen=True)
class Kind:
    """Unit of value and limit, factor from SI to it, and the advice."""

    unit: str = ""
    scale: float = 1.0
    advice: str = "Look at the place before you go on."


KINDS = {
    "reach": Kind("m", 1.0, "Move the workpiece nearer to the arm, or turn the tool."),
    "joint limit": Kind("deg", DEG, "Move or turn the workpiece, or choose another branch by posture_hint_deg."),
    "singularity": Kind("", 1.0, "Move the workpiece, or tilt the mount so that the wrist stays bent."),
    "configuration flip": Kind("", 1.0, "Move the workpiece until the arm keeps its configuration along the path."),
    "joint speed": Kind("deg/s", DEG, "Lower the feed there, or keep away from the singularity."),
    "joint acceleration": Kind("deg/s^2", DEG, "Lower timing.acceleration_m_per_s2, or round the corner."),
    "axis reversal": Kind("um", 1e6, "It shows on the part unless a load holds the axis to one side."),
    "correction size": Kind("mm", 1e3, "Check compliances and force law; then raise compensation.max_correction_mm."),
    "correction per tick": Kind("um", 1e6, "Use method inverse, or raise compensation.max_change_per_tick_um."),
    "correction limited": Kind("mm", 1e3, "Lower the feed there, or raise the limit in section compensation."),
    "corner blending": Kind("%", 100.0, "Lower program.blend_distance_mm, or use SPLINE motions."),
    "spindle torque": Kind("N m", 1.0, "Lower depth, width or feed of the cut."),
    "spindle power": Kind("kW", 1e-3, "Lower depth, width, feed or speed of the cut."),
    "stock missed": Kind("mm3", 1e9, "Check datum, unit and stock."),
    "rapid in material": Kind("mm", 1e3, "Retract above the stock before the rapid move, or feed there (G1)."),
    "below the stock": Kind("mm", 1e3, "Raise the path or lower the stock's bottom; limits.below_stock_mm allows it."),
    "in the fixture": Kind("mm", 1e3, "Move the fixture or the path."),
    "depth of cut": Kind("mm", 1e3, "Mill in more levels, or take a tool with a longer flute."),
    "plunge": Kind("mm", 1e3, "Let the CAM enter by a ramp or helix, or from outside, or take a centre-cutting tool."),
    "feed per tooth": Kind("mm", 1e3, "Check the unit of the feed and the number of teeth; lower F or raise S."),
    "cutting speed": Kind("m/min", 60.0, "Lower the spindle speed."),
    "chatter": Kind("1", 1.0, "Lower the depth of cut, or move to a stable spindle speed (kr270_milling stability)."),
    "deflection": Kind("mm", 1e3, "Check force law, feed per tooth, compliances and masses."),
    "joint deflection": Kind("deg", DEG, "Check compliances and masses; the linear springs do not hold so far."),
    "load on the arm": Kind("1", 1.0, "Check masses and compliances: the arm does not bear its own weight."),
    "tool and grid": Kind("mm", 1e3, "Check tool.diameter_mm, or lower stock.grid_step_um."),
    "envelope": Kind("m", 1.0, "Check workpiece.xyz_mm and its unit: it is on base_link, in mm."),
    "compliance": Kind("urad/(N m)", 1e6, "Check arm.joint_compliance and its unit, urad per N m."),
    "mass": Kind("kg", 1.0, "Check arm.link_mass_kg and mount.mass_kg."),
    "posture": Kind("deg", DEG, "Give the posture within the limits of the arm, in degrees."),
}
