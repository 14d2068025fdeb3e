"""Messages as bytes (CDR) and as records, both ways, by rosbags' type store; no ROS is needed.

``to_bytes(record)`` gives the bytes of the message that carries a record, ``from_bytes(type name, bytes)`` the record.
``serialise`` and ``deserialise`` do the same for messages of any type, from and to nested dicts.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from kr270_milling.base.samples import (
    ClockSample,
    JointProgram,
    JointSample,
    PoseSample,
    StockMap,
    Text,
    TwistSample,
    WrenchSample,
)
from kr270_milling.base.units import SECOND
from kr270_milling.messages.definitions import store_of
from kr270_milling.messages.trajectory import TRAJECTORY, read_trajectory
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = [
    "TOOL", "deserialise", "from_bytes", "named", "read_message", "serialise", "time_fields", "to_bytes", "type_of",
]  # fmt: skip

TOOL = "tool0"


def deserialise(type_name: str, data: bytes):
    """A message as an object with its fields as attributes. Raises ValueError where the bytes are no such message."""
    return read_message(store_of(type_name), type_name, data)


def read_message(store, type_name: str, data: bytes):
    """The same with the types of a given store.

    Bytes behind the last field are let pass: rmw_fastrtps leaves up to 76 there, more than rosbags' own check allows.
    """
    from rosbags.serde import SerdeError

    if len(data) < 4 or data[0] != 0 or data[1] > 1:
        raise ValueError("not plain CDR of version 1")
    about = store.get_msgdef(type_name)
    read = about.deserialize_cdr_le if data[1] else about.deserialize_cdr_be
    try:
        return read(data[4:], 0, about.cls, store)[0]
    except (SerdeError, IndexError, ValueError, struct.error) as error:
        raise ValueError(f"is not a {type_name}: {error}") from None


def serialise(type_name: str, fields: Mapping) -> bytes:
    """The bytes of a message, little endian; fields: nested mappings; what they leave out is zero or empty."""
    store = store_of(type_name)
    return bytes(store.serialize_cdr(_message(store, type_name, fields), type_name, little_endian=True))


def _message(store, type_name: str, fields: Mapping):
    """The message object of nested mappings."""
    known = dict(store.fielddefs[type_name][1])
    if not set(fields) <= set(known):
        raise KeyError(f"{type_name} has no field {', '.join(sorted(set(fields) - set(known)))}")
    return store.types[type_name](*(_value(store, kind, fields.get(name)) for name, kind in known.items()))


def _value(store, kind, value):
    from rosbags.interfaces import Nodetype
    from rosbags.serde.utils import ndtype

    if kind[0] == Nodetype.NAME:
        return _message(store, kind[1], {} if value is None else value)
    if kind[0] == Nodetype.BASE:
        return value if value is not None else "" if kind[1][0] == "string" else 0
    (inner, about), length = kind[1]
    count = length if kind[0] == Nodetype.ARRAY else 0
    if inner == Nodetype.BASE and about[0] != "string":
        return np.zeros(count, ndtype(about[0])) if value is None else np.ascontiguousarray(value, ndtype(about[0]))
    return [_value(store, (inner, about), item) for item in ([None] * count if value is None else value)]


class Kind(NamedTuple):
    """A record's message: its type, record -> fields, message -> record."""

    type: str
    write: Callable
    read: Callable | None


def time_fields(ns: int) -> dict:
    """Of a builtin_interfaces Time or Duration."""
    return {"sec": int(ns) // SECOND, "nanosec": int(ns) % SECOND}


def _ns(time) -> int:
    return time.sec * SECOND + time.nanosec


def _header(stamp: int, frame: str) -> dict:
    return {"stamp": time_fields(stamp), "frame_id": frame}


def named(axes: str, values) -> dict:
    """Of a message with a number per axis, such as a Point or a Quaternion."""
    return dict(zip(axes, map(float, values), strict=True))


def _pose(record: PoseSample) -> dict:
    pose = {"position": named("xyz", record.position), "orientation": named("xyzw", record.quaternion)}
    return {"header": _header(record.stamp, record.frame), "pose": pose}


def _read_pose(msg) -> PoseSample:
    p, q = msg.pose.position, msg.pose.orientation
    position, quaternion = np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w])
    return PoseSample(_ns(msg.header.stamp), msg.header.frame_id, position, quaternion)


