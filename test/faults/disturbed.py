"""A graph with a disturbance in mid-pass; it records the messages and their times."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from kr270_milling.cell.cell import Cell
from kr270_milling.live.graph.graph import Graph
from kr270_milling.live.graph.processes import Child
from kr270_milling.recordings.messages.topics import ROBOT

__all__ = ["Disturbed", "Message"]

WARN = 1


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
        self._script: Iterator[float] | None = None
        self._next = 0.0

    def child(self, process: str) -> Child:
        """By the names of its nodes."""
        return next(child for child in self.children.values() if child.name == process)

    def disturb(self, script: Iterator[float], after: float) -> None:
        self.messages, self.struck_at = [], None
        self._script, self._next = self._delayed(script, after), 0.0

    def _delayed(self, script: Iterator[float], after: float) -> Iterator[float]:
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

    def end_beside(self) -> None:
        for process in self.beside:
            process.kill()
            process.wait()
        self.beside.clear()

    def stop(self) -> None:
        self._script = None
        self.end_beside()
        super().stop()
