"""``kr270_milling identify``: compliances, force coefficients and modes from measurements, each a sub-command."""

from __future__ import annotations

import importlib

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
        described = text[0].upper() + text[1:] + "."
        command = sub.add_parser(
            name,
            help=text,
            description=described,
            epilog=f"example: kr270_milling {example}",
        )
        importlib.import_module(f"kr270_milling.commands.identify_{name}").add_arguments(command)


def run(args) -> int | None:
    return importlib.import_module(f"kr270_milling.commands.identify_{args.what}").run(args)
