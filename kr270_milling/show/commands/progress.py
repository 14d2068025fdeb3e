"""Progress of a command on standard error: a bar a step on a terminal, elsewhere a line every few seconds."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TextColumn
from rich.progress import Progress as Bar

__all__ = ["Progress", "progress", "steps", "title_of"]

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
