"""``kr270_milling identify damping``: frequency and damping of the modes from a ring-down or an impact."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_common, print_json, print_table
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
    from kr270_milling.identification.mode_result import as_dict
    from kr270_milling.identification.modes import find_modes
    from kr270_milling.identification.signals import read_signals

    signals = read_signals(args.recording, args.topic).window(args.start, args.stop)
    modes = find_modes(signals, args.band[0], args.band[1], args.modes)
    result = as_dict(modes, signals)
    shapes = _shapes(args, modes, signals)
    if shapes is not None:
        for mode, shape in zip(result["modes"], shapes.tolist(), strict=True):
            mode["mass_normalised_shape"] = shape
    if args.out:
        result["files"] = [str(path) for path in _write(args, modes, signals, shapes, result)]
    if args.json:
        print_json(result)
        return
    columns, rows = _rows(result)
    print_table(f"Modes between {args.band[0]:g} and {args.band[1]:g} Hz", columns, rows)
    print(f"{result['duration_s']:.3g} s at {result['samples_per_s']:.4g} samples a second")
    if not all(mode["confirmed"] for mode in result["modes"]):
        print("the decrement does not confirm each damping ratio: modes are near each other, or ring too briefly")
    if shapes is None:
        print("the shapes are not scaled: a hammer (--hammer) or the compliance of a cell (--cell) does it")
    for name in result.get("files", []):
        print(name)


def _shapes(args, modes, signals):
    """Mass-normalised, (n, 6), or None."""
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.identification.modal_mass import by_compliance, by_hammer, tool_compliance

    if args.hammer:
        return by_hammer(modes, signals, args.hammer, args.quantity)
    return by_compliance(modes, signals, tool_compliance(read_cell(find_file(args.cell)))) if args.cell else None


def _rows(result: dict) -> tuple[list[str], list[list[str]]]:
    rows = []
    for i, mode in enumerate(result["modes"], 1):
        decrement = mode["damping_ratio_log_decrement"]
        shape = " ".join(f"{v:.2f}" for v in mode["shape"])
        numbers = [f"{mode['frequency_hz']:.3f}", f"{100 * mode['damping_ratio']:.2f}", f"{100 * decrement:.2f}"]
        rows.append([str(i), *numbers, f"{100 * mode['share_of_energy']:.0f}", shape])
    return ["mode", "[Hz]", "damping [%]", "by decrement", "energy [%]", "shape x y z rx ry rz"], rows


def _write(args, modes, signals, shapes, result: dict) -> list[Path]:
    from kr270_milling import __version__
    from kr270_milling.base.files import staged
    from kr270_milling.base.include import write_include
    from kr270_milling.identification.figures import write_page
    from kr270_milling.identification.mode_result import figures, include_sections

    title = f"Modes from {Path(args.recording).name}"
    notes = [
        f"{title}, identified by kr270_milling {__version__}",
        "name this file in `includes`, or copy what you need",
    ]
    with staged(args.out) as (draft, final):
        files = [
            write_include(draft / "modes.yaml", include_sections(modes, shapes), notes),
            write_page(draft / "modes.html", title, [], [("Modes", *_rows(result))], figures(signals)),
        ]
        return [final(path) for path in files]
