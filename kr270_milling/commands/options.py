"""The options of commands, and what several commands have in common: a cell, and a plant in its place."""

from __future__ import annotations

import argparse

from kr270_milling.nodes.option_types import bounded

__all__ = ["add_cell", "add_json", "add_plant", "cell_of", "option", "plant_of"]

MOST_NOISE = 1e4  #: [um]


def option(parser, names: str, text: str, kind=None, default=None, **more) -> None:
    """Add "--seed N", the switch "--robust" (kind bool) or the argument "cell CELL.yaml"; the help says its default."""
    name, _, metavar = names.partition(" ")
    if kind is bool:
        parser.add_argument(name, action="store_true", help=text)
        return
    if default and "default" not in text:
        text += f" (default: {default:g})" if isinstance(default, (int, float)) else f" (default: {default})"
    parser.add_argument(name, metavar=metavar or None, type=kind, default=default, help=text, **more)


def add_json(parser: argparse.ArgumentParser, default=False) -> None:
    more: dict = dict(action="store_true", default=default)
    parser.add_argument("--json", help="print one JSON object to standard output", **more)


def add_cell(parser: argparse.ArgumentParser) -> None:
    option(parser, "cell CELL.yaml", "cell file, also a shipped one by its name")
    option(parser, "--set key=value", "override a key, for example tool.teeth=2", default=[], action="append")


def cell_of(args):
    """The cell of a command line with the options of ``add_cell``."""
    from kr270_milling.base.parameter_file import find_file
    from kr270_milling.cell.cell import read_cell

    return read_cell(find_file(args.cell), args.set)


def add_plant(parser: argparse.ArgumentParser) -> None:
    what = "cell file of the arm, material and imperfections that really cut; CELL.yaml is the model that plans"
    option(parser, "--plant PLANT.yaml", what)
    noise = "standard deviation of each measured tool position along each axis (default: the plant's imperfections)"
    option(parser, "--noise-um SIGMA", noise, bounded(0.0, MOST_NOISE))


def plant_of(args, cell):
    """The plant of a command line; None where the model itself cuts, and perfectly."""
    from kr270_milling.base.parameter_file import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.cell.plant import Plant

    cuts = read_cell(find_file(args.plant)) if args.plant else cell
    how = cuts.imperfections
    if args.noise_um is not None:
        how = how.replace(pose_noise=1e-6 * args.noise_um)
    perfect = not (how.pose_noise or how.repeatability or how.backlash.any())
    return None if perfect and not args.plant else Plant(cell, cuts, how)
