"""The sensor side of RSI: receive the telegrams of one robot, answer within the cycle, report and record."""

from __future__ import annotations

import gc
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from kr270_milling.base.errors import InputError, MessageError, RecordingError
from kr270_milling.base.units import SECOND
from kr270_milling.live.rsi.corrector import Corrector
from kr270_milling.live.rsi.telegram import MOST_BYTES, RobotTelegram, read_telegram, write_answer

__all__ = ["AnsweredCycle", "Counts", "RsiSession", "open_socket"]

SILENCE = 1.0  #: [s] without a telegram after which the robot is reported as silent
POLL = 0.2  #: [s]


@dataclass(frozen=True, eq=False)
class AnsweredCycle:
    """One answered cycle, for the recording."""

    stamp: int  #: [ns], since the first telegram, by the counter of the robot
    actual: np.ndarray | None  #: RIst, (6,) [m, rad]
    correction: np.ndarray  #: RKorr, (6,) [m, rad]


@dataclass
class Counts:
    """Numbers of one session."""

    answered: int = 0
    repeated: int = 0  #: telegrams with the counter of the last one
    late: int = 0  #: answers that took longer than the cycle on this host
    missed: int = 0  #: cycles without a telegram
    refused: int = 0  #: telegrams that could not be read, or came from another sender
    most_delay: int = 0  #: largest Delay that the robot reported
    longest: float = 0.0  #: [s], from the receipt of a telegram to the answer
    total: float = 0.0  #: [s]
    first: str = ""  #: text of the first refused telegram


@dataclass
class RsiSession:
    """Answers one robot until ``stop`` is set, or until the robot is silent for SILENCE.

    report: receives sentences about changes of state. record: receives each ``AnsweredCycle`` after its answer is sent,
    in the rest of the cycle: a second thread would keep the interpreter while a telegram waits. After a RecordingError
    the session answers without a recording. from_actual: progress from RIst minus the correction instead of RSol.
    """

    connection: socket.socket
    corrector: Corrector
    cycle_ms: int
    report: Callable[[str], None]
    record: Callable[[AnsweredCycle], None] | None = None
    from_actual: bool = False
    stop: threading.Event = field(default_factory=threading.Event)
    recording_failed: bool = False  #: the file could not be written

    def __post_init__(self):
        self.counts = Counts()
        self._robot: tuple | None = None
        self._last: int | None = None  # IPOC
        self._first = 0
        self._reason = ""

    def run(self) -> Counts:
        """Answer telegrams; return the counts at the end."""
        self.connection.settimeout(POLL)
        latest = time.monotonic()
        gc.freeze()  # objects of the start are not searched again during the cycles
        while not self.stop.is_set():
            try:
                data, sender = self.connection.recvfrom(MOST_BYTES + 1)
            except TimeoutError:
                if self._robot is not None and time.monotonic() - latest > SILENCE:
                    self._lose_robot()
                continue
            received = time.monotonic()
            if self._robot is not None and sender != self._robot:
                self._refuse(f"a telegram from a second sender {sender[0]}:{sender[1]}")
                continue
            self._answer(data, sender, received)
            latest = received
        return self.counts

    def _answer(self, data: bytes, sender: tuple, received: float) -> None:
        try:
            telegram = read_telegram(data)
            point = self._point(telegram)
            if self._last is not None and telegram.ipoc < self._last:
                raise MessageError(f"IPOC {telegram.ipoc} after {self._last}")
        except MessageError as error:
            self._refuse(str(error))
            return
        if self._robot is None:
            self._robot, self._first = sender, telegram.ipoc
            self.report(f"robot {sender[0]}:{sender[1]} is connected")
        correction = self._correction(telegram, point)
        self.connection.sendto(write_answer(telegram.ipoc, correction), sender)
        took = time.monotonic() - received
        counts = self.counts
        counts.answered += 1
        counts.late += took > 1e-3 * self.cycle_ms
        counts.longest, counts.total = max(counts.longest, took), counts.total + took
        counts.most_delay = max(counts.most_delay, telegram.delay)
        self._record(AnsweredCycle((telegram.ipoc - self._first) * SECOND // 1000, telegram.actual, correction))
        if self.corrector.reason != self._reason:
            self._reason = self.corrector.reason
            self.report(f"{self._reason}, {1e3 * self.corrector.progress:.1f} mm of the path")

    def _correction(self, telegram: RobotTelegram, point: np.ndarray) -> np.ndarray:
        if telegram.ipoc == self._last:
            self.counts.repeated += 1
            return self.corrector.repeat()
        cycles = 1 if self._last is None else max(1, round((telegram.ipoc - self._last) / self.cycle_ms))
        self.counts.missed += cycles - 1
        self._last = telegram.ipoc
        return self.corrector.step(point, cycles)

    def _point(self, telegram: RobotTelegram) -> np.ndarray:
        if self.from_actual:
            if telegram.actual is None:
                raise MessageError("a telegram has no RIst")
            return telegram.actual[:3] - self.corrector.applied[:3]
        if telegram.commanded is None:
            raise MessageError("a telegram has no RSol")
        return telegram.commanded[:3]

    def _refuse(self, reason: str) -> None:
        if not self.counts.refused:
            self.counts.first = reason
            self.report(f"ignored: {reason}; further ones are counted")
        self.counts.refused += 1

    def _lose_robot(self) -> None:
        """Report the silent robot and end: the next program starts from the first point with a new session."""
        self.report(f"no telegram for {SILENCE:g} s")
        self.stop.set()

    def _record(self, cycle: AnsweredCycle) -> None:
        if self.record is None:
            return
        try:
            self.record(cycle)
        except RecordingError as error:
            self.record, self.recording_failed = None, True
            self.report(f"answers continue without a recording: {error}")


def open_socket(host: str, port: int) -> socket.socket:
    """Return a bound UDP socket; raise InputError."""
    connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        connection.bind((host, port))
    except OSError as error:
        connection.close()
        raise InputError(f"{host}:{port}", f"cannot be used ({error.strerror})") from None
    return connection
