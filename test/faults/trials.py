"""Repeat every fault at times of a seeded generator; compare reaction and recording with the design."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil

from faults.faults import ENDS, GOES_ON, Disturbed, Fault, Message
from kr270_milling.base.errors import MillingError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.replay.recorded import attached_cell
from kr270_milling.live.ros.node import NOT_COMPLETE
from kr270_milling.physics.motion.milling_pass import PassResult
from kr270_milling.recordings.bag.info import info
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.passes import series

#: a pass of 14,400 exchanges, at full speed longer than a stop of 2 s; twice as many for the faster composed graph
CELL = ("path.length_mm=120", "stock.max_mm=[120,12,0]", "stock.grid_step_um=50", "exchange.period_ms=0.125")
COMPOSED = (*CELL[:3], "exchange.period_ms=0.0625")
AFTER = (0.05, 0.8)  # [s] from the start of the pass to the fault
TRIES = 6  #: on a busy machine the pass may end before the fault
NAMED_WITHIN = 3.0  # [s] from the fault to a sentence that names the node
BEHIND = 1.0  # [s] before the fault that a recording may miss
CLOSE = 0.05  # [s] before the fault: a recording that ends later is complete up to the fault
COLUMNS = ("fault", "repeats", "detected within max [s]", "named", "design", "orphans", "recording")


@dataclass(frozen=True)
class Recorded:
    """A recording after a fault."""

    cut_off: bool
    started: bool  #: it has something of the pass: a pose or a wrench
    missing: int  #: holes in it, counted from the stamps
    short: int  #: messages of the whole pass that are missing
    behind_s: float  #: from its last pose to the fault [s of the wall clock]; 0 where the recording continues
    complete: bool  #: it has every message of the pass
    same: bool  #: every pose, wrench and deflection in it is that of the undisturbed pass, bit for bit


@dataclass
class Trial:
    """Result of a trial; ``problems`` is empty where the reaction is the designed one."""

    detected_s: float | None = None  #: from the fault to the sentence that names the node
    reaction: str = ""
    recording: Recorded | None = None
    orphans: int = 0
    problems: list[str] = field(default_factory=list)

    @property
    def lost(self) -> int:
        """Number of messages that are counted as missing in the recording."""
        if self.recording is None:
            return 0
        return self.recording.short if self.reaction == GOES_ON else self.recording.missing


def read_back(path: Path, expected: PassResult, struck_ns: int, started_ns: int) -> Recorded:
    """struck_ns, started_ns: of the fault and of the pass [ns of the wall clock]. Raises RecordingError."""
    values_of = {"/tool_pose": expected.tool, "/wrench": expected.wrench, "/deflection": expected.deflection}
    with Recording(path) as recording:
        about, every = info(recording), attached_cell(recording).publish.steps(attached_cell(recording).exchange)
        references = recording.messages(["/reference_trajectory"])
        stamps = expected.time_ns + next((stamp_of(message.data) or 0 for message in references), 0)
        same, short, started, ended = True, 0, False, True
        for topic, values in values_of.items():
            at, actual, _ = series(recording, topic)
            due = stamps[:: every if topic == "/deflection" else 1]
            started |= at.size > 0 and topic != "/deflection"
            ended &= bool(at.size and at[-1] == due[-1])
            short += due.size - np.unique(at).size
            same &= bool(np.isin(at, stamps).all())
            same = same and np.array_equal(actual[:, : values.shape[1]], values[np.searchsorted(stamps, at)])
        last = max((m.publish_time for m in recording.messages(["/tool_pose"])), default=started_ns)
    behind = max(0.0, (struck_ns - last) * 1e-9)
    return Recorded(about["cut_off"], started, about["missing"], short, behind, ended and not short, same)


def run_faults(faults: Sequence[Fault], repeats: int, seed: int, out: Path) -> Iterator[Row]:
    """Rows in the order of the faults; recordings and logs go to directories below ``out``."""
    chance = random.Random(seed)
    for number, fault in enumerate(faults, 1):
        cell = fault_cell(fault.composed)
        plain, trials = simulate(cell).result, []
        for repeat in range(repeats):
            place = out / f"fault_{number:02d}" / f"graph_{repeat + 1}"
            trials.append(run_trial(fault, cell, plain, place, chance.uniform(*AFTER), repeat == 0))
        yield Row(fault, tuple(trials))


def run_trial(fault: Fault, cell: Cell, plain: PassResult, out: Path, after: float, again: bool) -> Trial:
    """One pass of a graph with the fault in it, once more and earlier where the pass was over before the fault.

    plain: the undisturbed pass; again: recompute the recording.
    """
    for number in range(1, TRIES + 1):
        place = out if number == 1 else out.with_name(f"{out.name}_{number}")
        place.mkdir(parents=True)
        trial, graph = Trial(reaction=GOES_ON), Disturbed(cell, place, fault.composed, fault.strike, after)
        try:
            graph.start()
            graph.run_pass("pass")
        except MillingError as error:
            graph.warn(str(error))
            trial.reaction = ENDS
        finally:
            graph.stop()
        if trial.reaction == ENDS or graph.struck_at is not None:
            break
        after /= 2
    pids = {child.pid for child in graph.children.values()}
    states = [process.status() for process in psutil.process_iter() if process.pid in pids]
    trial.orphans = sum(state != psutil.STATUS_ZOMBIE for state in states)
    if trial.orphans:
        trial.problems.append(f"{trial.orphans} processes are left")
    if graph.struck_at is None:
        trial.problems.append(f"before the fault: {[message.sentence for message in graph.messages]}")
        return trial
    judge_words(trial, fault, graph.messages, graph.struck_at)
    struck = graph.struck_wall_ns
    try:
        trial.recording = read_back(graph.recording, plain, struck, struck - round(after * 1e9))
        judge_recording(trial, graph.messages, recompute(graph.recording).verdict if again else "")
    except MillingError as error:
        trial.problems.append(f"recording: {error}")
    return trial


def judge_words(trial: Trial, fault: Fault, messages: Sequence[Message], struck_at: float) -> None:
    sentences = [message.sentence for message in messages]
    if fault.process:
        naming = [m.at - struck_at for m in messages if m.at >= struck_at and fault.is_named_in(m.sentence)]
        trial.detected_s = min(naming, default=None)
        if not naming:
            trial.problems.append(f"not named; messages: {sentences}")
        elif naming[0] > NAMED_WITHIN:
            trial.problems.append(f"reported after {naming[0]:.2f} s")
    if trial.reaction != fault.reaction:
        trial.problems.append(f"{trial.reaction}: {sentences[-1] if sentences else 'no message'}")


def judge_recording(trial: Trial, messages: Sequence[Message], verdict: str) -> None:
    """verdict: of a recompute; empty where there was none."""
    recorded, goes_on = trial.recording, trial.reaction == GOES_ON
    reported = any(NOT_COMPLETE in message.sentence for message in messages)
    # of a recorder that was killed before it closed its first chunk of the pass there is nothing to compare
    due = "identical" if recorded.started or not recorded.cut_off else "incomplete"
    for wrong, problem in (
        (not recorded.same, "the recording differs from the undisturbed pass"),
        (verdict not in ("", due) and not (goes_on and trial.lost), f"recomputed: {verdict}"),
        (goes_on and not (recorded.complete or reported), "the recording lacks messages, and no message reports it"),
        (not goes_on and trial.lost, f"{trial.lost} messages are missing before the fault"),
        (recorded.behind_s > BEHIND, f"the recording ends {recorded.behind_s:.2f} s before the fault"),
    ):
        if wrong:
            trial.problems.append(problem)


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
        named = f"{len(times)} of {count}" if self.fault.process else "-"
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
        whole, behind = sum(r.complete for r in recordings), max(r.behind_s for r in recordings)
        state = "complete" if whole == len(recordings) else "complete up to the fault"
        if self.fault.reaction != ENDS and whole < len(recordings):
            state = f"{len(recordings) - whole} not whole"
        elif behind > CLOSE:
            state = f"readable, ends at most {behind:.2f} s before the fault"
        return f"{state}{f', cut off {cut} times' if cut else ''}, {f'lost and counted: {lost}' if lost else 'no hole'}"


def fault_cell(composed: bool = False) -> Cell:
    return read_cell(find_file("paper.yaml"), COMPOSED if composed else CELL)
