"""``kr270_milling identify damping``: frequency and damping of the modes from a ring-down or an impact."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_common
from kr270_milling.commands.identified import Outcome, Table, report
from kr270_milling.nodes.option_types import bounded, stretch

AXES = ("x", "y", "z", "rx", "ry", "rz")
QUANTITIES = ("displacement", "velocity", "acceleration")


def add_arguments(parser) -> None:
    parser.add_argument(
        "recording", metavar="RECORDING", help="recording, UFF file, or CSV with time_s, any of x y z rx ry rz, force_n"
    )
    parser.add_argument("--topic", default="deflection", help="of a recording (default: deflection)")
    parser.add_argument(
        "--from", dest="start", type=bounded(0, 1e6), metavar="S", help="seconds after the first sample"
    )
    parser.add_argument("--to", dest="stop", type=bounded(0, 1e6), metavar="S", help="seconds after the first sample")
    parser.add_argument(
        "--band", type=stretch(0.01, 1e5), default=(2.0, 100.0), metavar="LOW:HIGH", help="[Hz] (default: 2:100)"
    )
    parser.add_argument("--modes", type=bounded(1, 20, int), default=6, metavar="N", help="at most (default: 6)")
    parser.add_argument("--quantity", choices=QUANTITIES, default=QUANTITIES[0], help="of the channels")
    parser.add_argument("--hammer", choices=AXES, help="direction of force_n: scales the shapes by the masses")
    parser.add_argument("--cell", metavar="CELL.yaml", help="scales the shapes by its compliance, where no hammer was")
    parser.add_argument("--out", metavar="DIR", help="write YAML to include and report")
    add_common(parser)


def run(args) -> None:
    from kr270_milling.identification.mode_result import as_dict, figures, include_sections
    from kr270_milling.identification.modes import find_modes
    from kr270_milling.identification.signals import read_signals

    signals = read_signals(args.recording, args.topic).window(args.start, args.stop)
    modes = find_modes(signals, args.band[0], args.band[1], args.modes)
    shapes = _shapes(args, modes, signals)
    result = as_dict(modes, signals, shapes)
    title = f"Modes between {args.band[0]:g} and {args.band[1]:g} Hz from {Path(args.recording).name}"
    outcome = Outcome("modes", title, result, [_table(title, result)], _sentences(result, shapes))
    report(args, outcome, lambda: figures(signals), include_sections(modes, shapes),
           use="name this file in `includes`, or copy what you need")  # fmt: skip


def _sentences(result: dict, shapes) -> list[str]:
    said = [f"{result['duration_s']:.3g} s at {result['samples_per_s']:.4g} samples a second"]
    if not all(mode["confirmed"] for mode in result["modes"]):
        said.append("the decrement does not confirm each damping ratio: modes are near each other, or ring too briefly")
    if shapes is None:
        said.append("the shapes are not scaled: a hammer (--hammer) or the compliance of a cell (--cell) does it")
    return said


def _shapes(args, modes, signals):
    """Mass-normalised, (n, 6), or None."""
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.identification.modal_mass import by_compliance, by_hammer, tool_compliance

    if args.hammer:
        return by_hammer(modes, signals, args.hammer, args.quantity)
    return by_compliance(modes, signals, tool_compliance(read_cell(find_file(args.cell)))) if args.cell else None


def _table(title: str, result: dict) -> Table:
    rows = []
    for i, mode in enumerate(result["modes"], 1):
        shape = " ".join(f"{v:.2f}" for v in mode["shape"])
        damping = [mode["damping_ratio"], mode["damping_ratio_log_decrement"], mode["share_of_energy"]]
        shown = [f"{100 * v:.{d}f}" for v, d in zip(damping, (2, 2, 0), strict=True)]
        rows.append([str(i), f"{mode['frequency_hz']:.3f}", *shown, shape])
    return Table(title, ["mode", "[Hz]", "damping [%]", "by decrement", "energy [%]", "shape x y z rx ry rz"], rows)
