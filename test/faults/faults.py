"""The faults of the self test, and a graph with a fault in mid-pass that records the messages and their times."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from kr270_milling.cell.cell import Cell
from kr270_milling.live.graph import CELL, PLANNER, Child, Graph
from kr270_milling.recordings.bag.files import find_recording
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


class Message(NamedTuple):
    """A sentence and its arrival [s of the monotonic clock]."""

    at: float
    sentence: str


class Disturbed(Graph):
    """A graph; ``strike`` disturbs the graph ``after`` seconds from the start of its pass."""

    def __init__(self, cell: Cell, out: Path, composed: bool, strike: Callable[[Disturbed], None], after: float):
        super().__init__(cell, out, composed=composed)
        self.messages: list[Message] = []
        self.beside: list[subprocess.Popen] = []  #: processes that are no nodes
        self.struck_at: float | None = None  #: [s of the monotonic clock]
        self.struck_wall_ns = 0
        self.recording = Path(out)
        self._strike = strike
        self._after = after
        self._running_at: float | None = None  # [s of the monotonic clock]

    def child(self, process: str) -> Child:
        """By the names of its nodes."""
        return next(child for child in self.children.values() if child.name == process)

    def run_pass(self, name: str):
        self.recording = self.out / name
        return super().run_pass(name)

    def check(self) -> None:
        now = time.monotonic()
        if self.struck_at is not None:
            self._take_messages()
        elif self._running_at is not None:
            if now >= self._running_at + self._after:
                self.struck_at, self.struck_wall_ns = now, time.time_ns()
                self._strike(self)
        elif self._in_pass and self.driver.reports[ROBOT].message == "pass running":
            self._running_at = now
        super().check()

    def _take_messages(self) -> None:
        """Warnings and errors since the fault."""
        for name, report in self.driver.reports.items():
            sentence, at = f"{name}: {report.message}", self.driver.arrivals[name]
            known = any(sentence == message.sentence for message in self.messages)
            if report.level >= WARN and at > self.struck_at and not known:
                self.messages.append(Message(at, sentence))

    def warn(self, sentence: str) -> None:
        self.messages.append(Message(time.monotonic(), sentence))

    def stop(self) -> None:
        for process in self.beside:
            process.kill()
            process.wait()
        super().stop()


@dataclass(frozen=True)
class Fault:
    """One row of the table."""

    name: str
    process: str  #: its nodes, of which a message must name one within 3 s; empty: no node
    strike: Callable[[Disturbed], None]
    reaction: str  #: ENDS or GOES_ON
    design: str  #: the reaction in a sentence
    composed: bool = False  #: robot and cut run in one process

    def is_named_in(self, sentence: str) -> bool:
        return any(name in sentence for node in self.process.split("+") for name in NAMES[node])


def _kill(process: str):
    return lambda graph: graph.child(process).signal(signal.SIGKILL)


def _stop(process: str):
    def strike(graph: Disturbed) -> None:
        child = graph.child(process)
        child.signal(signal.SIGSTOP)
        threading.Timer(STOP, child.signal, [signal.SIGCONT]).start()

    return strike


def _fill_disk(graph: Disturbed) -> None:
    """Limit the recorder's file to its present size plus 20 kB."""
    size = os.path.getsize(find_recording(graph.recording)) + 20_000
    resource.prlimit(graph.children[RECORDER].pid, resource.RLIMIT_FSIZE, (size, size))


SUBSCRIBER = """
import rclpy
from geometry_msgs.msg import PoseStamped
rclpy.init()
node = rclpy.create_node("late")
node.create_subscription(PoseStamped, "tool_pose", print, 100)
rclpy.spin(node)
"""


def _start_subscriber(graph: Disturbed) -> None:
    """Start a subscriber of every pose in mid-pass."""
    late = subprocess.Popen([sys.executable, "-c", SUBSCRIBER], stdout=subprocess.DEVNULL, start_new_session=True)
    graph.beside.append(late)


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
    Fault("composed: late subscriber", "", _start_subscriber, GOES_ON, "same result", composed=True),
)
