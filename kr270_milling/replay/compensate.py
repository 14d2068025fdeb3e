"""The revised reference trajectory from a recorded pass, by the same compensator as on line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.bag.errors import RecordingError
from kr270_milling.bag.reader import Recording
from kr270_milling.cell.jobs import commanded_joints
from kr270_milling.replay.compensator import reference_bytes
from kr270_milling.replay.inputs import sample
from kr270_milling.replay.recompute import Robot, Robots
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
    published: bool | None  #: the live node published the same bytes; None: not recorded, or another method was asked

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

    def hear(robot: Robot, name: str, data: bytes) -> None:
        model = robot.compensator
        if model is None:
            return
        if name == "reference_trajectory":
            robot.references += 1
            if model.complete and robot.references > 1:
                found[robot.namespace] = _revised(recording, robot, method, data)
            model.hear_reference(data, first=robot.references == 1)
        elif name == "target_trajectory":
            model.hear_target(data)
        elif name in ("tool_pose", "wrench"):
            (model.pose if name == "tool_pose" else model.wrench)(sample(data, 7 if name == "tool_pose" else 6))

    with Recording(path) as recording:
        robots = Robots(recording)
        robots.feed(progress, hear)
        for robot in robots.robots.values():
            if robot.compensator is not None and robot.compensator.complete:
                found[robot.namespace] = _revised(recording, robot, method, None)
        if not found:
            raise RecordingError(recording.path, "holds no complete pass along a recorded reference trajectory")
    return list(found.values())


def _revised(recording: Recording, robot: Robot, method: str | None, published: bytes | None) -> Revised:
    model = robot.compensator
    own = method in (None, model.method)
    states = model.revise(None if own else method)
    if not states:
        reason = robot.stops[-1].reason if robot.stops else "the revision is not decided"
        raise RecordingError(recording.path, reason)
    same = [s for s in states if published is not None and reference_bytes(s.reference).same(published)]
    state = (same or states)[0]
    shift = state.reference.position - model.target.sample(state.reference.time_ns)
    return Revised(
        robot.namespace,
        state.method,
        state.reference,
        commanded_joints(robot.cell, state.reference),
        state.errors[-1],
        float(np.linalg.norm(shift, axis=1).max()),
        bool(same) if own and published is not None else None,
    )
