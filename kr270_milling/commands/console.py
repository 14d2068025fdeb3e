"""What every command shares: arguments, JSON, tables, progress."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import shlex
import sys
import time
from pathlib import Path

__all__ = [
    "EXIT_FAILED", "add_cell", "add_common", "command_line", "fixed", "joints_text", "numbers", "output_directory",
    "print_json", "print_table", "progress",
]  # fmt: skip

EXIT_FAILED = 1  # what was asked was done, and the answer is no

LINE_PERIOD = 3.0  #: [s] between two lines of progress


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


def output_directory(path: str) -> Path:
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


def print_table(title: str, columns: list[str], rows: list[list[str]]) -> None:
    """First column left, the others right; plain text where the output is not a terminal."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left")
    for i, name in enumerate(columns):
        table.add_column(Text(name), justify="left" if i == 0 else "right", no_wrap=i > 0)
    for row in rows:
        table.add_row(*map(Text, row))
    console = Console(soft_wrap=not sys.stdout.isatty(), width=None if sys.stdout.isatty() else 100)
    console.print(table)


@contextlib.contextmanager
def progress(text: str):
    """Yields ``report(done, total)``: a bar with a time estimate on a terminal, nothing elsewhere."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextlib.contextmanager
def study_progress(what: str, each: int):
    """Yields ``report(done, total)`` of chunks with ``each`` rows: rate and time left, a line every few seconds."""
    start = last = time.monotonic()
    before = None

    def report(done: int, total: int) -> None:
        nonlocal last, before
        before = done - 1 if before is None else before
        now = time.monotonic()
        if now - last < LINE_PERIOD and done < total:
            return
        last = now
        rate = (done - before) / (now - start)
        print(
            f"{done} of {total} chunks, {rate * each:.3g} {what} a second, {(total - done) / rate:.0f} s left",
            file=sys.stderr,
        )

    yield report
