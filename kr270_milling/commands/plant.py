"""The options ``--plant`` and ``--noise-um``: another cell cuts than the one that plans."""

from __future__ import annotations

import argparse

from kr270_milling.nodes.option_types import bounded

__all__ = ["add_plant", "read_plant"]

MOST_NOISE = 1e4  #: [um]


def add_plant(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plant", metavar="PLANT.yaml",
        help="cell file of the arm, material and imperfections that really cut; CELL.yaml is the model that plans",
    )  # fmt: skip
    parser.add_argument(
        "--noise-um", metavar="SIGMA", type=bounded(0.0, MOST_NOISE),
        help="standard deviation of each measured tool position along each axis (default: the plant's imperfections)",
    )  # fmt: skip


def read_plant(args, cell):
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
