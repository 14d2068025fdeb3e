"""Topics that the protocols read and write, from the table of topics."""

from __future__ import annotations

from collections.abc import Callable

from kr270_milling.base.samples import JointProgram, PoseSample, WrenchSample
from kr270_milling.exchange.inputs import checked_pose, checked_wrench
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.messages.codec import pose_from_bytes, trajectory_from_bytes, wrench_from_bytes
from kr270_milling.recordings.messages.topics import COMPENSATOR, CUT, ROBOT, TOPICS

__all__ = ["INPUTS", "OUTPUTS", "STAMPED", "TYPES"]

NODES = (ROBOT, CUT, COMPENSATOR)
#: class of a record -> function that reads and checks a message as the nodes do; raises MillingError
READERS: dict[Callable | None, Callable] = {
    PoseSample: lambda data: checked_pose(pose_from_bytes(data)),
    WrenchSample: lambda data: checked_wrench(wrench_from_bytes(data)),
    Trajectory: trajectory_from_bytes,
}
#: topics that are recomputed, in the order of causes; a joint program depends on where the robot is
OUTPUTS = tuple(t.name for t in TOPICS if t.publisher in NODES and t.record not in (None, JointProgram))
#: topic -> reader, of the topics that a protocol takes
INPUTS = {t.name: READERS[t.record] for t in TOPICS if t.record in READERS and set(t.subscribers) & set(NODES)}
TYPES = {t.name: t.type for t in TOPICS if t.name in OUTPUTS or t.name in INPUTS}
STAMPED = frozenset(t.name for t in TOPICS if t.stamped)
