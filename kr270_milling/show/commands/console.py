"""Functions that commands share: the result as JSON or as text and tables."""

from __future__ import annotations

import datetime
import json
import math
import shlex
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from rich import box
from rich.console import Console
from rich.measure import measure_renderables
from rich.table import Table as RichTable
from rich.text import Text

from kr270_milling.base.column import TextTable, fixed
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_failure

__all__ = [
    "Answer",
    "Colored",
    "command_line",
    "joints_text",
    "now",
    "output_directory",
    "print_json",
    "print_table",
    "say_replaced",
    "shown_path",
]

WIDEST = 1000  # characters of a table


class Colored(NamedTuple):
    """A line that a terminal shows in bold and in a colour; a file or a pipe receives the text alone."""

    text: str
    color: str

    def print(self) -> None:

        Console(soft_wrap=True).print(Text(self.text, style=f"bold {self.color}"))


@dataclass(frozen=True)
class Answer:
    """The result of a command; ``cli`` prints it."""

    result: Mapping  #: for --json
    shown: Iterable[object]  #: for the terminal: tables, and lines
    code: int = 0  #: exit code; 1: the command succeeded, and the answer is no

    def print(self, as_json: bool) -> int:
        """Print the result and return the exit code."""
        if as_json:
            print_json(self.result)
        for part in () if as_json else self.shown:
            if isinstance(part, TextTable):
                print_table(part)
            elif isinstance(part, Colored):
                part.print()
            else:
                print(part)
        return self.code


def joints_text(joints: dict) -> str:
    """Return the joints that a pass commands as a line; joints: of ``joint_ranges``."""
    ranges = zip(joints["start"], joints["min"], joints["max"], strict=True)
    shown = [f"A{k} {fixed(q)} ({fixed(low)} to {fixed(high)})" for k, (q, low, high) in enumerate(ranges, 1)]
    return f"commanded joints at the start (and along the path) [deg]: {', '.join(shown)}"


def now() -> str:
    """Date and time of a report, to the second."""
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")


def output_directory(path: str | Path) -> Path:
    """Create a directory to write into and return its path. Raises InputError."""
    directory = Path(path)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(directory, f"cannot be created ({write_failure(error, directory)})") from None
    return directory


def say_replaced(directory: str | Path) -> None:
    """Print on standard error that the report of an earlier run is replaced."""
    if Path(directory, "report.html").exists():
        print(f"{directory} holds a report already; it is replaced", file=sys.stderr)


def command_line(args) -> str:
    """Return the command line as typed; of an absolute path only the last name."""
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
    """Return a path relative to the working directory, if it is inside."""
    here = Path.cwd()
    place = Path(str(path))
    return str(place.relative_to(here)) if place.is_relative_to(here) else str(place)


def print_table(shown: TextTable) -> None:
    """Print a table, first column left, the others right.

    A table that is too wide for the terminal has no borders. It is never wrapped or cut off.
    """

    table = RichTable(title=Text(shown.title), title_justify="left")
    for i, name in enumerate(shown.columns):
        table.add_column(Text(name), justify="left" if i == 0 else "right", no_wrap=True)
    for row in shown.rows:
        table.add_row(*map(Text, row))
    console = Console(soft_wrap=True)
    wide = console.width if sys.stdout.isatty() else WIDEST
    console.width = WIDEST
    if measure_renderables(console, console.options, [table]).maximum > wide:
        table.box = box.SIMPLE_HEAD
        table.padding = (0, 1, 0, 0)
    console.print(table)
