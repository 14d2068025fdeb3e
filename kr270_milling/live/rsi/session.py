"""The sensor side of RSI: receive the telegrams of one robot, answer the newest, report and record.

Elements of the telegram of the robot: RIst (actual pose), RSol (commanded pose), Delay (late answers), IPOC (cycle
counter [ms]). The answer carries RKorr and repeats the IPOC. Source: KUKA.RobotSensorInterface 3, object ETHERNET.
"""

from __future__ import annotations

import contextlib
import copy
import gc
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from kr270_milling.base.errors import InputError, MessageError, RecordingError
from kr270_milling.base.frames import WORKPIECE, quaternion_from_rotation, rotation_from_abc
from kr270_milling.base.samples import PoseSample, Text, TwistSample
from kr270_milling.base.units import SECOND
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.live.rsi.corrector import CorrectionTable, Corrector
from kr270_milling.live.rsi.telegram import (
    AXES,
    JOINTS,
    MOST_BYTES,
    Elements,
    RobotTelegram,
    read_telegram,
    write_answer,
)
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.physics.robot import jacobian, pose
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.codec import to_bytes, type_of


class RsiRecording(BagWriter):
    """Writes the topics ``target_trajectory``, ``reference_trajectory``, ``tool_pose``, ``correction``, ``rsi_status``.

    The stamps are the counter of the robot since the first telegram. attachments: name -> bytes, the cell and its
    files. now: the time of receipt [ns], which is the log time. Raises RecordingError.
    """

    def __init__(
        self,
        directory,
        table: CorrectionTable,
        metadata: Mapping[str, object],
        attachments: Mapping[str, bytes | str],
        now: Callable[[], int],
    ):
        super().__init__(directory, metadata=metadata, attachments=attachments)
        self._now = now
        time_ns = (table.time * SECOND).round().astype("int64")
        target = Trajectory(time_ns - time_ns[0], table.position, np.array(TOOL_DOWN))
        self._add("target_trajectory", target)
        self._add("reference_trajectory", target.with_position(table.position + table.correction[:, :3]))
        for topic, kind in (("tool_pose", PoseSample), ("correction", TwistSample)):  # not in the first cycle
            self.add_topic(f"/{topic}", type_of(kind))

    def add(self, stamp: int, actual: np.ndarray | None, correction: np.ndarray) -> None:
        """Record an answered cycle: stamp [ns], RIst and RKorr, (6,) [m, rad]."""
        if actual is not None:
            turn = quaternion_from_rotation(rotation_from_abc(actual[3:]))
            self._add("tool_pose", PoseSample(stamp, WORKPIECE, actual[:3], turn))
        a, b, c = correction[3:]
        self._add("correction", TwistSample(stamp, WORKPIECE, np.array([*correction[:3], c, b, a])))
        self.tick(time.monotonic())

    def note(self, sentence: str) -> None:
        """Record a sentence of the session; where the file cannot be written, ``add`` raises the error."""
        with suppress(RecordingError):
            self._add("rsi_status", Text(sentence))

    def _add(self, topic: str, record) -> None:
        self.add_topic(f"/{topic}", type_of(record))
        self.write(f"/{topic}", to_bytes(record), self._now())


SILENCE = 1.0  #: [s] without a telegram after which the robot is reported as silent
WRAP = 2**32  #: IPOC counts milliseconds in 32 bits
TIMESTAMP = getattr(socket, "SO_TIMESTAMPNS", 35)  # Linux, asm-generic/socket.h
TIME = struct.Struct("qq")  # timespec


