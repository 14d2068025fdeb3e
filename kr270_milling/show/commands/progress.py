"""How far a command is, on standard error: a spinner and a bar on a terminal, elsewhere a line every few seconds."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

__all__ = ["Progress", "progress", "steps", "title_of", "weights_of"]

LINE_PERIOD = 5.0  #: [s] between two lines
LOOK_PERIOD = 0.2  #: [s] between two looks of the bar
MOST = 0.99  #: share that is shown before the end
EXPECTED = 3  #: passes of a step that says how many there are at most
SURE = 0.05  #: share of a step that is done before its own pace counts

#: seconds of a step from the seconds of a step of weight 1, or the weight
Weight = float | Callable[[float], float]


class Progress:
    """Share done and time left of a whole command, from the weights of its steps; the share never decreases.

    A step counts its work (done, total). The time left of a step that does not count, and of the steps that follow, is
    estimated from the pace so far. Time of compilation does not count for the pace.
    """

    def __init__(self, weights: Mapping[str, Weight]):
        self._waiting = dict(weights)
        self._single = len(weights) == 1
        self._seconds = self._weight = 0.0  # of the finished steps
        self._share = 0.0
        self._compiled = 0.0  # [s], in this step
        self._compiling = False
        self._start = self._looked = time.monotonic()
        self.label = ""
        self._begin("", 0.0, 1)

    def _begin(self, name: str, weight: Weight, passes: int) -> None:
        self._name, self._own, self._passes = name, weight, passes
        self._number, self._before, self._done, self._total = 1, 0, 0, 0
        self._step_start, self._compiled = time.monotonic(), 0.0
        self._counted = 0.0  # [s] in this step, at its first count

    @contextlib.contextmanager
    def __call__(self, name: str, passes: int | None = None, text: str = "") -> Iterator[Callable[[int, int], None]]:
        """Begin a step and yield its counter; a count that starts over belongs to the next of at most ``passes``.

        text: what is shown; default: the name.
        """
        self.label = text or name
        self._begin(name, self._waiting.pop(name, 0.0), passes or 1)
        yield self.count
        if not callable(self._own):
            self._weight += self._own * (self._part if self._total else 1.0)
            self._seconds += self._in_step
        self._begin("", 0.0, 1)

    def say(self, text: str) -> None:
        """Begin a step whose duration is not known."""
        self.label = text
        self._begin("", 0.0, 1)

    def under(self, title: str) -> Callable[..., contextlib.AbstractContextManager]:
        """The steps of one tool, whose names begin with ``title``."""
        return lambda name, passes=None, text="": self(title + name, passes, title + (text or name))

    def count(self, done: int, total: int) -> None:
        if not self._total:
            self._before, self._counted = done, self._in_step  # a study continues after its last chunk
        elif done < self._done:
            self._number += 1
        self._done, self._total = done, total

    def look(self) -> None:
        """Note whether another thread compiles now; called at every look of the display."""
        now, before = time.monotonic(), self._looked
        self._compiling, self._looked = is_compiling(), now
        if self._compiling:
            self._compiled += now - max(before, self._step_start)

    @property
    def _in_step(self) -> float:
        return time.monotonic() - self._step_start - self._compiled

    @property
    def _part(self) -> float:
        """Share of this step that is done."""
        expected = max(min(self._passes, EXPECTED), self._number)
        return min(1.0, (self._number - 1 + self._done / max(self._total, 1)) / expected)

    @property
    def left(self) -> float | None:
        """Time left [s]; None as long as no pace is known."""
        part, spent = self._part, self._in_step
        made = part - self._before / max(self._total, 1)
        paced = self._total > 0 and made > 0.0
        weight, seconds = self._weight, self._seconds
        if paced and not callable(self._own):  # the pace of this step, too
            weight, seconds = weight + made * self._own, seconds + spent - self._counted
        each = seconds / weight if weight > 0.0 else None
        own: float | None = None
        if paced and (made > SURE or each is None):
            own = (spent - self._counted) * (1.0 - part) / made
        elif each is not None:
            own = max(0.0, _seconds(self._own, each) * (1.0 - self._before / max(self._total, 1)) - spent)
        if own is None or (each is None and self._waiting):
            return None
        return own + sum(_seconds(one, each or 0.0) for one in self._waiting.values())

    @property
    def share(self) -> float:
        """Share of the time that is over; it never decreases."""
        left = self.left
        if left is not None:
            over = time.monotonic() - self._start
            now = self._part if self._single else over / max(over + left, 1e-9)
            self._share = max(self._share, min(MOST, now))
        return self._share

    @property
    def text(self) -> str:
        """Share done, time left and the present step; as long as no pace is known, the time so far."""
        left = self.left
        if left is None:
            state = f"{time.monotonic() - self._start:.0f} s so far"
        else:
            state = f"{100 * self.share:.0f} %, {left:.0f} s left"
        step = self.label + (f", pass {self._number}" if self._number > 1 or self._passes > 1 else "")
        step += f" of at most {self._passes}" if self._passes > 1 else ""
        return f"{state}: {step}{', compiling' if self._compiling else ''}"


def _seconds(weight: Weight, each: float) -> float:
    return weight(each) if callable(weight) else weight * each


def title_of(cell) -> str:
    """What begins the names of the steps of one of several tools."""
    return f"{cell.stage.tool}: " if cell.stage else ""


def weights_of(cells: Sequence, of: Callable) -> dict[str, Weight]:
    """Return the weights of the steps of all tools of a program; of(cell): those of one tool, in its passes."""
    weights: dict[str, Weight] = {}
    for cell in cells:
        share = 1.0 if len(cells) == 1 else cell.programmed.cutting_time / cells[0].programmed.cutting_time
        weights |= {title_of(cell) + name: _scaled(weight, share) for name, weight in of(cell).items()}
    return weights


def _scaled(weight: Weight, share: float) -> Weight:
    return (lambda each: weight(share * each)) if callable(weight) else share * weight


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
def progress(text: str) -> Iterator[Callable[[int, int], None]]:
    """Yield the counter of a command with a single step."""
    with steps({text: 1.0}) as whole, whole(text) as count:
        yield count


@contextlib.contextmanager
def steps(weights: Mapping[str, Weight]) -> Iterator[Progress]:
    """Yield the progress of a command with these steps, and show it; see Progress."""
    whole = Progress(weights)
    on_terminal = sys.stderr.isatty()
    ended = threading.Event()
    with _bar(whole) if on_terminal else contextlib.nullcontext(lambda: _line(whole)) as show:

        def refresh() -> None:
            shown = time.monotonic()
            while not ended.wait(min(LOOK_PERIOD, LINE_PERIOD)):
                whole.look()
                if on_terminal or time.monotonic() - shown >= LINE_PERIOD:
                    shown = time.monotonic()
                    show()

        thread = threading.Thread(target=refresh, daemon=True)
        thread.start()
        try:
            yield whole
        finally:
            ended.set()
            thread.join()


def _line(whole: Progress) -> None:
    print(whole.text, file=sys.stderr, flush=True)


@contextlib.contextmanager
def _bar(whole: Progress) -> Iterator[Callable[[], None]]:
    """Yield the function that updates the bar."""
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn
    from rich.progress import Progress as Bar

    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(bar_width=24)
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(whole.label, total=1.0)
        yield lambda: bar.update(task, completed=whole.share, description=whole.text)
