"""Start of the pass of a robot with another clock: its tool leaves the first point, or its own message states it."""

from __future__ import annotations

from collections import deque

import numpy as np

from kr270_milling.base.errors import MessageError
from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.path.trajectory import Trajectory

__all__ = ["BREAK_NS", "StartSeeker", "check_follows", "is_far", "lag"]

START_TOLERANCE = 0.5e-3  #: [m], from the first point of the reference, in which a robot with another clock waits
SEEK_NS = 1_000_000_000  # within this time of the pass, a pose beyond the tolerance must follow
MOST_EARLY = 2000  # poses and wrenches before the start is known
BREAK_NS = 2_000_000_000  #: without progress, after which a pass is over; assumed: longer than any lag of a controller
FAR = 5e-3  # [m], from the reference; far above the deflection of an arm


class StartSeeker:
    """Collects poses and wrenches before the start of a pass along ``reference``.

    announced: a message states the start. Otherwise the pass starts when the tool leaves the first point along the
    reference.
    """

    def __init__(self, reference: Trajectory, announced: bool = False):
        self.distance: float | None = None  #: [m], of the tool from the first point of the reference; None: no pose yet
        self.poses: deque[PoseSample] = deque(maxlen=MOST_EARLY)
        self.wrenches: deque[WrenchSample] = deque(maxlen=MOST_EARLY)
        self._reference = reference
        self._announced = announced

    def pose(self, sample: PoseSample) -> int | None:
        """Take a pose; return the stamp [ns] of the start where the pose shows that the pass has started."""
        self.distance = float(np.linalg.norm(sample.position - self._reference.position[0]))
        if self._announced or self.distance <= START_TOLERANCE:
            self.poses.append(sample)
            return None
        if not self.poses:
            return None
        times = np.arange(0, min(SEEK_NS, self._reference.duration_ns) + 1, SEEK_NS // 1000)
        off = np.linalg.norm(self._reference.sample(times) - sample.position, axis=1)
        nearest = int(np.argmin(off))
        if off[nearest] > START_TOLERANCE:
            self.poses.clear()
            return None
        self.poses.append(sample)
        return sample.stamp - int(times[nearest])

    def standing(self, start_ns: int) -> list[WrenchSample]:
        """Return the wrenches of the time in which the tool waited for the start."""
        first = self.poses[0].stamp if self.poses else start_ns
        return [sample for sample in self.wrenches if first <= sample.stamp < start_ns]


def lag(reference: Trajectory, time_ns: np.ndarray, position: np.ndarray) -> int:
    """Return the delay [ns] of poses (n, 3) [m] along a reference: least squares of v (p - r) + v^2 dt."""
    delay = 0
    for _ in range(3):
        velocity = reference.sample_velocity(time_ns - delay)
        behind = np.sum(velocity * (position - reference.sample(time_ns - delay)))
        delay -= round(1e9 * behind / max(np.sum(velocity**2), 1e-12))
    return delay


def is_far(reference: Trajectory, time_ns: int, position: np.ndarray) -> bool:
    """Return whether a tool at a position (3,) [m] is far from the reference of the last ``BREAK_NS``.

    A robot that lags is near an earlier point; a robot that has stopped is near none when this time has passed.
    """
    if float(np.linalg.norm(position - reference.sample(min(time_ns, reference.duration_ns)))) <= FAR:
        return False
    # every 5 ms: 2 mm at 0.4 m/s
    times = np.linspace(time_ns - BREAK_NS, time_ns, 401).clip(0, reference.duration_ns).astype(np.int64)
    return float(np.linalg.norm(reference.sample(times) - position, axis=1).min()) > FAR


def check_follows(reference: Trajectory, time_ns: np.ndarray, position: np.ndarray) -> None:
    """Raise MessageError where poses (n, 3) [m] at times (n,) [ns] are no pass along the reference."""
    if time_ns.size < 10:
        raise MessageError(f"tool_pose: the pass has only {time_ns.size} poses and is not used")
    off = float(np.linalg.norm(position - reference.sample(time_ns), axis=1).max())
    if off > FAR:
        raise MessageError(
            f"tool_pose: up to {off * 1e3:.1f} mm from the reference, so the pass is not used; is the override 100 %?"
        )
