"""``kr270_milling stiffness``: pose, Jacobian, Cartesian stiffness (17) and natural frequencies at one posture."""

from __future__ import annotations

from kr270_milling.commands.console import add_common, numbers, print_json, print_table


def add_arguments(parser) -> None:
    parser.add_argument("arm", metavar="ARM.yaml", help="arm or cell file; the flange is the tool point of a bare arm")
    parser.add_argument("--joints-deg", type=numbers(6, most=720.0), required=True, metavar="A1,...,A6")
    parser.add_argument("--wrench", type=numbers(6), default=[0.0] * 6, metavar="FX,FY,FZ,MX,MY,MZ", help="[N, N m]")
    parser.add_argument("--frame", choices=("base", "tool"), default="base", help="of wrench and matrices")
    parser.add_argument("--gravity", action="store_true", help="load the arm with its link weights too")
    add_common(parser)


def run(args) -> None:
    import numpy as np

    from kr270_milling.base.record import find_file
    from kr270_milling.robot.analysis import analyse, read_arm

    arm, mount = read_arm(find_file(args.arm))
    found = analyse(arm, mount, np.radians(args.joints_deg), np.array(args.wrench), args.frame, args.gravity)
    if args.json:
        print_json(found)
        return
    x, y, z = (f"{v:.6f}" for v in found["position_m"])
    print(f"{arm.name} at {args.joints_deg} deg, {args.frame} frame, tool point at ({x}, {y}, {z}) m\n")
    axes = ["x", "y", "z", "rx", "ry", "rz"]
    diagonal = zip(axes, np.diag(found["compliance"]), np.diag(found["stiffness"]), found["deflection"], strict=True)
    least = 1e-9 * np.repeat([np.abs(found["deflection"][k : k + 3]).max() for k in (0, 3)], 3)
    rows = [[a, _number(c), _number(k), _number(d, n)] for (a, c, k, d), n in zip(diagonal, least, strict=True)]
    print_table(
        "Diagonals and deflection under the wrench [m, rad, N]", ["axis", "compliance", "stiffness", "deflection"], rows
    )
    for model, values in found["mode_frequencies_hz"].items():
        print(f"natural frequencies, {model} mass: " + ", ".join(f"{v:.2f}" for v in values) + " Hz")
    print(f"condition number of the Jacobian (lengths in m): {found['condition_number']:.1f}")
    for warning in found["warnings"]:
        print(f"warning: {warning}")


def _number(value: float, least: float = 0.0) -> str:
    """Zeros as zeros, also those that rounding made."""
    return "0" if abs(value) <= least else f"{value:.4e}"
