"""The faults of the self test, and a graph with a fault in mid-pass that records the messages and their times."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from kr270_milling.cell.cell import Cell
from kr270_milling.live.graph.graph import CELL, PLANNER, Graph
from kr270_milling.live.graph.processes import Child
from kr270_milling.recordings.bag.records import mcap_file
from kr270_milling.recordings.messages.topics import COMPENSATOR, CUT, RECORDER, ROBOT

WARN = 1
STOP = 2.0  # [s] between SIGSTOP and SIGCONT
ENDS, GOES_ON = "run ends", "pass continues"
#: words by which a message may name a node
NAMES = {
    ROBOT: (ROBOT, "robot"),
    CUT: (CUT, "cutting process"),
    COMPENSATOR: (COMPENSATOR, "compensator"),
    RECORDER: (RECORDER,),
}
Script = Iterator[float]  #: steps of a disturbance; each yields the pause [s] before the next step


class Message(NamedTuple):
    """A sentence and its arrival [s of the monotonic clock]."""

    at: float
    sentence: str


class Disturbed(Graph):
    """A graph; ``disturb`` takes a script that begins some seconds after the next pass starts."""

    def __init__(self, cell: Cell, out: Path, composed: bool = False):
        super().__init__(cell, out, composed=composed)
        self.messages: list[Message] = []
        self.beside: list[subprocess.Popen] = []  #: processes that are no nodes
        self.struck_at: float | None = None  #: [s of the monotonic clock]
        self.struck_wall_ns = 0
        self.recording = Path(out)
        self._script: Script | None = None
        self._next = 0.0

    def child(self, process: str) -> Child:
        """By the names of its nodes."""
        return next(child for child in self.children.values() if child.name == process)

    def disturb(self, script: Script, after: float) -> None:
        self.messages, self.struck_at = [], None
        self._script, self._next = self._delayed(script, after), 0.0

    def _delayed(self, script: Script, after: float) -> Script:
        while self.driver.value(ROBOT, "state") != "active" or self.driver.statuses[ROBOT].message != "pass running":
            yield 0.0
        yield after
        yield from script

    def run_pass(self, name: str):
        self.recording = self.out / name
        return super().run_pass(name)

    def check(self) -> None:
        if self._script is not None and time.monotonic() >= self._next:
            pause = next(self._script, None)
            self._script = None if pause is None else self._script
            self._next = time.monotonic() + (pause or 0.0)
        if self.struck_at is not None:
            self._take_messages()
        super().check()

    def _take_messages(self) -> None:
        """Warnings and errors since the fault."""
        for name, status in self.driver.statuses.items():
            sentence, at = f"{name}: {status.message}", self.driver.arrivals[name]
            known = any(sentence == message.sentence for message in self.messages)
            if status.level >= WARN and at > self.struck_at and not known:
                self.messages.append(Message(at, sentence))

    def warn(self, sentence: str) -> None:
        self.messages.append(Message(time.monotonic(), sentence))

    def struck(self) -> None:
        """The fault happens now."""
        self.struck_at, self.struck_wall_ns = time.monotonic(), time.time_ns()

    def strike(self, process: str, number: int) -> None:
        self.struck()
        self.child(process).signal(number)

    def stop(self) -> None:
        self._script = None
        for process in self.beside:
            process.kill()
            process.wait()
        super().stop()


@dataclass(frozen=True)
class Fault:
    """One row of the table."""

    name: str
    process: str  #: its nodes, of which the message must name one; empty: no node
    strike: Callable[[Disturbed], Script]
    reaction: str  #: ENDS or GOES_ON
    design: str  #: the reaction in a sentence
    named: bool = True  #: a message must name the node within 3 s
    composed: bool = False  #: robot and cut run in one process

    def names_it(self, sentence: str) -> bool:
        return not self.process or any(name in sentence for node in self.process.split("+") for name in NAMES[node])


def _kill(process: str):
    def strike(graph: Disturbed) -> Script:
        graph.strike(process, signal.SIGKILL)
        yield 0.0

    return strike


def _stop(process: str):
    def strike(graph: Disturbed) -> Script:
        graph.strike(process, signal.SIGSTOP)
        yield STOP
        graph.child(process).signal(signal.SIGCONT)

    return strike


def _fill_disk(graph: Disturbed) -> Script:
    """Limit the recorder's file to its present size plus 20 kB."""
    size = os.path.getsize(mcap_file(graph.recording)) + 20_000
    graph.struck()
    resource.prlimit(graph.children[RECORDER].pid, resource.RLIMIT_FSIZE, (size, size))
    yield 0.0


def _late_subscriber(graph: Disturbed) -> Script:
    """Start the live page in mid-pass."""
    graph.struck()
    watch = [sys.executable, "-m", "kr270_milling.cli", "watch", "--port", "0"]
    graph.beside.append(subprocess.Popen(watch, stdout=subprocess.DEVNULL, start_new_session=True))
    yield 0.0


CLOSED = "the run ends with a sentence; the recording is closed"
WAITED = "a warning; the others wait; same result"
CUT_OFF = "the run ends with a sentence; the file is cut off, at most the last second is missing"
QUEUED = "a warning; the publishers' histories keep the messages; missing messages are counted"
FULL = "the recorder stops at the last whole chunk and reports the error; the run ends"
ROBOT_AND_CUT, PLANNERS = "+".join(CELL), "+".join(PLANNER)

#: one process a node; ``composed``: two nodes in each process, as ``run`` starts them
FAULTS = (
    Fault(f"{ROBOT}, SIGKILL", ROBOT, _kill(ROBOT), ENDS, CLOSED),
    Fault(f"{CUT}, SIGKILL", CUT, _kill(CUT), ENDS, CLOSED),
    Fault(f"{COMPENSATOR}, SIGKILL", COMPENSATOR, _kill(COMPENSATOR), ENDS, CLOSED),
    Fault(f"{RECORDER}, SIGKILL", RECORDER, _kill(RECORDER), ENDS, CUT_OFF),
    Fault(f"{RECORDER}, SIGSTOP 2 s", RECORDER, _stop(RECORDER), GOES_ON, QUEUED),
    Fault("composed: robot and cut, SIGKILL", ROBOT_AND_CUT, _kill(ROBOT_AND_CUT), ENDS, CLOSED, composed=True),
    Fault("composed: compensator and recorder, SIGKILL", PLANNERS, _kill(PLANNERS), ENDS, CUT_OFF, composed=True),
    Fault("composed: robot and cut, SIGSTOP 2 s", ROBOT_AND_CUT, _stop(ROBOT_AND_CUT), GOES_ON, WAITED, composed=True),
    Fault("composed: disk full", RECORDER, _fill_disk, ENDS, FULL, composed=True),
    Fault("composed: late subscriber", "", _late_subscriber, GOES_ON, "same result", named=False, composed=True),
)
