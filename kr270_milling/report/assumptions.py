"""The assumption table: what the paper does not give or misprints, what was taken instead, and why.

Only what affects the run at hand is listed; values are those of the cell, never copies of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.robot.mass import MODELS
from kr270_milling.simulation.arm_model import modal_models

__all__ = ["Assumption", "assumptions", "mode_frequencies"]


@dataclass(frozen=True)
class Assumption:
    """One row of the table."""

    point: str
    value: str
    reason: str


def mode_frequencies(cell: Cell) -> dict[str, np.ndarray]:
    """First natural frequencies [Hz] at the start of the path with each mass model that has an answer there."""
    start = cell.joints(cell.target())[:1]
    found = {}
    for name in MODELS:
        dynamics = cell.dynamics.replace(mass_model=name)
        try:
            (model,) = modal_models(cell.arm, cell.mount, dynamics, cell.workpiece.pose, start)
        except MillingError:
            continue
        found[name] = model.frequency / (2 * np.pi)
    return found


def assumptions(cell: Cell, paper: bool) -> list[Assumption]:
    """The rows that hold for this cell; with ``paper`` also those about the paper's text and Table 2."""
    return [*_cut(cell), *(_of_the_paper(cell) if paper else []), *_arm(cell), *_numerics(cell)]


def _of_the_paper(cell: Cell) -> list[Assumption]:
    tool, path = cell.tool, cell.path
    passing = tool.spindle_speed / (2 * np.pi) * tool.teeth
    return [
        Assumption(
            "depth of cut a_p",
            f"{path.depth_of_cut * 1e3:.4g} mm, identified",
            "The paper does not give it. This value yields the 58.1 µm static deviation of its Table 2; nothing else "
            "is fitted to that number.",
        ),
        Assumption(
            "damping ratio",
            f"{cell.dynamics.damping_ratio:.3g} for every mode, identified",
            "The paper does not give C_C. This value yields the largest deviations of Table 2, 63.2 and 4.70 µm. "
            "Measured milling robots have 0.03 to 0.05, and would ring longer.",
        ),
        Assumption(
            "tooth passing frequency",
            f"{passing:.1f} Hz",
            f"The paper writes 'about 700 Hz' for the high frequency; {tool.teeth} teeth at "
            f"{tool.spindle_speed * 30 / np.pi:.0f} rpm pass at {passing:.1f} Hz.",
        ),
        Assumption(
            "radial engagement",
            f"full slot, fully engaged from {cell.full_engagement:.3f} s on",
            "Not given. The text says 'straight borders', 'engaging progressively' and 'fully engaged': a slot that is "
            "entered from an edge, complete when the middle of the tool has come to it.",
        ),
        Assumption(
            "static and largest deviation",
            "mean over the last quarter; largest magnitude from full engagement on",
            "The paper does not define its scores; it says that the entry does not affect the final surface.",
        ),
        Assumption(
            "arm variant",
            cell.arm.name,
            "The paper does not name the variant of its KR 270; its group writes of a gravity compensator, which the "
            "Series 2000 has. The link lengths are not in the paper but in a data sheet of the same family.",
        ),
        Assumption(
            "tool offset",
            f"{np.round(cell.mount.xyz * 1e3, 3).tolist()} mm from the flange",
            "The paper gives no spindle; with the tool tip at the flange its compliances give its static deviation.",
        ),
        Assumption(
            "misprints put right",
            "(13), (18), (22), (24), (25)",
            "(13) lacks transposes; Q_j of (18) needs six entries; D of (22) has the wrong sign for right-handed "
            "rotations; M_tot of (24) must be assembled over shared nodes; (25) as printed is a joint-space form.",
        ),
        Assumption(
            "kind of evidence",
            "simulation",
            "The paper says 'experimental verification'; what it shows is of simulation type, and so is this report.",
        ),
    ]


