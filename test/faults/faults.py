"""The faults of the self test: what is done to whom, what is said in return, and what the designed reaction is."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from faults.disturbed import Disturbed
from kr270_milling.bag.records import mcap_file
from kr270_milling.graph.graph import CELL, PLANNER
from kr270_milling.graph.watchdog import COMPENSATOR, CUT, RECORDER, ROBOT

__all__ = ["ENDS", "FAULTS", "GOES_ON", "Fault"]

HELD = 2.0  # [s] that a node is stopped
ENDS, GOES_ON = "run ends", "pass goes on"
#: in how many words a sentence may name a node
NAMES = {
    ROBOT: (ROBOT, "robot"),
    CUT: (CUT, "cutting process"),
    COMPENSATOR: (COMPENSATOR, "compensator"),
    RECORDER: (RECORDER,),
}
Script = Iterator[float]  #: does something, and yields after how many seconds to go on


@dataclass(frozen=True)
class Fault:
    """One row of the table."""

    name: str
    process: str  #: its nodes, of which one must be named; empty: nobody is at fault
    strike: Callable[[Disturbed], Script]
    reaction: str  #: ENDS or GOES_ON
    design: str  #: the reaction in a sentence
    told: bool = True  #: it must be said within 3 s
    clock: bool = False  #: the nodes run on a wall clock that can be set
    composed: bool = False  #: robot and cut run in one process

    def names_it(self, sentence: str) -> bool:
        return not self.process or any(name in sentence for node in self.process.split("+") for name in NAMES[node])


def _kill(process: str):
    def strike(graph: Disturbed) -> Script:
        graph.strike(process, signal.SIGKILL)
        yield 0.0

    return strike


def _hold(process: str):
    def strike(graph: Disturbed) -> Script:
        held = graph.child(process)
        graph.strike(process, signal.SIGSTOP)
        yield HELD
        held.signal(signal.SIGCONT)

    return strike


def _restart(process: str):
    def strike(graph: Disturbed) -> Script:
        graph.restart(process, *(("-p", "autostart:=true") if process.split("+")[0] in CELL else ()))
        yield 0.0

    return strike


def _fill_disk(graph: Disturbed) -> Script:
    """The recorder may not write beyond the present size of its file, but for 20 kB."""
    size = os.path.getsize(mcap_file(graph.recording)) + 20_000
    graph.struck()
    resource.prlimit(graph.children[RECORDER].pid, resource.RLIMIT_FSIZE, (size, size))
    yield 0.0


def _slow_disk(graph: Disturbed) -> Script:
    """The recorder is held up again and again, as by a write that does not return; harder, as it hears nothing."""
    held = graph.children[RECORDER]
    graph.struck()
    for _ in range(5):
        held.signal(signal.SIGSTOP)
        yield 0.3
        held.signal(signal.SIGCONT)
        yield 0.1


def _load(graph: Disturbed) -> Script:
    """Two busy processes a core, which end by themselves should we not be there to end them."""
    busy = "import time\nend = time.monotonic() + 20\nwhile time.monotonic() < end: pass"
    graph.struck()
    for _ in range(2 * (os.cpu_count() or 1)):
        graph.beside.append(subprocess.Popen([sys.executable, "-c", busy], start_new_session=True))
    yield 2.0
    graph.end_beside()


def _set_clock(graph: Disturbed) -> Script:
    """An hour back, for so long that a node whose timers wait for that hour counts as lost; then two on."""
    graph.struck()
    for offset, seconds in ((-3600.0, 3.0), (3600.0, 0.25), (0.0, 0.0)):
        graph.clock.set(offset)
        yield seconds


def _of_process(process: str, kill: str, hold: str, restart: str) -> list[Fault]:
    return [
        Fault(f"{process}, SIGKILL", process, _kill(process), ENDS, kill),
        Fault(f"{process}, SIGSTOP 2 s", process, _hold(process), GOES_ON, hold),
        Fault(f"{process}, restart", process, _restart(process), ENDS, restart),
    ]


CLOSED = "run ends with a sentence, recording is closed whole"
WAITED = "told as a warning, waited for, same result"
CUT_OFF = "run ends with a sentence; file is cut off, at most the last second is missing"
QUEUED = "told as a warning; queues keep what comes, what they cannot is counted"
RESTARTED = "told that it was restarted; it does not go on with the recording, nor overwrite it; run ends"

_MACHINE = (
    Fault("disk full", RECORDER, _fill_disk, ENDS, "recorder stops at the last whole chunk and says so; run ends"),
    Fault("slow disk", "", _slow_disk, GOES_ON, "queues keep what comes, what they cannot is counted", told=False),
    Fault("2x load", "", _load, GOES_ON, "slower, same result", told=False),
    Fault("clock set", "", _set_clock, GOES_ON, "no effect: time is the stamp", told=False, clock=True),
)
#: one process a node, then the two of a composed graph
FAULTS = (
    *_of_process(
        ROBOT, CLOSED, WAITED, "cutting process says that another robot came, or told that it was restarted; run ends"
    ),
    *_of_process(
        CUT, CLOSED, WAITED, "new cut has not seen the start and refuses, or told that it was restarted; run ends"
    ),
    *_of_process(
        COMPENSATOR, CLOSED, WAITED, "told that it was restarted, or that it has not heard the start; run ends"
    ),
    *_of_process(RECORDER, CUT_OFF, QUEUED, RESTARTED),
    *_MACHINE,
    *(
        replace(fault, name=f"composed: {fault.name}", composed=True)
        for fault in (
            *_of_process("+".join(CELL), CLOSED, WAITED, "told that it was restarted, or that another came; run ends"),
            *_of_process("+".join(PLANNER), CUT_OFF, QUEUED, RESTARTED),
            *_MACHINE,
        )
    ),
)
