"""A graph with a disturbance in mid-pass; it records the messages and their times."""

from __future__ import annotations

import dataclasses
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from kr270_milling.cell.cell import Cell
from kr270_milling.live.graph.graph import Graph
from kr270_milling.live.graph.processes import Child
from kr270_milling.live.graph.watchdog import ROBOT, Hooks

__all__ = ["Disturbed", "Message"]

WARN = b"\x01"


class Message(NamedTuple):
    """A sentence and its arrival [s of the monotonic clock]."""

    at: float
    sentence: str


class Disturbed(Hooks):
    """Context manager: a graph. ``disturb`` takes a script that begins some seconds after the next pass starts."""

    def __init__(self, cell: Cell, out: Path, composed: bool = False):
        self.graph = Graph(cell, out, hooks=self, composed=composed)
        self.messages: list[Message] = []
        self.beside: list[subprocess.Popen] = []  #: processes that are no nodes
        self.killed: list[Child] = []  #: and started again
        self.struck_at: float | None = None  #: [s of the monotonic clock]
        self.struck_wall_ns = 0
        self.recording = Path(out)
        self._script: Iterator[float] | None = None
        self._next = 0.0

    @property
    def children(self) -> dict[str, Child]:
        """By node."""
        return self.graph.children

    def child(self, process: str) -> Child:
        """By the names of its nodes."""
        return next(child for child in self.children.values() if child.name == process)

    def disturb(self, script: Iterator[float], after: float) -> None:
        self.messages, self.struck_at = [], None
        self._script, self._next = self._delayed(script, after), 0.0

    def _delayed(self, script: Iterator[float], after: float) -> Iterator[float]:
        driver = self.graph.driver
        while driver.value(ROBOT, "state") != "active" or driver.status(ROBOT).message != "pass running":
            yield 0.0
        yield after
        yield from script

    def run_pass(self, name: str):
        self.recording = self.graph.out / name
        return self.graph.run_pass(name)

    def before_check(self) -> None:
        if self._script is not None and time.monotonic() >= self._next:
            pause = next(self._script, None)
            self._script = None if pause is None else self._script
            self._next = time.monotonic() + (pause or 0.0)
        if self.struck_at is not None:
            self._take_messages()

    def _take_messages(self) -> None:
        """Warnings and errors since the fault."""
        for name, status in list(self.graph.driver.statuses.items()):
            sentence = f"{name.rpartition('/')[2]}: {status.message}"
            known = any(sentence == message.sentence for message in self.messages)
            if status.level >= WARN and status.at > self.struck_at and not known:
                self.messages.append(Message(status.at, sentence))

    def warn(self, sentence: str) -> None:
        self.messages.append(Message(time.monotonic(), sentence))

    def struck(self) -> None:
        """The fault happens now."""
        self.struck_at, self.struck_wall_ns = time.monotonic(), time.time_ns()

    def strike(self, process: str, number: int) -> None:
        self.struck()
        self.child(process).signal(number)

    def restart(self, process: str, *more: str) -> None:
        """As a supervisor does: kill, and start again with the same arguments; the graph does not notice by itself."""
        graph, driver, killed = self.graph, self.graph.driver, self.child(process)
        self.strike(process, signal.SIGKILL)
        killed.process.wait()
        for _ in range(5):
            driver.spin()  # its last messages
        self.killed.append(killed)
        nodes, parameters, arguments = graph.spawned[process]
        before = {driver.name_of(name): driver.status(name) for name in nodes}
        graph.spawn(nodes, parameters, *arguments, *more)
        for name, status in before.items():
            values = {key: value for key, value in status.values.items() if key != "pid"}
            driver.statuses[name] = dataclasses.replace(status, values=values, at=time.monotonic())

    def end_beside(self) -> None:
        for process in self.beside:
            process.kill()
            process.wait()
        self.beside.clear()

    def all_children(self) -> list[Child]:
        return [*set(self.children.values()), *self.killed]

    def __enter__(self) -> Disturbed:
        self.graph.__enter__()
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        self._script = None
        self.end_beside()
        self.graph.close()