@dataclass
class RsiSession:
    """Answers one robot until ``stop`` is set, or until the robot is silent for SILENCE.

    report: receives sentences about changes of state. record: receives each answered cycle after its answer is sent,
    in the rest of the cycle: a second thread would keep the interpreter while a telegram waits. Its arguments are the
    stamp since the first telegram by the counter of the robot [ns], RIst, and RKorr, (6,) [m, rad]. After a
    RecordingError the session answers without a recording. from_actual: progress from RIst minus the correction
    instead of RSol, as where the robot does not send RSol.
    """

    connection: socket.socket
    corrector: Corrector
    cycle_ms: int
    report: Callable[[str], None]
    record: Callable[[int, np.ndarray | None, np.ndarray], None] | None = None
    from_actual: bool = False
    elements: Elements = field(default_factory=Elements)
    arm: PlacedArm | None = None  #: for corrections of joints, and for a robot that sends joint positions alone
    stop: threading.Event = field(default_factory=threading.Event)
    recording_failed: bool = False  #: the file could not be written
    answered: int = 0  #: telegrams
    repeated: int = 0  #: telegrams with the counter of the last one
    late: int = 0  #: answers that left this host later than a cycle after the arrival of the telegram
    missed: int = 0  #: cycles without a telegram or without an answer, because a newer telegram waited
    refused: int = 0  #: telegrams that could not be read, or came from another sender
    most_delay: int = 0  #: largest Delay that the robot reported
    longest: float = 0.0  #: [s], from the arrival of a telegram in the kernel to the answer
    total: float = 0.0  #: [s], of all answers

    def __post_init__(self):
        self._robot: tuple | None = None
        self._last: int | None = None  # IPOC
        self._elapsed = 0  # [ms], from the first telegram to the last one
        self._reason = ""

    def rehearse(self) -> None:
        """Answer a telegram from this host, so that the first answer to the robot takes no longer than the others."""
        poses = dict.fromkeys((self.elements.actual, self.elements.commanded), AXES)
        values = {axes: " ".join(f'{axis}="0"' for axis in axes) for axes in (AXES, JOINTS)}
        names = (poses | {self.elements.joints: JOINTS}).items()
        text = "".join(f"<{name} {values[axes]}/>" for name, axes in names if name)
        corrector = copy.copy(self.corrector)
        corrector.path = copy.copy(corrector.path)
        with open_socket("127.0.0.1", 0) as own:
            own.sendto(f"<Rob>{text}<IPOC>0</IPOC></Rob>".encode(), own.getsockname())
            rehearsal = replace(self, connection=own, corrector=corrector, report=lambda _: None, record=None)
            rehearsal.answer_newest()

    def run(self) -> None:
        """Answer telegrams until the end."""
        latest = time.monotonic()
        gc.freeze()  # objects of the start are not searched again during the cycles
        while not self.stop.is_set():
            if self.answer_newest():
                latest = time.monotonic()
            elif self._robot is None:
                self.rehearse()  # keeps code and data of an answer in the cache of the processor
            elif time.monotonic() - latest > SILENCE:
                self.report(f"no telegram for {SILENCE:g} s")
                self.stop.set()  # the next program starts from the first point with a new session

    def answer_newest(self) -> bool:
        """Wait for telegrams, and answer the newest; return whether there was one."""
        newest = self._newest()
        if newest is not None:
            self._answer(*newest)
        return newest is not None

    def _newest(self) -> tuple[RobotTelegram, np.ndarray, int] | None:
        """Wait for telegrams, read all that have arrived, and return the newest with its point and its arrival [ns].

        The robot needs the answer to its last telegram only: after a stop, answers in order would all be late.
        """
        newest: tuple[RobotTelegram, np.ndarray, int] | None = None
        for data, sender, arrival in self._arrived():
            if self._robot is not None and sender != self._robot:
                self._refuse(f"a telegram from a second sender {sender[0]}:{sender[1]}")
                continue
            try:
                telegram = read_telegram(data, self.elements)
                point = self._point(telegram)
                before = self._last if newest is None else newest[0].ipoc
                ahead = 0 if before is None else (telegram.ipoc - before) % WRAP
                # a counter that is farther ahead is no next telegram; assumed: a robot waits a minute at most
                if ahead > 60_000:
                    raise MessageError(f"IPOC {telegram.ipoc} after {before}")
            except MessageError as error:
                self._refuse(str(error))
                continue
            self._robot = sender
            self.repeated += before is not None and ahead == 0
            newest = telegram, point, arrival
        return newest

    def _arrived(self) -> Iterator[tuple[bytes, tuple, int]]:
        """Wait for a telegram, and yield all that have arrived: bytes, sender, arrival [ns of the wall clock]."""
        if not select.select([self.connection], [], [], 0.2)[0]:  # [s]
            return
        for _ in range(1000):  # 4 s at 4 ms: a flood does not keep the session from answering
            try:
                data, about, _, sender = self.connection.recvmsg(MOST_BYTES + 1, socket.CMSG_SPACE(TIME.size))
            except BlockingIOError:
                return
            now = time.clock_gettime_ns(time.CLOCK_REALTIME)
            stamps = [TIME.unpack(item) for _, kind, item in about if kind == TIMESTAMP]
            yield data, sender, min(now, *(s * SECOND + ns for s, ns in stamps)) if stamps else now

    def _answer(self, telegram: RobotTelegram, point: np.ndarray, arrival: int) -> None:
        correction = self._correction(telegram, point)
        try:
            answer = correction
            if self.elements.of_joints and telegram.joints is not None:
                answer = self._joint_correction(telegram.joints, correction)
            self.connection.sendto(write_answer(telegram.ipoc, answer, self.elements), self._robot or ())
        except OSError as error:  # the cable, an interface
            self._refuse(f"no answer can be sent ({error.strerror})")
        took = max(time.clock_gettime_ns(time.CLOCK_REALTIME) - arrival, 0) * 1e-9
        self.answered += 1
        self.late += took > 1e-3 * self.cycle_ms
        self.longest, self.total = max(self.longest, took), self.total + took
        self.most_delay = max(self.most_delay, telegram.delay)
        if self.answered == 1:
            self.report("robot {}:{} is connected".format(*self._robot or ()))
        self._record(self._elapsed * SECOND // 1000, telegram.actual, correction)
        if self.corrector.reason != self._reason:
            self._reason = self.corrector.reason
            self.report(f"{self._reason}, {1e3 * self.corrector.path.progress:.1f} mm of the path")

    def _correction(self, telegram: RobotTelegram, point: np.ndarray) -> np.ndarray:
        """Return the correction of a cycle, and count the cycles before it that have no answer."""
        if telegram.ipoc == self._last:
            return self.corrector.applied
        ahead = 0 if self._last is None else (telegram.ipoc - self._last) % WRAP
        cycles = max(1, round(ahead / self.cycle_ms))
        self.missed += cycles - 1
        self._last, self._elapsed = telegram.ipoc, self._elapsed + ahead
        return self.corrector.step(point, cycles)

    def _point(self, telegram: RobotTelegram) -> np.ndarray:
        elements, corrected = self.elements, True
        if elements.commanded and not self.from_actual:
            name, place, corrected = elements.commanded, telegram.commanded, False
        elif elements.actual:
            name, place = elements.actual, telegram.actual
        else:
            name, place = elements.joints, None
            if self.arm is not None and telegram.joints is not None:
                tool = pose(self.arm.arm, self.arm.mount, telegram.joints).position
                place = self.arm.place.inverse().apply(tool)
        if place is None or (elements.of_joints and telegram.joints is None):
            raise MessageError(f"a telegram has no {elements.joints if place is not None else name}")
        return place[:3] - self.corrector.applied[:3] * corrected

    def _joint_correction(self, joints: np.ndarray, correction: np.ndarray) -> np.ndarray:
        """Return the change of the joints [rad], (6,), that moves the tool by a correction, (6,) [m, rad].

        It is linear: 1 mm at 1 m of the axes is right to 1 um. Near a singularity it is reduced to the largest angle.
        """
        if self.arm is None:
            return np.zeros(6)
        turn = self.arm.place.rotation
        twist = np.concatenate([turn @ correction[:3], turn @ correction[5:2:-1]])
        change = np.linalg.lstsq(jacobian(self.arm.arm, self.arm.mount, joints)[:, -6:], twist, rcond=1e-9)[0]
        return change * min(1.0, self.corrector.angle / max(float(np.abs(change).max()), 1e-12))

    def _refuse(self, reason: str) -> None:
        if not self.refused:
            self.report(f"ignored: {reason}; further ones are counted")
        self.refused += 1

    def _record(self, *cycle) -> None:
        if self.record is None:
            return
        try:
            self.record(*cycle)
        except RecordingError as error:
            self.record, self.recording_failed = None, True
            self.report(f"answers continue without a recording: {error}")


def open_socket(host: str, port: int) -> socket.socket:
    """Return a bound UDP socket; raise InputError."""
    connection = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    connection.setblocking(False)
    try:
        with contextlib.suppress(OSError):  # another system: then a telegram arrives when it is read
            connection.setsockopt(socket.SOL_SOCKET, TIMESTAMP, 1)
        connection.bind((host, port))
    except OSError as error:
        connection.close()
        raise InputError(f"{host}:{port}", f"cannot be used ({error.strerror})") from None
    return connection


@contextlib.contextmanager
def real_time() -> Iterator[str]:
    """Run this thread with SCHED_FIFO in the block; yield a sentence where that is not allowed, else an empty text."""
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        # assumed: priority above all usual programs, below the kernel's threads of 50
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    except (OSError, AttributeError) as error:
        reason = getattr(error, "strerror", None) or "not on this system"
        yield f"no real-time priority (SCHED_FIFO: {reason}), so answers may be late on a busy machine; see ulimit -r"
        return
    try:
        yield ""
    finally:
        os.sched_setscheduler(0, *before)
