"""The recording after a fault, compared with an undisturbed pass, and the processes that are left."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling.exchange.replay.attached import attached_cell
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.physics.motion.milling_pass import PassResult
from kr270_milling.recordings.bag.info import info
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.series import series
from kr270_milling.recordings.messages.cdr import stamp_of

__all__ = ["Recorded", "is_alive", "read_back"]

WIDTH = {"/tool_pose": 3, "/wrench": 6, "/deflection": 6}  # numbers of a message that are compared


@dataclass(frozen=True)
class Recorded:
    """A recording after a fault."""

    cut_off: bool
    messages: int
    started: bool  #: it holds something of the pass: a pose or a wrench
    missing: int  #: holes in it, counted from the stamps
    short: int  #: messages of the whole pass that are missing
    behind_s: float  #: from its last pose to the fault [s of the wall clock]; 0 where the recording continues
    complete: bool  #: it holds every message of the pass
    same: bool  #: every pose, wrench and deflection in it is that of the undisturbed pass, bit for bit
    verdict: str  #: of recompute; empty where recompute did not run


def read_back(path: Path, expected: PassResult, struck_ns: int, started_ns: int, again: bool) -> Recorded:
    """again: recompute it too. struck_ns: when the fault was, started_ns: when the pass began [ns of the wall clock].

    Raises RecordingError.
    """
    with Recording(path) as recording:
        about, every = info(recording), attached_cell(recording).thinned_steps
        references = recording.messages(["/reference_trajectory"])
        stamps = expected.time_ns + next((stamp_of(message.data) or 0 for message in references), 0)
        wrong, short, started, ends = False, 0, False, {}
        for topic, values in zip(WIDTH, (expected.tool, expected.wrench, expected.deflection), strict=True):
            recorded = series(recording, topic)
            due = stamps[:: every if topic == "/deflection" else 1]
            started |= recorded.stamp.size > 0 and topic != "/deflection"
            ends[topic] = recorded.stamp.size and recorded.stamp[-1] == due[-1]
            short += due.size - np.unique(recorded.stamp).size
            wrong = wrong or not _same(recorded, stamps, values, WIDTH[topic])
        last = max((m.publish_time for m in recording.messages(["/tool_pose"])), default=started_ns)
    complete = all(ends.values()) and not short
    behind = max(0.0, (struck_ns - last) * 1e-9)
    verdict = recompute(path).verdict if again else ""
    return Recorded(
        about["cut_off"], about["messages"], started, about["missing"], short, behind, complete, not wrong, verdict
    )


def _same(recorded, stamps: np.ndarray, values: np.ndarray, width: int) -> bool:
    rows = np.searchsorted(stamps, recorded.stamp)
    known = rows < stamps.size
    if not known.all() or not np.array_equal(stamps[rows], recorded.stamp):
        return False
    return np.array_equal(recorded.values[:, :width], values[rows])


def is_alive(pid: int) -> bool:
    """Whether a process exists, and not only its exit code."""
    try:
        with open(f"/proc/{pid}/stat", encoding="utf-8", errors="replace") as stream:
            return stream.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
