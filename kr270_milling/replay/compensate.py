"""The revised reference trajectory from a recorded pass, by the same compensator as on line."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from kr270_milling.bag.reader import Recording
from kr270_milling.base.errors import RecordingError
from kr270_milling.replay.compare import difference
from kr270_milling.replay.revisions import CompensatorFeed
from kr270_milling.replay.robots import Robot, Robots
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["Revised", "compensate"]


@dataclass(frozen=True, eq=False)
class Revised:
    """What follows from the last complete pass of one robot in a recording."""

    robot: str  #: namespace
    method: str
    reference: Trajectory
    joints: np.ndarray  #: [rad], (n, 6), at its knots
    remaining_error: float  #: [m], of the recorded pass
    largest_correction: float  #: [m], of a knot against the target
    published: bool | None  #: the live node published the same bits; None: not recorded, or another method was asked

    def as_dict(self) -> dict:
        return dict(
            robot=self.robot or "/",
            method=self.method,
            remaining_error_um=self.remaining_error * 1e6,
            largest_correction_um=self.largest_correction * 1e6,
            identical_to_published=self.published,
            time_ns=self.reference.time_ns,
            position_m=self.reference.position,
            quaternion_xyzw=self.reference.quaternion,
            velocity_m_per_s=self.reference.velocity,
            joints_rad=self.joints,
        )


def compensate(path, method: str | None = None, progress=None) -> list[Revised]:
    """One entry per robot; ``method`` takes the place of the recorded one. Raises RecordingError where no pass is
    complete, or where the file does not decide the revision."""
    found: dict[str, Revised] = {}

    def on_pass(robot: Robot, feed: CompensatorFeed, published: bytes | None) -> None:
        found[robot.namespace] = _revised(robot, feed, method, published)

    with Recording(path) as recording:
        robots = Robots(recording)
        for robot in robots.robots.values():
            if robot.compensator is not None:
                robot.compensator.on_pass = functools.partial(on_pass, robot)
        robots.feed(progress, Robot.hear_compensator)
        stops = [stop for robot in robots.robots.values() for stop in robot.stops]
        if not found and stops:
            raise RecordingError(recording.path, stops[-1].reason)
        if not found:
            raise RecordingError(recording.path, "holds no complete pass along a recorded reference trajectory")
    return list(found.values())


def _revised(robot: Robot, feed: CompensatorFeed, method: str | None, published: bytes | None) -> Revised:
    states = [revision.begun for revision in feed.revisions]
    own = method in (None, states[0].method)
    same = []
    if method is not None and not own:
        states = [feed.revised_by(method)]
    elif published is not None:
        same = [state for state in states if difference(state.reference, published) is None]
    state = (same or states)[0]
    shift = state.reference.position - feed.target.sample(state.reference.time_ns)
    return Revised(
        robot.namespace,
        state.method,
        state.reference,
        feed.protocol.models.joints(state.reference),
        state.errors[-1],
        float(np.linalg.norm(shift, axis=1).max()),
        bool(same) if own and published is not None else None,
    )
