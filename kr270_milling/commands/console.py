"""What commands have in common: the cell that is asked about, and the answer as JSON or as text and tables."""

from __future__ import annotations

import datetime
import json
import math
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from kr270_milling.base.parameter_file import find_file

__all__ = [
    "Answer", "Table", "cell_of", "command_line", "fixed", "joints_text", "now", "output_directory", "plant_of",
    "print_json", "print_table", "shown_path", "table_of", "um", "yes",
]  # fmt: skip

WIDEST = 1000  # characters of a table


class Table(NamedTuple):
    """As ``print_table`` takes it."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Answer:
    """What a command has found; ``cli`` prints it."""

    found: Mapping  #: for --json
    shown: Iterable[object]  #: for people: tables, and what is printed as a line
    code: int = 0  #: exit code; 1: what was asked was done, and the answer is no

    def tell(self, as_json: bool) -> int:
        """Print it; returns the exit code."""
        if as_json:
            print_json(self.found)
        for part in () if as_json else self.shown:
            if isinstance(part, Table):
                print_table(*part)
            else:
                print(part)
        return self.code


def cell_of(args):
    """The cell of a command line with ``cell`` and ``--set``."""
    from kr270_milling.cell.cell import read_cell

    return read_cell(find_file(args.cell), args.set)


def plant_of(args, cell):
    """The plant of ``--plant`` and ``--noise-um``; None where the model itself cuts, and perfectly."""
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.cell.plant import Plant

    cuts = read_cell(find_file(args.plant)) if args.plant else cell
    how = cuts.imperfections
    if args.noise_um is not None:
        how = how.replace(pose_noise=1e-6 * args.noise_um)
    perfect = not (how.pose_noise or how.repeatability or how.backlash.any())
    return None if perfect and not args.plant else Plant(cell, cuts, how)


def table_of(title: str, columns: Sequence[tuple], rows: Iterable[Mapping]) -> Table:
    """A table of records; columns: heading, key, and the decimals of the number or what makes a text of the value."""
    texts = [[_text(row[key], how) for _, key, how in columns] for row in rows]
    return Table(title, [heading for heading, *_ in columns], texts)


def _text(value, how: int | Callable[[Any], str]) -> str:
    if callable(how):
        return how(value)
    return value if isinstance(value, str) else fixed(value, how)


def fixed(value: float, digits: int = 2) -> str:
    """A number with so many decimals; "-" for one that has no meaning (NaN)."""
    return "-" if math.isnan(value) else f"{round(value, digits) + 0.0:.{digits}f}"


def um(length_mm: float) -> str:
    """A length [mm] in micrometres."""
    return fixed(1e3 * length_mm)


def yes(value: bool) -> str:
    return "yes" if value else "no"


def joints_text(joints: dict) -> str:
    """The joints that a pass commands, as ``joint_ranges`` gives them."""
    ranges = zip(joints["start"], joints["min"], joints["max"], strict=True)
    shown = [f"A{k} {fixed(q)} ({fixed(low)} to {fixed(high)})" for k, (q, low, high) in enumerate(ranges, 1)]
    return f"commanded joints at the start (and along the path) [deg]: {', '.join(shown)}"


def now() -> str:
    """Date and time of a report, to the second."""
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


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
    from rich.table import Table as RichTable
    from rich.text import Text

    table = RichTable(title=Text(title), title_justify="left")
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
