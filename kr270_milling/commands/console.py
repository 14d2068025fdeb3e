"""What every command shares: arguments, JSON, tables, how paths are printed."""

from __future__ import annotations

import argparse
import json
import math
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

__all__ = [
    "EXIT_FAILED", "add_cell", "add_common", "command_line", "fixed", "joints_text", "numbers", "output_directory",
    "print_json", "print_table", "shown_path",
]  # fmt: skip

EXIT_FAILED = 1  # what was asked was done, and the answer is no
WIDEST = 1000  # characters of a table


def add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object to standard output")


def add_cell(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("cell", metavar="CELL.yaml", help="cell file, also a shipped one by its name")
    parser.add_argument(
        "--set", metavar="key=value", action="append", default=[], help="override a key, for example tool.teeth=2"
    )


def numbers(count: int, most: float = math.inf):
    """An argparse type: so many finite numbers of at most that size, separated by commas."""

    def parse(text: str) -> list[float]:
        try:
            values = [float(v) for v in text.split(",")]
        except ValueError:
            values = []
        if len(values) != count or not all(map(math.isfinite, values)):
            raise argparse.ArgumentTypeError(f"{text!r} is not {count} finite numbers separated by commas")
        if max(map(abs, values)) > most:
            raise argparse.ArgumentTypeError(f"{text!r} goes beyond {most:g}")
        return values

    return parse


def fixed(value: float, digits: int = 2) -> str:
    """A number with so many decimals; "-" for one that has no meaning (NaN)."""
    return "-" if math.isnan(value) else f"{round(value, digits) + 0.0:.{digits}f}"


def joints_text(joints: dict) -> str:
    """The joints that a pass commands, as ``joint_ranges`` gives them."""
    ranges = zip(joints["start"], joints["min"], joints["max"], strict=True)
    shown = [f"A{k} {fixed(q)} ({fixed(low)} to {fixed(high)})" for k, (q, low, high) in enumerate(ranges, 1)]
    return f"commanded joints at the start (and along the path) [deg]: {', '.join(shown)}"


def output_directory(path: str | Path) -> Path:
    directory = Path(path)
    directory.mkdir(parents=True, exist_ok=True)
    return directory


def command_line(args) -> str:
    """How the command was called, as it can be typed again; of a place on this machine only the last name is told."""
    words = ["kr270_milling"]
    for word in getattr(args, "argv", []):
        key, equals, value = word.partition("=")
        if equals and Path(value).is_absolute():
            word = f"{key}={Path(value).name}"
        words.append(Path(word).name if Path(word).is_absolute() else word)
    return shlex.join(words)


def print_json(value) -> None:
    """Strict JSON: numbers that are not finite become null."""
    print(json.dumps(_plain(value), indent=2, allow_nan=False))


def _plain(value):
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def shown_path(path: object) -> str:
    """A path as it is printed: from the working directory, where it is below it."""
    here = Path.cwd()
    place = Path(str(path))
    return str(place.relative_to(here)) if place.is_relative_to(here) else str(place)


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """First column left, the others right. No word and no number is ever squeezed: a table that is too wide for the
    terminal comes without borders, and is cut off by nothing."""
    from rich import box
    from rich.console import Console
    from rich.measure import measure_renderables
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left")
    for i, name in enumerate(columns):
        table.add_column(Text(name), justify="left" if i == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*map(Text, row))
    console = Console(soft_wrap=True)
    wide = console.width if sys.stdout.isatty() else WIDEST
    console.width = WIDEST
    if measure_renderables(console, console.options, [table]).maximum > wide:
        table.box = box.SIMPLE_HEAD
        table.padding = (0, 1, 0, 0)
    console.print(table)
