"""How far a command is, on standard error: a spinner and a bar on a terminal, elsewhere a line every few seconds."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator

__all__ = ["Progress", "progress"]

LINE_PERIOD = 5.0  #: [s] between two lines
LOOK_PERIOD = 0.2  #: [s] between two looks of the bar


class Progress:
    """Called with (done, total) where that is counted; a count that starts over belongs to the next pass.

    most: passes that there can be.
    """

    def __init__(self, text: str, most: int | None = None):
        self.most = most
        self._number = 1
        self.say(text)

    def say(self, text: str) -> None:
        """Start another step; nothing of it is counted yet."""
        self.text = text
        self.done = 0
        self.total: int | None = None
        self._begin(0)

    def _begin(self, done: int) -> None:
        self._start, self._before = time.monotonic(), done

    def __call__(self, done: int, total: int) -> None:
        if self.total is None:
            self._begin(done)  # a study continues after its last chunk
        elif done < self.done:
            self._number += 1
            self._begin(done)
        self.done, self.total = done, total

    @property
    def label(self) -> str:
        """The step, with the number of the pass if there are several."""
        if self.most is None:
            return self.text if self._number == 1 else f"{self.text}, pass {self._number}"
        return f"{self.text}, pass {self._number} of at most {self.most}"

    @property
    def state(self) -> str:
        """Share done and time left; the time so far if nothing is counted."""
        now = time.monotonic() - self._start
        if not self.total or not self._before < self.done < self.total:
            return f"{now:.0f} s so far{', compiling' if is_compiling() else ''}"
        left = now * (self.total - self.done) / (self.done - self._before)
        return f"{100 * self.done / self.total:.0f} %, {left:.0f} s left"


def is_compiling() -> bool:
    """Whether another thread compiles now: the first run after an installation does so for some 15 s."""
    compiler = sys.modules.get("numba.core.compiler_lock")
    if compiler is None:
        return False
    lock = compiler.global_compiler_lock._lock  # noqa: SLF001, is_locked() sees the locks of this thread alone
    if free := lock.acquire(blocking=False):
        lock.release()
    return not free


@contextlib.contextmanager
def progress(text: str, most: int | None = None) -> Iterator[Progress]:
    """Yield the counter that a job calls; see Progress."""
    counter = Progress(text, most)
    on_terminal = sys.stderr.isatty()
    ended = threading.Event()
    with _bar(counter) if on_terminal else contextlib.nullcontext(lambda: _line(counter)) as show:

        def refresh() -> None:
            while not ended.wait(LOOK_PERIOD if on_terminal else LINE_PERIOD):
                show()

        thread = threading.Thread(target=refresh, daemon=True)
        thread.start()
        try:
            yield counter
        finally:
            ended.set()
            thread.join()


def _line(counter: Progress) -> None:
    print(f"{counter.label}: {counter.state}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def _bar(counter: Progress) -> Iterator[Callable[[], None]]:
    """Yield the function that updates the bar."""
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(bar_width=24)
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(counter.label, total=None)
        yield lambda: bar.update(
            task, completed=counter.done, total=counter.total, description=f"{counter.label}: {counter.state}"
        )
