"""Functions that commands share: the result as JSON or as text and tables, and the bar of a long command."""

from __future__ import annotations

import contextlib
import datetime
import json
import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.measure import measure_renderables
from rich.progress import BarColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table as RichTable
from rich.text import Text

from kr270_milling.base.column import TextTable, fixed, json_value
from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_failure

WIDEST = 1000  # characters of a table


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
            elif isinstance(part, Text):  # a terminal shows its style; a file or a pipe receives the text alone
                Console(soft_wrap=True).print(part)
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
    print(json.dumps(json_value(value), indent=2, allow_nan=False))


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


LINE_PERIOD = 5.0  #: [s] between two lines
WAITING = 2.5  #: [s] without a count or a step, after which the text is the time so far; half a period of lines


class Progress:
    """Name, count and time left of the present step of a command; the pace is that of this step alone."""

    def __init__(self) -> None:
        self.say("")

    @contextlib.contextmanager
    def __call__(self, name: str, passes: int | None = None, text: str = "") -> Iterator[Callable[[int, int], None]]:
        """Begin a step and yield its counter; a count that starts again belongs to the next of at most ``passes``.

        text: shown name; default: the name.
        """
        self.say(text or name)
        self._passes = passes or 1
        yield self.count
        self.say("")

    def say(self, text: str) -> None:
        """Begin a step without a count."""
        self.label = text
        self.completed = self.total = 0
        self._before, self._number, self._passes = 0, 1, 1
        self.start = self._first = self._counted = time.monotonic()

    def under(self, title: str) -> Callable[..., contextlib.AbstractContextManager]:
        """Return the steps of one tool, whose names begin with ``title``."""
        return lambda name, passes=None, text="": self(name, passes, title + (text or name))

    def count(self, completed: int, total: int) -> None:
        """Note the work of this step: ``completed`` of ``total``. The first call states the work before the step."""
        if not self.total or completed < self.completed:
            self._number += bool(self.total)
            self._before, self._first = completed, time.monotonic()
        self.completed, self.total, self._counted = completed, total, time.monotonic()

    @property
    def under_way(self) -> bool:
        """Return whether a count runs that has not reached its total."""
        return self.completed < self.total

    @property
    def left(self) -> float | None:
        """Time left of this count [s]; None as long as its pace is not known."""
        since = self.completed - self._before
        return (time.monotonic() - self._first) * (self.total - self.completed) / since if since > 0 else None

    @property
    def text(self) -> str:
        """The step, its share and the time left.

        The time so far instead, as long as no pace is known, after the last count, and where the next count takes
        longer than the time left that the last one gave.
        """
        step = self.label or "working"
        if self._passes > 1:
            step += f", pass {self._number} of at most {self._passes}"
        left, so_far = self.left, f"{time.monotonic() - self.start:.0f} s so far"
        if left is None or not self.under_way:
            return f"{step}: {so_far}"
        if time.monotonic() - self._counted > max(left, WAITING):
            return f"{step}: {100 * self.completed / self.total:.0f} %, {so_far}"
        return f"{step}: {100 * self.completed / self.total:.0f} %, {left:.0f} s left"


def title_of(cell) -> str:
    """Title of the steps of one of several tools."""
    return f"{cell.stage.tool}: " if cell.stage else ""


@contextlib.contextmanager
def progress(text: str) -> Iterator[Callable[[int, int], None]]:
    """Yield the counter of a command with a single step."""
    with steps() as whole, whole(text) as count:
        yield count


@contextlib.contextmanager
def steps() -> Iterator[Progress]:
    """Yield the progress of a command and show it until the end of the context."""
    whole = Progress()
    on_terminal = sys.stderr.isatty()
    ended = threading.Event()
    with _bar(whole) if on_terminal else contextlib.nullcontext(lambda: _line(whole)) as show:

        def refresh() -> None:
            while not ended.wait(0.2 if on_terminal else LINE_PERIOD):
                show()

        thread = threading.Thread(target=refresh, daemon=True)
        thread.start()
        try:
            yield whole
        finally:
            ended.set()
            thread.join()


def _line(whole: Progress) -> None:
    if whole.label or time.monotonic() - whole.start > WAITING:  # between two steps
        print(whole.text, file=sys.stderr, flush=True)


@contextlib.contextmanager
def _bar(whole: Progress) -> Iterator[Callable[[], None]]:
    """Yield the function that updates the bar."""
    columns = SpinnerColumn(), BarColumn(bar_width=24), TextColumn("{task.description}", markup=False)
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(whole.label, total=None)
        yield lambda: bar.update(
            task, completed=whole.completed, total=whole.total if whole.under_way else None, description=whole.text
        )
