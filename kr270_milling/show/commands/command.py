"""Commands with their options, and the parsers that they become.

A file of this folder has a dict ``COMMANDS``, name -> ``Command``. ``--help`` and the completion of a shell import that
file, so it imports numpy and the models inside its functions.
"""

from __future__ import annotations

import argparse
import functools
import importlib
from typing import NamedTuple

from kr270_milling.base.arguments import bounded, numbers

__all__ = [
    "CELL", "MOTIONS", "PLANT", "POSTURE", "RECORDING", "REFERENCE", "REMAP", "SELF_CONTAINED", "Command", "Group",
    "add_command", "command", "option",
]  # fmt: skip


class Group(NamedTuple):
    """Options under a title; without a title the options exclude each other."""

    title: str | None
    options: tuple


class Command(NamedTuple):
    """A command without its name and its line of help."""

    run: str  #: module.function in ``commands``
    example: str
    options: tuple
    note: str  #: printed after the example
    parts: dict[str, tuple[str, Command]]  #: name -> line of help, sub-command


def command(run: str, example: str, *options, note: str = "", parts: dict | None = None) -> Command:
    return Command(run, example, options, note, parts or {})


def option(names: str, text: str, kind=None, default=None, **more) -> tuple[tuple[str, ...], dict]:
    """Return names and keywords for ``add_argument``; the help states the default.

    names: "--seed N", the switch "--robust" (kind bool) or the argument "cell CELL.yaml".
    """
    name, _, metavar = names.partition(" ")
    if kind is bool:
        return (name,), dict(action="store_true", help=text)
    if default and "default" not in text:
        text += f" (default: {default:g})" if isinstance(default, (int, float)) else f" (default: {default})"
    return (name,), dict(metavar=metavar or None, type=kind, default=default, help=text, **more)


CELL = (
    option("cell CELL.yaml", "cell file, also a shipped one by its name"),
    option("--set key=value", "override a key, for example tool.teeth=2", default=[], action="append"),
)
PLANT = (
    option(
        "--plant PLANT.yaml",
        "cell file of the arm, material and imperfections that really cut; CELL.yaml is the model that plans",
    ),
    option(
        "--noise-um SIGMA",
        "standard deviation of each measured tool position along each axis (default: the plant's imperfections)",
        bounded(0.0, 1e4),
    ),
)
MOTIONS = ("LIN", "SPLINE")
POSTURE = numbers(6, most=720.0)
RECORDING = option("file FILE.mcap|DIR", "a recording, also one that was cut off")
SELF_CONTAINED = option(
    "--self-contained", "the page contains plotly.js instead of loading plotly.min.js next to it", bool
)
REMAP = option(
    "--remap NAME:=RECORDED",
    "our topic NAME was recorded as RECORDED, as wrench:=force/measured; may be given several times",
    default=[],
    action="append",
)
CELL_BESIDE = option("--cell CELL.yaml", "the cell, for a recording without it, as of ros2 bag record")
REFERENCE = option("--reference FILE.csv", "run along this trajectory, as written by compensate")


def add_command(sub, name: str, text: str, of: Command, json_default=False, **more) -> None:
    """Add a command with its options to the sub-parsers ``sub``; text: its line of help."""
    epilog = f"example: kr270_milling {of.example}" + (f"\n{of.note}" if of.note else "")
    parser = sub.add_parser(name, description=text[0].upper() + text[1:] + ".", epilog=epilog, **more)
    _add(parser, of.options)
    if of.parts:
        below = parser.add_subparsers(dest="what", metavar="WHAT", required=True, help="each has --help and --json")
        for key, (line, part) in of.parts.items():
            add_command(below, key, line, part, json_default=argparse.SUPPRESS, help=line)
    text = "print one JSON object to standard output"
    parser.add_argument("--json", help=text, action="store_true", default=json_default)
    parser.set_defaults(run=functools.partial(_run, of.run), parser=parser)


def _run(place: str, args: argparse.Namespace):
    """Import the function of a command and call it."""
    module, _, function = place.rpartition(".")
    return getattr(importlib.import_module(f"kr270_milling.show.commands.{module}"), function)(args)


def _add(parser, options: tuple) -> None:
    for one in options:
        if isinstance(one, Group):
            _add(parser.add_argument_group(one.title) if one.title else parser.add_mutually_exclusive_group(), one[1])
        else:
            parser.add_argument(*one[0], **one[1])
