"""Every fault so many times, at times of a seeded generator; one row of the table each."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from faults.aftermath import is_alive
from faults.clock import SteppedClock, compiler
from faults.disturbed import Disturbed
from faults.faults import ENDS, Fault
from faults.trial import TOO_LATE, Trial, run_trial
from kr270_milling.base.errors import MillingError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import Cell, read_cell
from kr270_milling.cell.jobs import compensator, record_of, simulate
from kr270_milling.simulation.milling_pass import PassResult

__all__ = ["Row", "expected_seconds", "fault_cell", "run_faults"]

#: a pass of 14,400 exchanges, longer at full speed than a node is held; twice as many for a graph that is quicker
CELL = ("path.length_mm=120", "stock.max_mm=[120,12,0]", "stock.grid_step_um=50", "exchange.period_ms=0.125")
COMPOSED = (*CELL[:3], "exchange.period_ms=0.0625")
AFTER = (0.05, 0.8)  # [s] from the start of the pass to the fault
TRIES = 6  #: a busy machine may look so late that the pass is over before the fault
SECONDS = {True: 11.0, False: 9.0}  # [s] that a trial takes, with and without a graph of its own
COLUMNS = ("fault", "repeats", "detected within max [s]", "named", "others", "orphans", "litter", "recording")


@dataclass(frozen=True)
class Row:
    """A fault with all its trials."""

    fault: Fault
    trials: tuple[Trial, ...]
    skipped: str = ""  #: why it was not tried

    @property
    def problems(self) -> list[str]:
        return [f"trial {n}: {p}" for n, trial in enumerate(self.trials, 1) for p in trial.problems]

    def cells(self) -> list[str]:
        """As text, in the order of COLUMNS."""
        if self.skipped:
            return [self.fault.name, "0", "-", "-", f"skipped: {self.skipped}", "-", "-", "-"]
        count, trials = len(self.trials), self.trials
        times = [t.detected_s for t in trials if t.detected_s is not None]
        named = f"{len(times)} of {count}" if self.fault.told else "-"
        held = sum(not t.problems for t in trials)
        others = f"{self.fault.design}" + ("" if held == count else f"; FAILED {count - held} of {count}")
        orphans, litter = sum(t.orphans for t in trials), sum(t.litter for t in trials)
        slowest = f"{max(times):.2f}" if times else "-"
        return [self.fault.name, str(count), slowest, named, others, str(orphans), str(litter), self._recording()]

    def _recording(self) -> str:
        found = [t.recording for t in self.trials if t.recording]
        if len(found) < len(self.trials) or not all(r.same for r in found):
            return "FAILED"
        lost, cut = sum(t.lost for t in self.trials), sum(r.cut_off for r in found)
        whole = sum(r.complete for r in found)
        state = "complete" if whole == len(found) else "complete up to the fault"
        if self.fault.reaction != ENDS and whole < len(found):
            state = f"{len(found) - whole} not whole"
        elif any(r.behind_s > 0.05 for r in found):
            state = f"readable, ends at most {max(r.behind_s for r in found):.2f} s before the fault"
        return f"{state}{f', cut off {cut} times' if cut else ''}, {f'lost and counted: {lost}' if lost else 'no hole'}"

    def as_dict(self) -> dict:
        return {
            "fault": self.fault.name,
            "design": self.fault.design,
            "skipped": self.skipped,
            "failed": bool(self.problems),
            "problems": self.problems,
            "cells": dict(zip(COLUMNS, self.cells(), strict=True)),
            "trials": [trial.as_dict() for trial in self.trials],
        }


class Undisturbed:
    """The passes of a graph that nobody disturbs, in one process: each along the reference that the last one gave."""

    def __init__(self, cell: Cell):
        self.cell, self._passes = cell, [simulate(cell).result]
        self._compensator = compensator(cell, cell.target())

    def __getitem__(self, number: int) -> PassResult:
        while len(self._passes) <= number:
            reference = self._compensator.revise(record_of(self.cell, self._passes[-1]))
            self._passes.append(simulate(self.cell, reference).result)
        return self._passes[number]


def fault_cell(composed: bool = False) -> Cell:
    return read_cell(find_file("paper.yaml"), list(COMPOSED if composed else CELL))


def expected_seconds(faults: Sequence[Fault], repeats: int) -> float:
    return 5.0 + sum(SECONDS[fault.reaction == ENDS] * repeats for fault in faults)


def run_faults(
    faults: Sequence[Fault], repeats: int, seed: int, out: Path, progress: Callable[[int, int], None]
) -> list[Row]:
    """Rows in the order of the faults; recordings and logs go to directories below ``out``."""
    chance, rows = random.Random(seed), []
    plains = {composed: Undisturbed(fault_cell(composed)) for composed in {fault.composed for fault in faults}}
    for number, fault in enumerate(faults):
        times = [chance.uniform(*AFTER) for _ in range(repeats)]
        directory = out / f"fault_{number + 1:02d}"
        directory.mkdir()
        if fault.clock and compiler() is None:
            rows.append(Row(fault, (), "no C compiler to make a clock that can be set"))
            continue
        with SteppedClock(directory) if fault.clock else contextlib.nullcontext() as clock:
            done = _Trials(fault, directory, plains[fault.composed], clock)
            for repeat, after in enumerate(times):
                done.run(repeat, after)
                progress(number * repeats + repeat + 1, len(faults) * repeats)
            done.end()
        rows.append(Row(fault, tuple(done.trials)))
    return rows


class _Trials:
    """All trials of a fault: in one graph as long as it lives."""

    def __init__(self, fault: Fault, out: Path, plain: Undisturbed, clock: SteppedClock | None):
        self.fault, self.out, self.plain, self.clock = fault, out, plain, clock
        self.trials: list[Trial] = []
        self._graph: Disturbed | None = None
        self._passes = 0  # of this graph

    def run(self, repeat: int, after: float) -> None:
        try:
            graph = self._graph or self._begin(repeat)
            trial = self._try(graph, f"pass_{repeat + 1}", after, repeat == 0)
        except MillingError as error:  # of a graph that did not come up
            trial = Trial(self.fault.name, after, problems=[str(error)])
        except BaseException:
            self.end()
            raise
        self.trials.append(trial)
        if trial.reaction != self._goes_on or trial.problems:
            self.end()

    def _try(self, graph: Disturbed, name: str, after: float, again: bool) -> Trial:
        """Once more, and earlier, where the pass was over before the fault."""
        for number in range(1, TRIES + 1):
            plain = self.plain[self._passes]
            trial = run_trial(graph, self.fault, name if number == 1 else f"{name}_{number}", after, plain, again)
            self._passes += 1
            if trial.problems != [TOO_LATE]:
                break
            after /= 2
        return trial

    @property
    def _goes_on(self) -> str:
        return "" if self.fault.reaction == ENDS else self.fault.reaction

    def _begin(self, repeat: int) -> Disturbed:
        directory = self.out / f"graph_{repeat + 1}"
        directory.mkdir()
        self._passes = 0
        self._graph = Disturbed(self.plain.cell, directory, self.clock, self.fault.composed)
        return self._graph.__enter__()

    def end(self) -> None:
        """Close the graph and look at what is left of it."""
        graph, self._graph = self._graph, None
        if graph is None:
            return
        pids = [child.pid for child in graph.all_children()]
        graph.close()
        if self.trials:
            last = self.trials[-1]
            last.orphans = sum(map(is_alive, pids))
            litter = graph.litter()
            last.litter = len(litter)
            last.problems += [f"{last.orphans} processes are left"] if last.orphans else []
            last.problems += [f"left in shared memory: {', '.join(litter)}"] if litter else []
