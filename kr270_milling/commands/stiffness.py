"""``kr270_milling stiffness``: pose, Jacobian, Cartesian stiffness (17) and natural frequencies at one posture."""

from __future__ import annotations

from kr270_milling.commands.console import Answer, Table
from kr270_milling.commands.options import option
from kr270_milling.nodes.option_types import numbers

AXES = ("x", "y", "z", "rx", "ry", "rz")


def add_arguments(parser) -> None:
    option(parser, "arm ARM.yaml", "arm or cell file; the flange is the tool point of a bare arm")
    option(parser, "--joints-deg A1,...,A6", "posture", numbers(6, most=720.0), required=True)
    option(parser, "--wrench FX,FY,FZ,MX,MY,MZ", "[N, N m], default: none", numbers(6), [0.0] * 6)
    option(parser, "--frame", "of wrench and matrices", default="base", choices=("base", "tool"))
    option(parser, "--gravity", "load the arm with its link weights too", bool)


def run(args) -> Answer:
    import numpy as np

    from kr270_milling.base.record import find_file
    from kr270_milling.robot.analysis import analyse, read_arm

    arm, mount = read_arm(find_file(args.arm))
    found = analyse(arm, mount, np.radians(args.joints_deg), np.array(args.wrench), args.frame, args.gravity)
    x, y, z = (f"{v:.6f}" for v in found["position_m"])
    diagonal = zip(AXES, np.diag(found["compliance"]), np.diag(found["stiffness"]), found["deflection"], strict=True)
    least = 1e-9 * np.repeat([np.abs(found["deflection"][k : k + 3]).max() for k in (0, 3)], 3)
    rows = [[a, _number(c), _number(k), _number(d, n)] for (a, c, k, d), n in zip(diagonal, least, strict=True)]
    title = "Diagonals and deflection under the wrench [m, rad, N]"
    shown = [
        f"{arm.name} at {args.joints_deg} deg, {args.frame} frame, tool point at ({x}, {y}, {z}) m\n",
        Table(title, ["axis", "compliance", "stiffness", "deflection"], rows),
    ]
    for model, values in found["mode_frequencies_hz"].items():
        shown.append(f"natural frequencies, {model} mass: " + ", ".join(f"{v:.2f}" for v in values) + " Hz")
    shown.append(f"condition number of the Jacobian (lengths in m): {found['condition_number']:.1f}")
    return Answer(found, [*shown, *(f"warning: {warning}" for warning in found["warnings"])])


def _number(value: float, least: float = 0.0) -> str:
    """Zeros as zeros, also those that rounding made."""
    return "0" if abs(value) <= least else f"{value:.4e}"