def _cut(cell: Cell) -> list[Assumption]:
    tool = cell.tool
    per_tooth = cell.feed_rate * 2 * np.pi / tool.spindle_speed / tool.teeth
    rows = []
    if cell.cutting.law == "fractional":
        force = float(cell.cutting.force_per_depth(per_tooth)[0]) * 1e-3
        rows.append(
            Assumption(
                "reading of (26)",
                f"k_0 per millimetre of depth: {force:.1f} N per mm of depth at h = {per_tooth * 1e6:.0f} µm",
                f"As printed, k_0 ψ(h/h_s) a_p gives {_as_printed(cell, per_tooth):.1f} kN per mm of depth for one "
                "tooth, which would bend the arm by millimetres. F_t = k_0 h_s ψ(h/h_s) a_p / (1 mm) is the reading "
                "of ordinary size.",
            )
        )
    rows.append(
        Assumption(
            "sense of rotation",
            tool.rotation,
            "Seen from +z of the workpiece. The force sum (29) holds for teeth at (cos φ, −sin φ), which is clockwise.",
        )
    )
    helix = f"helix {np.degrees(tool.helix):g}°" if tool.helix else "no helix"
    axial = "F_z is that of the axial coefficients" if cell.cutting.axial else "F_z is neglected as in the paper"
    rows.append(
        Assumption(
            "tool and spindle",
            f"rigid, {helix}" + ("" if np.any(tool.runout) else ", no run-out"),
            f"Only the arm gives way; {axial}.",
        )
    )
    return rows


def _as_printed(cell: Cell, h: float) -> float:
    """(26) to the letter, [kN] for 1 mm of depth."""
    law = cell.cutting.fractional
    u = h / law.specific_chip_thickness
    return law.stiffness * (u + law.ratio * u * u) / (1 + u) * 1e-3 * 1e-3


def _arm(cell: Cell) -> list[Assumption]:
    found = mode_frequencies(cell)
    listed = "; ".join(f"{name}: {', '.join(f'{f:.2f}' for f in hz[:3])} Hz" for name, hz in found.items())
    mass = float(cell.arm.link_mass.sum()) + cell.mount.mass
    gravity = "with" if cell.dynamics.gravity else "without"
    sag = "compensates" if cell.compensation.sag_compensated else "does not compensate"
    return [
        Assumption(
            "mass model",
            f"{cell.dynamics.mass_model}; first modes {listed}",
            f"'lumped': all {mass:.1f} kg ride with the tool, the reading of (25) that gives the paper's 6.70 Hz. "
            "'consistent': the energy-consistent reduction of the paper's beams, which let links bend and twist that "
            "the springs hold rigid. 'rigid': rigid links on joint springs, the mass that fits the stiffness.",
        ),
        Assumption(
            "components without inertia",
            "condensed",
            "Rotations that carry no inertia follow statically. Slicing the stiffness matrix instead would hold them "
            "fixed and make the arm too stiff.",
        ),
        Assumption(
            "link weights",
            f"stiffness {gravity} link weights; the controller {sag} the sag",
            "The constant sag under the arm's own weight is not part of the deviations shown.",
        ),
        _posture(cell),
    ]


def _posture(cell: Cell) -> Assumption:
    if cell.dynamics.follow_pose:
        spacing = f"{cell.dynamics.posture_spacing * 1e3:g} mm"
        reason = f"They are computed every {spacing} of the path at most and interpolated linearly in between."
        return Assumption("posture", "stiffness and mass follow the posture along the path", reason)
    way = cell.timed_path.toolpath.length if cell.timed_path is not None else cell.path.length
    return Assumption(
        "posture",
        "stiffness and mass of the start of the path hold for the whole pass",
        f"The path is {way * 1e3:.0f} mm long. Where that is not short beside the arm's reach, set follow_pose.",
    )


def _numerics(cell: Cell) -> list[Assumption]:
    return [
        Assumption(
            "steps of the calculation",
            f"grid {cell.stock.grid_step * 1e6:g} µm, micro-step {np.degrees(cell.exchange.micro_step):g}°, "
            f"exchange period {cell.exchange.period * 1e3:g} ms",
            "Not given in the paper. What finer steps would change is in the README, for the paper's case.",
        ),
        Assumption(
            "alpha of (32)",
            f"{cell.compensation.relaxation:g}",
            "The paper asks for a value between 0 and 1. Only the static mirror method uses it.",
        ),
    ]
