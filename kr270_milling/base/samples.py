"""Records of the messages on the topics: stamps in nanoseconds, values in SI units, no ROS types."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import MessageError


@dataclasses.dataclass(frozen=True, eq=False)
class Sample:
    """Base of the records: converts arrays to their type, checks their shape, makes them read-only."""

    def __post_init__(self):
        for field in dataclasses.fields(self):
            if "shape" in field.metadata:
                object.__setattr__(self, field.name, _array(getattr(self, field.name), field))


def _array(value, field) -> np.ndarray:
    array = np.array(value, field.metadata["kind"])
    shape = field.metadata["shape"]
    if array.ndim != len(shape) or any(n not in (-1, m) for n, m in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{field.name} has the shape {array.shape} and not {shape}")
    array.setflags(write=False)
    return array


def _values(*shape: int, kind: type = float):
    """Return a field for an array of this shape; -1: any length."""
    return dataclasses.field(metadata={"shape": shape, "kind": kind})


class PoseSample(NamedTuple):
    """Pose of the tool (geometry_msgs/PoseStamped); not checked, because every exchange creates one."""

    stamp: int  #: [ns]
    frame: str
    position: np.ndarray  #: [m], (3,)
    quaternion: np.ndarray  #: x y z w, (4,)


class WrenchSample(NamedTuple):
    """Force and moment on the tool (geometry_msgs/WrenchStamped); not checked, as a pose."""

    stamp: int  #: [ns]
    frame: str
    wrench: np.ndarray  #: [N, N m], (6,)


class TwistSample(NamedTuple):
    """Deflection: small displacement and rotation (geometry_msgs/TwistStamped); not checked, as a pose."""

    stamp: int  #: [ns]
    frame: str
    twist: np.ndarray  #: [m, rad], (6,)


@dataclass(frozen=True, eq=False)
class JointSample(Sample):
    """Positions of named joints (sensor_msgs/JointState)."""

    stamp: int  #: [ns]
    names: tuple[str, ...]
    position: np.ndarray = _values(-1)  #: [rad], (joints,)

    def of(self, names: Sequence[str]) -> np.ndarray:
        """Return the positions of these joints [rad], (n,). Raises MessageError where one is missing or not finite."""
        positions = dict(zip(self.names, self.position.tolist(), strict=False))
        missing = [name for name in names if not math.isfinite(positions.get(name, math.nan))]
        if missing:
            raise MessageError(f"joint_states: has no position of {', '.join(missing)} (key joint_names)")
        return np.array([positions[name] for name in names])


@dataclass(frozen=True, eq=False)
class ClockSample(Sample):
    """Time of the pass (rosgraph_msgs/Clock)."""

    stamp: int  #: [ns]


@dataclass(frozen=True, eq=False)
class Text(Sample):
    """A text without a stamp (std_msgs/String)."""

    text: str


@dataclass(frozen=True, eq=False)
class JointProgram(Sample):
    """Trajectory of a joint controller (trajectory_msgs/JointTrajectory); NaN: the point has no such values."""

    stamp: int  #: start [ns]; 0: at once
    frame: str
    names: tuple[str, ...]
    time: np.ndarray = _values(-1, kind=np.int64)  #: from the start [ns], (n,)
    position: np.ndarray = _values(-1, -1)  #: [rad], (n, joints)
    velocity: np.ndarray = _values(-1, -1)  #: [rad/s], (n, joints)
    acceleration: np.ndarray = _values(-1, -1)  #: [rad/s^2], (n, joints)


@dataclass(frozen=True, eq=False)
class StockMap(Sample):
    """Remaining height of the stock, seen from above (nav_msgs/OccupancyGrid)."""

    stamp: int  #: [ns]
    frame: str
    resolution: float  #: [m], side of a cell, as float32 holds it
    corner: np.ndarray = _values(3)  #: [m], (3,), of cell (0, 0)
    cells: np.ndarray = _values(-1, -1, kind=np.int8)  #: percent, (nx, ny)


class LearnedRecording(NamedTuple):
    """A pass from which the compensator computed a reference trajectory."""

    recording: str  #: file of the pass with its directory, such as original/original.mcap; empty: not recorded
    fingerprint: str  #: stamps of all poses and wrenches that the compensator received
    poses: int
    wrenches: int


@dataclass(frozen=True, eq=False)
class CompensatorState(Sample):
    """State of the compensator, published before each reference trajectory (diagnostic_msgs/DiagnosticStatus)."""

    name: str  #: name of the node
    method: str
    passes: int  #: completed passes
    finished: bool  #: the method will not improve the reference any more
    target: str  #: fingerprint of the target trajectory
    reference: str  #: fingerprint of the reference trajectory
    learned: tuple[LearnedRecording, ...]  #: the passes that the reference was computed from, in their order
