"""Compute the revised reference trajectory from a recorded pass, by the same compensator as on line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from kr270_milling.base.errors import MillingError, RecordingError
from kr270_milling.cell.jobs import commanded_joints
from kr270_milling.exchange.replay.compare import difference
from kr270_milling.exchange.replay.revisions import Revision
from kr270_milling.exchange.replay.robots import Robot, Robots
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import stamp_of

__all__ = ["Revised", "compensate_recording"]


@dataclass(frozen=True, eq=False)
class Revised:
    """The revision after the last complete pass of one robot in a recording."""

    robot: str  #: namespace
    method: str
    reference: Trajectory
    joints: np.ndarray  #: [rad], (n, 6), at its knots
    remaining_error: float  #: [m], of the recorded pass
    largest_correction: float  #: [m], of a knot against the target
    published: bool | None  #: the live node published the same bits; None: not recorded, or another method was chosen

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


def compensate_recording(
    path, method: str | None = None, progress=None, remap: Mapping[str, str] = MappingProxyType({})
) -> list[Revised]:
    """Return one revision per robot; ``method`` takes the place of the recorded one. remap: see ``Recording``.

    Raises RecordingError where no pass is complete, or where the pass cannot be revised.
    """
    with Recording(path, remap=remap) as recording:
        robots = Robots(recording)
        robots.feed(progress, Robot.feed_compensator)
        with robots.usable("/wrench"):
            try:
                made = [(robot, robot.compensator.revise(method)) for robot in robots.robots.values()]
                revised = [_revised(robot, revision) for robot, revision in made if revision is not None]
            except MillingError as error:
                raise RecordingError(recording.path, str(error)) from error
        if not revised:
            raise RecordingError(recording.path, "holds no complete pass along a recorded reference trajectory")
    return revised


def _same_bits(reference: Trajectory, published: bytes) -> bool:
    """Whether a message has the bits of a reference; only the recording knows the start of the next pass."""
    return difference(reference.starting_at(stamp_of(published) or 0), published) is None


def _revised(robot: Robot, revision: Revision) -> Revised:
    made = revision.compensator
    shift = made.reference.position - revision.target.sample(made.reference.time_ns)
    return Revised(
        robot.namespace,
        made.method,
        made.reference,
        commanded_joints(robot.cell, made.reference),
        made.errors[-1],
        float(np.linalg.norm(shift, axis=1).max()),
        None if revision.published is None else _same_bits(made.reference, revision.published),
    )
