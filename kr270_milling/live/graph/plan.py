"""The passes of a run: the original pass, then those of each method, each scored from its recording."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence

from kr270_milling.base.column import as_dict, column, computed
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.live.graph.graph import Graph, RunValues
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.settings import CompensationSettings

__all__ = ["RunRow", "run_plan"]


@dataclasses.dataclass(frozen=True, eq=False)
class RunRow:
    """A row of the table of a run."""

    run: RunValues
    scored: ScoredPass
    messages_lost: int = column("messages_lost", digits=0, short="lost")
    learning: tuple[RunRow, ...] = ()  #: every pass of a method that repeats; the row itself is the best of them

    @computed("duration_s")
    def duration(self) -> float:
        """Time of the pass [s]."""
        return float(self.scored.result.time[-1])

    @computed("wall_s", unit="s", digits=2, short="wall")
    def wall(self) -> float:
        """Time of the wall clock [s]."""
        return self.run.wall_s

    @computed("real_time_factor", digits=2, short="x real time")
    def real_time_factor(self) -> float:
        return self.duration / self.wall

    def row(self) -> dict:
        """Return the row with the keys that the command prints."""
        row = {**self.scored.row(), "recording": str(self.run.recording), **as_dict(self)}
        return {**row, "learning": [scored_pass.row() for scored_pass in self.learning]} if self.learning else row


def run_plan(
    graph: Graph,
    methods: Sequence[str],
    passes: int | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> list[RunRow]:
    """Run the original pass, then those of each method.

    passes: number of passes with the original (default: as needed)
    say: called with a sentence at the start of each pass.
    """
    numbers = itertools.count(1)
    most = _most_passes(graph.cell.compensation, path_of(graph.cell).target, methods, passes)

    def run(name: str) -> RunRow:
        say(f"{name}, pass {next(numbers)} of at most {most}")
        pass_run = graph.run_pass(name)
        scored_pass, recorded = pass_from_recording(pass_run.recording, name, graph.driver.namespace)
        return RunRow(pass_run, scored_pass, recorded.lost_to_end)

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


def _most_passes(settings: CompensationSettings, target: Trajectory, methods: Sequence[str], passes: int | None) -> int:
    """Return the largest possible number of passes."""
    if passes is not None:
        return 1 + len(methods) * (passes - 1)
    limits = (Compensator(settings, target, method).most_passes for method in methods)
    return 1 + sum(1 if most is None else most for most in limits)


def _repeated(method: str, run: Callable[[str], RunRow], original: RunRow, most: int | None) -> RunRow:
    """Run passes until the compensator is finished, at most ``most``; return the pass along the best reference."""
    tried: list[RunRow] = []
    while not (tried and tried[-1].run.finished) and (most is None or len(tried) < most):
        tried.append(run(f"{method}_{len(tried) + 1}"))
    errors = tried[-1].run.errors  # the first error is that of the original pass
    best = [original, *tried][min(range(len(errors)), key=errors.__getitem__)]
    named = dataclasses.replace(best.scored, name=method)
    return dataclasses.replace(best, scored=named, learning=tuple(tried))