def _six(record: type, type_name: str, field: str, one: str, other: str) -> Kind:
    """A stamped message with two vectors."""

    def write(sample) -> dict:
        values = getattr(sample, field)
        pair = {one: named("xyz", values[:3]), other: named("xyz", values[3:])}
        return {"header": _header(sample.stamp, sample.frame), field: pair}

    def read(msg):
        a, b = getattr(getattr(msg, field), one), getattr(getattr(msg, field), other)
        return record(_ns(msg.header.stamp), msg.header.frame_id, np.array([a.x, a.y, a.z, b.x, b.y, b.z]))

    return Kind(type_name, write, read)


def _joints(record: JointSample) -> dict:
    return {"header": _header(record.stamp, ""), "name": list(record.names), "position": record.position}


def _read_joints(msg) -> JointSample:
    return JointSample(_ns(msg.header.stamp), tuple(msg.name), msg.position)


def _clock(record: ClockSample) -> dict:
    return {"clock": time_fields(record.stamp)}


def _program(record: JointProgram) -> dict:
    points = [
        {"positions": row, "time_from_start": time_fields(ns)}
        for ns, row in zip(record.time.tolist(), record.position, strict=True)
    ]
    return {"header": _header(0, record.frame), "joint_names": list(record.names), "points": points}


def _read_program(msg) -> JointProgram:
    times = np.array([_ns(point.time_from_start) for point in msg.points], np.int64)
    rows = np.array([point.positions for point in msg.points]).reshape(-1, len(msg.joint_names))
    return JointProgram(msg.header.frame_id, tuple(msg.joint_names), times, rows)


def _map(record: StockMap) -> dict:
    info = {"resolution": record.resolution, "width": record.cells.shape[0], "height": record.cells.shape[1]}
    info["origin"] = {"position": named("xyz", record.corner), "orientation": {"w": 1.0}}
    return {"header": _header(record.stamp, record.frame), "info": info, "data": record.cells.T.ravel()}


def _read_map(msg) -> StockMap:
    info, p = msg.info, msg.info.origin.position
    if msg.data.size != info.width * info.height:
        raise ValueError(f"has {msg.data.size} cells for {info.width} x {info.height}")
    cells = msg.data.reshape(info.height, info.width).T
    return StockMap(_ns(msg.header.stamp), msg.header.frame_id, info.resolution, np.array([p.x, p.y, p.z]), cells)


def _trajectory(record: Trajectory) -> dict:
    """One body, the tool; a velocity a point where the trajectory has velocities."""
    points = []
    for i, ns in enumerate(record.time_ns.tolist()):
        turn = named("xyzw", record.quaternion[i])
        point = {"transforms": [{"translation": named("xyz", record.position[i]), "rotation": turn}]}
        if record.velocity is not None:
            point["velocities"] = [{"linear": named("xyz", record.velocity[i])}]
        points.append({**point, "time_from_start": time_fields(ns)})
    return {"header": _header(0, record.frame), "joint_names": [TOOL], "points": points}


KINDS = {
    PoseSample: Kind("geometry_msgs/msg/PoseStamped", _pose, _read_pose),
    WrenchSample: _six(WrenchSample, "geometry_msgs/msg/WrenchStamped", "wrench", "force", "torque"),
    TwistSample: _six(TwistSample, "geometry_msgs/msg/TwistStamped", "twist", "linear", "angular"),
    JointSample: Kind("sensor_msgs/msg/JointState", _joints, _read_joints),
    ClockSample: Kind("rosgraph_msgs/msg/Clock", _clock, lambda msg: ClockSample(_ns(msg.clock))),
    Text: Kind("std_msgs/msg/String", lambda record: {"data": record.text}, lambda msg: Text(msg.data)),
    JointProgram: Kind("trajectory_msgs/msg/JointTrajectory", _program, _read_program),
    StockMap: Kind("nav_msgs/msg/OccupancyGrid", _map, _read_map),
    Trajectory: Kind(TRAJECTORY, _trajectory, None),
}
READERS = {kind.type: kind.read for kind in KINDS.values() if kind.read}


def type_of(record) -> str:
    """The type of the message that carries a record or records of a class."""
    return KINDS[record if isinstance(record, type) else type(record)].type


def to_bytes(record) -> bytes:
    """The message that carries a record, serialised; a Trajectory becomes one of the body tool0."""
    kind = KINDS[type(record)]
    return serialise(kind.type, kind.write(record))


def from_bytes(type_name: str, data: bytes):
    """The record of a serialised message; of a MultiDOFJointTrajectory a TrajectoryRecord.

    Raises ValueError where the bytes are no such message, KeyError for a type that no record stands for.
    """
    if type_name == TRAJECTORY:
        return read_trajectory(data)
    return READERS[type_name](deserialise(type_name, data))
