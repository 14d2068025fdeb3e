"""``kr270_milling identify``: compliances, force coefficients and modes from measurements, each a sub-command."""

from __future__ import annotations

import argparse
import importlib

from kr270_milling.commands.console import Answer, Table
from kr270_milling.commands.options import add_json

#: name -> (what it does, example)
WHAT = {
    "compliance": (
        "joint compliances from load tests, or the load tests to make",
        "identify compliance MEASUREMENTS.csv --arm config/kr270_2.yaml --cell config/test_piece.yaml --out identified",
    ),
    "forces": (
        "force coefficients from mean forces of cuts, or from recordings of a sensor",
        "identify forces CUTS.csv --cell config/test_piece.yaml --out identified",
    ),
    "damping": (
        "frequency and damping of the modes from a ring-down or an impact",
        "identify damping RECORDING --topic deflection --out identified",
    ),
    "material": ("published force coefficients of a material", "identify material Al7075-T6"),
}


def add_arguments(parser) -> None:
    sub = parser.add_subparsers(dest="what", metavar="WHAT", required=True, help="each has --help and --json")
    for name, (text, example) in WHAT.items():
        more = dict(description=text[0].upper() + text[1:] + ".", epilog=f"example: kr270_milling {example}")
        command = sub.add_parser(name, help=text, **more)
        importlib.import_module(f"kr270_milling.commands.identify_{name}").add_arguments(command)
        add_json(command, argparse.SUPPRESS)


def run(args) -> Answer:
    return importlib.import_module(f"kr270_milling.commands.identify_{args.what}").run(args)


def identified(args, outcome) -> Answer:
    """What an ``Outcome`` says; with --out also its files."""
    files = [str(path) for path in outcome.write(args.out)] if args.out else []
    found = outcome.result | ({"files": files} if args.out else {})
    return Answer(found, [*(Table(*table) for table in outcome.tables), *outcome.said, *files])
