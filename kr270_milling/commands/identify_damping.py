"""``kr270_milling identify damping``: frequency and damping of the modes from a ring-down or an impact."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import option
from kr270_milling.nodes.option_types import bounded, stretch

AXES = ("x", "y", "z", "rx", "ry", "rz")
QUANTITIES = ("displacement", "velocity", "acceleration")


def add_arguments(parser) -> None:
    what = "recording, UFF file, or CSV with time_s, any of x y z rx ry rz, force_n"
    option(parser, "recording RECORDING", what)
    option(parser, "--topic", "of a recording", default="deflection")
    option(parser, "--from S", "seconds after the first sample", bounded(0, 1e6), dest="start")
    option(parser, "--to S", "seconds after the first sample", bounded(0, 1e6), dest="stop")
    option(parser, "--band LOW:HIGH", "[Hz] (default: 2:100)", stretch(0.01, 1e5), (2.0, 100.0))
    option(parser, "--modes N", "at most", bounded(1, 20, int), 6)
    option(parser, "--quantity", "of the channels", default=QUANTITIES[0], choices=QUANTITIES)
    option(parser, "--hammer", "direction of force_n: scales the shapes by the masses", choices=AXES)
    option(parser, "--cell CELL.yaml", "scales the shapes by its compliance, where no hammer was")
    option(parser, "--out DIR", "write YAML to include and report")


def run(args) -> Answer:
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.commands.identify import identified
    from kr270_milling.identification.modes import (
        by_compliance,
        by_hammer,
        find_modes,
        mode_outcome,
        tool_compliance,
    )
    from kr270_milling.identification.signals import read_signals

    signals = read_signals(args.recording, args.topic).window(args.start, args.stop)
    low, high = args.band
    modes, shapes = find_modes(signals, low, high, args.modes), None
    if args.hammer:
        shapes = by_hammer(modes, signals, args.hammer, args.quantity)
    elif args.cell:
        shapes = by_compliance(modes, signals, tool_compliance(read_cell(find_file(args.cell))))
    title = f"Modes between {low:g} and {high:g} Hz from {Path(args.recording).name}"
    return identified(args, mode_outcome(modes, signals, shapes, title))
