"""Convert messages of the graph into events of the page: samples at 30 Hz, passes, states of the nodes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.scores import path_deviation
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.messages.codec import (
    deserialise,
    pose_from_bytes,
    trajectory_from_bytes,
    wrench_from_bytes,
)
from kr270_milling.recordings.messages.topics import TOPICS

__all__ = ["INPUTS", "PERIOD_NS", "LiveEvents"]

#: topics of the feed, without their namespace
INPUTS = tuple(topic.key for topic in TOPICS if topic.page)
PERIOD_NS = 33_333_333  #: of the pass between two samples
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


class LiveEvents:
    """Events of one robot."""

    def __init__(self):
        self._target: Trajectory | None = None
        self._start_ns = self._next_ns = 0  # of the pass and of the next one
        self._due = 0
        self._latest = -1
        self._force: np.ndarray | None = None
        self._passes = 0
        self._states: dict[str, tuple] = {}

    def events(self, name: str, data: bytes) -> Iterator[dict]:
        """Return the events of one message; name: of the topic without its namespace.

        Raises MillingError, ValueError where the bytes are not a message of this topic.
        """
        if name == "diagnostics":
            yield from self._report(data)
        elif name.endswith("_trajectory"):
            run = trajectory_from_bytes(data)
            if name == "target_trajectory" or self._target is None:
                self._target = run  # the first reference is the target itself
            if name == "reference_trajectory":
                self._next_ns = run.start_ns
        else:
            yield from self._exchange(name, data, stamp_of(data) or 0)

    def _exchange(self, name: str, data: bytes, stamp: int) -> Iterator[dict]:
        if name == "wrench":
            if stamp >= self._due - PERIOD_NS // 4:
                self._force = np.asarray(wrench_from_bytes(data).wrench[:3])
            return
        if stamp < self._latest or self._latest < 0 or self._start_ns < self._next_ns <= stamp:
            self._passes += 1
            self._due, self._start_ns = stamp, self._next_ns
            duration = None if self._target is None else self._target.duration_ns * 1e-9
            yield {"kind": "pass", "number": self._passes, "duration_s": duration}
        self._latest = stamp
        if stamp >= self._due:
            self._due = stamp + PERIOD_NS
            yield self._sample(stamp, np.asarray(pose_from_bytes(data).position))

    def _sample(self, stamp: int, actual: np.ndarray) -> dict:
        """Deviations in um, to the left of the path and upwards; the force [N] is that of the last received period."""
        stamp -= self._start_ns
        target = actual if self._target is None else self._target.sample(stamp)
        feed = np.zeros((1, 3)) if self._target is None else self._target.sample_velocity(stamp)[None]
        side = float(path_deviation(actual[None], target[None], feed)[0])
        force = None if self._force is None else round(float(np.linalg.norm(self._force)), 3)
        x, y, z = (round(1e3 * v, 4) for v in target.tolist())
        return {
            "kind": "sample", "pass": self._passes, "t": round(stamp * 1e-9, 6), "x": x, "y": y, "z": z,
            "side": round(1e6 * side, 3), "up": round(1e6 * float(actual[2] - target[2]), 3), "force": force,
        }  # fmt: skip

    def _report(self, data: bytes) -> Iterator[dict]:
        """Return the state of a node where it differs from the previous one."""
        for status in deserialise(DIAGNOSTICS, data).status:
            state = (int(status.level), status.message)
            if self._states.get(status.name) != state:
                self._states[status.name] = state
                yield {"kind": "state", "node": status.name, "level": state[0], "message": state[1]}
