"""What a command is, and how it becomes one of a parser."""

from __future__ import annotations

import argparse
import functools
import importlib
from typing import NamedTuple

__all__ = ["Command", "Group", "add_command", "command", "option"]


class Group(NamedTuple):
    """Options under a title of their own; without one only one of them may be given."""

    title: str | None
    options: tuple


class Command(NamedTuple):
    """run: module.function below ``commands``; note: behind the example; parts: sub-commands by name."""

    run: str
    example: str
    text: str
    options: tuple
    note: str
    parts: dict[str, Command]


def command(run: str, example: str, text: str, *options, note: str = "", parts: dict | None = None) -> Command:
    return Command(run, example, text, options, note, parts or {})


def option(names: str, text: str, kind=None, default=None, **more) -> tuple[tuple[str, ...], dict]:
    """Names and keywords for ``add_argument`` of "--seed N", of the switch "--robust" (kind bool) or of the argument
    "cell CELL.yaml"; the help says the default."""
    name, _, metavar = names.partition(" ")
    if kind is bool:
        return (name,), dict(action="store_true", help=text)
    if default and "default" not in text:
        text += f" (default: {default:g})" if isinstance(default, (int, float)) else f" (default: {default})"
    return (name,), dict(metavar=metavar or None, type=kind, default=default, help=text, **more)


def add_command(sub, name: str, of: Command, filled: bool = True, json_default=False, **more) -> None:
    """Add a command to the sub-parsers ``sub``; with its own options only where it is the one that was chosen."""
    epilog = f"example: kr270_milling {of.example}" + (f"\n{of.note}" if of.note else "")
    parser = sub.add_parser(name, description=of.text[0].upper() + of.text[1:] + ".", epilog=epilog, **more)
    if not filled:
        return
    _add(parser, of.options)
    if of.parts:
        below = parser.add_subparsers(dest="what", metavar="WHAT", required=True, help="each has --help and --json")
        for key, part in of.parts.items():
            add_command(below, key, part, json_default=argparse.SUPPRESS, help=part.text)
    text = "print one JSON object to standard output"
    parser.add_argument("--json", help=text, action="store_true", default=json_default)
    parser.set_defaults(run=functools.partial(_run, of.run))


def _run(place: str, args: argparse.Namespace):
    """Only now is the command imported."""
    module, _, function = place.rpartition(".")
    return getattr(importlib.import_module(f"kr270_milling.commands.{module}"), function)(args)


def _add(parser, options: tuple) -> None:
    for one in options:
        if isinstance(one, Group):
            _add(parser.add_argument_group(one.title) if one.title else parser.add_mutually_exclusive_group(), one[1])
        else:
            parser.add_argument(*one[0], **one[1])
