"""The recording of an RSI session: programmed path, tool pose, correction and status."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.base.frames import WORKPIECE, quaternion_from_rotation, rotation_from_abc
from kr270_milling.base.samples import PoseSample, Text, TwistSample
from kr270_milling.base.units import SECOND
from kr270_milling.live.rsi.corrector import CorrectionTable
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.codec import to_bytes, type_of

__all__ = ["RsiRecording"]


class RsiRecording:
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
        self._now = now
        self._writer = BagWriter(directory, metadata=metadata, attachments=attachments)
        time_ns = (table.time * SECOND).round().astype("int64")
        target = Trajectory(time_ns - time_ns[0], table.position, np.array(TOOL_DOWN))
        self._write("target_trajectory", target)
        self._write("reference_trajectory", target.with_position(table.position + table.correction[:, :3]))

    def add(self, stamp: int, actual: np.ndarray | None, correction: np.ndarray) -> None:
        """Record an answered cycle: stamp [ns], RIst and RKorr, (6,) [m, rad]."""
        if actual is not None:
            turn = quaternion_from_rotation(rotation_from_abc(actual[3:]))
            self._write("tool_pose", PoseSample(stamp, WORKPIECE, actual[:3], turn))
        a, b, c = correction[3:]
        twist = TwistSample(stamp, WORKPIECE, np.array([*correction[:3], c, b, a]))
        self._write("correction", twist)
        self._writer.tick(time.monotonic())

    def report(self, sentence: str) -> None:
        """Record a sentence of the session; where the file cannot be written, ``add`` raises the error."""
        with suppress(RecordingError):
            self._write("rsi_status", Text(sentence))

    def _write(self, topic: str, record) -> None:
        self._writer.add_topic(f"/{topic}", type_of(record))
        self._writer.write(f"/{topic}", to_bytes(record), self._now())

    def __enter__(self) -> RsiRecording:
        return self

    def __exit__(self, *_) -> None:
        self._writer.close()
