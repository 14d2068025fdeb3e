"""Which passes a run makes: the original one, then those of every method, each scored from its recording."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.compensation.compensator import Compensator
from kr270_milling.graph.graph import Graph, PassRun
from kr270_milling.replay.recorded import pass_from_recording

__all__ = ["RanPass", "fresh_directory", "run_plan"]


@dataclasses.dataclass(frozen=True, eq=False)
class RanPass:
    """A row of the table."""

    run: PassRun
    scored: ScoredPass
    messages_lost: int
    learning: tuple[RanPass, ...] = ()  #: every pass of a method that repeats; the row itself is the best of them

    def row(self) -> dict:
        """Keys as the command prints them."""
        duration = float(self.scored.result.time[-1])
        row = {
            **self.scored.row(),
            "recording": str(self.run.recording),
            "duration_s": duration,
            "wall_s": self.run.wall_s,
            "real_time_factor": duration / self.run.wall_s,
            "messages_lost": self.messages_lost,
        }
        return {**row, "learning": [ran.row() for ran in self.learning]} if self.learning else row


def fresh_directory(out) -> Path:
    """``out`` itself, or a new ``out/run_N`` where it holds recordings already: none is ever overwritten."""
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    if not any(out.glob("*/*.mcap")) and not (out / "cell.yaml").exists():
        return out
    for number in range(2, 100_000):
        try:
            (out / f"run_{number}").mkdir()
        except FileExistsError:
            continue
        return out / f"run_{number}"
    raise FileExistsError(f"{out}: holds too many runs")


def run_plan(
    graph: Graph,
    methods: Sequence[str],
    passes: int | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> list[RanPass]:
    """The original pass, then each method's; passes: how many in all, the original included (default: as needed).

    say: called with a sentence at the beginning of each pass.
    """
    numbers = itertools.count(1)
    most = _most_passes(graph.cell, methods, passes)

    def run(name: str) -> RanPass:
        say(f"{name}, pass {next(numbers)} of at most {most}")
        told = graph.run_pass(name)
        found = pass_from_recording(told.recording, name, graph.driver.namespace)
        return RanPass(told, found.scored, found.lost_to_end)

    original = run("original")
    rows = [original]
    for method in methods:
        if passes is not None and passes < 2:
            break
        graph.choose(method)
        if graph.repeats:
            rows.append(_repeated(method, run, original, passes and passes - 1))
            continue
        for number in range(1, passes or 2):
            rows.append(run(method if number == 1 else f"{method}_{number}"))
    return rows


def _most_passes(cell: Cell, methods: Sequence[str], passes: int | None) -> int:
    """How many passes there can be in all."""
    if passes is not None:
        return 1 + len(methods) * (passes - 1)
    asked = (Compensator(cell.compensation, cell.target(), method).most_passes for method in methods)
    return 1 + sum(1 if most is None else most for most in asked)


def _repeated(method: str, run: Callable[[str], RanPass], original: RanPass, most: int | None) -> RanPass:
    """Passes until the compensator is finished, or ``most``; the one along the best reference counts."""
    tried: list[RanPass] = []
    while not (tried and tried[-1].run.finished) and (most is None or len(tried) < most):
        tried.append(run(f"{method}_{len(tried) + 1}"))
    errors = tried[-1].run.errors  # the first is that of the original pass
    best = [original, *tried][min(range(len(errors)), key=errors.__getitem__)]
    named = dataclasses.replace(best.scored, name=method)
    return dataclasses.replace(best, scored=named, learning=tuple(tried))
