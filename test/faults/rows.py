"""Repeat every fault at times of a seeded generator; one row of the table for each fault."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from faults.aftermath import is_alive
from faults.disturbed import Disturbed
from faults.faults import ENDS, Fault
from faults.trial import TOO_LATE, Trial, run_trial
from kr270_milling.base.errors import MillingError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import Cell, read_cell
from kr270_milling.cell.jobs import compensator, record_of, simulate
from kr270_milling.physics.motion.milling_pass import PassResult

__all__ = ["Row", "expected_seconds", "fault_cell", "run_faults"]

#: a pass of 14,400 exchanges, at full speed longer than a stop of 2 s; twice as many for the faster composed graph
CELL = ("path.length_mm=120", "stock.max_mm=[120,12,0]", "stock.grid_step_um=50", "exchange.period_ms=0.125")
COMPOSED = (*CELL[:3], "exchange.period_ms=0.0625")
AFTER = (0.05, 0.8)  # [s] from the start of the pass to the fault
TRIES = 6  #: on a busy machine the pass may end before the fault
SECONDS = {True: 11.0, False: 9.0}  # [s] that a trial takes, with and without a separate graph
COLUMNS = ("fault", "repeats", "detected within max [s]", "named", "design", "orphans", "recording")


@dataclass(frozen=True)
class Row:
    """A fault with all its trials."""

    fault: Fault
    trials: tuple[Trial, ...]

    @property
    def problems(self) -> list[str]:
        return [f"trial {n}: {p}" for n, trial in enumerate(self.trials, 1) for p in trial.problems]

    def cells(self) -> list[str]:
        """As text, in the order of COLUMNS."""
        count, trials = len(self.trials), self.trials
        times = [t.detected_s for t in trials if t.detected_s is not None]
        named = f"{len(times)} of {count}" if self.fault.named else "-"
        failed = sum(bool(t.problems) for t in trials)
        design = self.fault.design + (f"; FAILED {failed} of {count}" if failed else "")
        orphans = str(sum(t.orphans for t in trials))
        slowest = f"{max(times):.2f}" if times else "-"
        return [self.fault.name, str(count), slowest, named, design, orphans, self._recording()]

    def _recording(self) -> str:
        recordings = [t.recording for t in self.trials if t.recording]
        if len(recordings) < len(self.trials) or not all(r.same for r in recordings):
            return "FAILED"
        lost, cut = sum(t.lost for t in self.trials), sum(r.cut_off for r in recordings)
        whole = sum(r.complete for r in recordings)
        state = "complete" if whole == len(recordings) else "complete up to the fault"
        if self.fault.reaction != ENDS and whole < len(recordings):
            state = f"{len(recordings) - whole} not whole"
        elif any(r.behind_s > 0.05 for r in recordings):
            state = f"readable, ends at most {max(r.behind_s for r in recordings):.2f} s before the fault"
        return f"{state}{f', cut off {cut} times' if cut else ''}, {f'lost and counted: {lost}' if lost else 'no hole'}"


class Undisturbed:
    """The passes of an undisturbed graph, computed in one process: each along the reference of the previous pass."""

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
        done = _Trials(fault, directory, plains[fault.composed])
        for repeat, after in enumerate(times):
            done.run(repeat, after)
            progress(number * repeats + repeat + 1, len(faults) * repeats)
        done.end()
        rows.append(Row(fault, tuple(done.trials)))
    return rows


class _Trials:
    """All trials of a fault, in one graph while it runs."""

    def __init__(self, fault: Fault, out: Path, plain: Undisturbed):
        self.fault, self.out, self.plain = fault, out, plain
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
        self._graph = Disturbed(self.plain.cell, directory, self.fault.composed)
        return self._graph.__enter__()

    def end(self) -> None:
        """Close the graph and count the processes that are left."""
        graph, self._graph = self._graph, None
        if graph is None:
            return
        pids = [child.pid for child in graph.children.values()]
        graph.stop()
        if self.trials:
            last = self.trials[-1]
            last.orphans = sum(map(is_alive, set(pids)))
            last.problems += [f"{last.orphans} processes are left"] if last.orphans else []
