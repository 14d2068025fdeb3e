"""Messages as bytes (CDR) and as records, both ways, by rosbags' type store; no ROS is needed.

``to_bytes(record)`` gives the bytes of the message that carries a record, ``from_bytes(type name, bytes)`` the record.
``serialise`` and ``deserialise`` do the same for messages of any type, from and to nested dicts.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from kr270_milling.base.errors import MessageError
from kr270_milling.base.frames import OLD_TOOL, TOOL, WORKPIECE
from kr270_milling.base.samples import (
    ClockSample,
    CompensatorState,
    JointProgram,
    JointSample,
    LearnedRecording,
    PoseSample,
    StockMap,
    Text,
    TwistSample,
    WrenchSample,
)
from kr270_milling.base.units import SECOND
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.messages.cdr import LITTLE, TRAJECTORY, pack_stamped, read_trajectory, unpack_stamped
from kr270_milling.recordings.messages.definitions import deserialise, store_of


def serialise(type_name: str, fields: Mapping) -> bytes:
    """Return the bytes of a message, little endian; fields: nested mappings; what they leave out is zero or empty.

    A list of messages of numbers, such as Points, may also be an array with a row for each of them. rosbags writes
    objects: a path of 1000 poses takes 4 times as long, markers with 200 points 10 times.
    """
    out = bytearray()
    _writer(type_name)(out, fields)
    return LITTLE + out


@functools.cache
def _writer(type_name: str) -> Callable[[bytearray, Any], None]:
    """Return the function that appends a message, or its empty form for None."""
    writers = {name: _value_writer(kind) for name, kind in store_of(type_name).fielddefs[type_name][1]}

    def write(out: bytearray, fields: Mapping | None) -> None:
        fields = fields or {}
        if not fields.keys() <= writers.keys():
            raise KeyError(f"{type_name} has no field {', '.join(sorted(set(fields) - set(writers)))}")
        for name, value in writers.items():
            value(out, fields.get(name))

    return write


def _value_writer(kind) -> Callable[[bytearray, Any], None]:
    """Return the function that appends the value of a field."""
    from rosbags.interfaces import Nodetype
    from rosbags.serde import primitives
    from rosbags.serde.utils import SIZEMAP, ndtype

    if kind[0] == Nodetype.NAME:
        return _writer(kind[1])
    if kind[0] == Nodetype.BASE and kind[1][0] == "string":
        return _write_text
    if kind[0] == Nodetype.BASE:
        size, pack = SIZEMAP[kind[1][0]], getattr(primitives, f"pack_{kind[1][0]}_le")

        def write_number(out: bytearray, value) -> None:
            out += bytes(-len(out) % size + size)
            pack(out, len(out) - size, 0 if value is None else value)

        return write_number
    (inner, about), length = kind[1]
    is_array, item = kind[0] == Nodetype.ARRAY, _value_writer((inner, about))
    flat = inner == Nodetype.BASE
    numbers = about[0] if flat else store_of(about).fielddefs[about][1][0][1][1][0]
    empty = [None] * length if is_array else []

    def write_list(out: bytearray, values) -> None:
        values = empty if values is None else values
        if not is_array:
            out += bytes(-len(out) % 4) + len(values).to_bytes(4, "little")
        if len(values) and (isinstance(values, np.ndarray) or (flat and numbers != "string" and values is not empty)):
            table = np.ascontiguousarray(values, ndtype(numbers))
            out += bytes(-len(out) % table.itemsize) + table.tobytes()
            return
        for value in values:
            item(out, value)

    return write_list


def _write_text(out: bytearray, value: str | None) -> None:
    data = (value or "").encode() + b"\0"
    out += bytes(-len(out) % 4) + len(data).to_bytes(4, "little") + data


class MessageKind(NamedTuple):
    """A record's message: its type, record -> bytes, bytes -> record."""

    type: str
    write: Callable
    read: Callable


def _stored(type_name: str, fields: Callable, record: Callable) -> MessageKind:
    """A message that the type store writes from fields, and reads to an object from which a record is made."""
    return MessageKind(
        type_name, lambda r: serialise(type_name, fields(r)), lambda d: record(deserialise(type_name, d))
    )


def _stamped(type_name: str, record: Callable, *widths: int) -> MessageKind:
    """A message that is a header and doubles, quick: one of these comes twice in every exchange.

    widths: of the arrays of the record, one or two.
    """
    count, first = sum(widths), widths[0]

    def write(sample) -> bytes:
        values = sample[2].tolist()
        return pack_stamped(sample[0], sample[1], values if first == count else values + sample[3].tolist())

    def read(data: bytes):
        stamp, frame, numbers = unpack_stamped(data, count)
        values = np.array(numbers)
        return record(stamp, frame, *((values,) if first == count else (values[:first], values[first:])))

    return MessageKind(type_name, write, read)


def time_fields(ns: int) -> dict:
    """Return the fields of a builtin_interfaces Time or Duration."""
    return {"sec": int(ns) // SECOND, "nanosec": int(ns) % SECOND}


def _ns(time) -> int:
    return time.sec * SECOND + time.nanosec


def _header(stamp: int, frame: str) -> dict:
    return {"stamp": time_fields(stamp), "frame_id": frame}


def named(axes: str, values) -> dict:
    """Return the fields of a message with a number per axis, such as a Point or a Quaternion."""
    return dict(zip(axes, map(float, values), strict=True))


def _program(record: JointProgram) -> dict:
    points = []
    for i, ns in enumerate(record.time.tolist()):
        point = {"positions": record.position[i], "time_from_start": time_fields(ns)}
        derivatives = {"velocities": record.velocity[i], "accelerations": record.acceleration[i]}
        points.append(point | {name: row for name, row in derivatives.items() if not np.isnan(row).any()})
    return {"header": _header(record.stamp, record.frame), "joint_names": list(record.names), "points": points}


def _read_program(msg) -> JointProgram:
    times = np.array([_ns(point.time_from_start) for point in msg.points], np.int64)
    none = np.full(len(msg.joint_names), np.nan)
    rows = [
        np.array([row if len(row) else none for row in values]).reshape(-1, none.size)
        for values in zip(*((p.positions, p.velocities, p.accelerations) for p in msg.points), strict=True)
    ] or [np.empty((0, none.size))] * 3
    return JointProgram(_ns(msg.header.stamp), msg.header.frame_id, tuple(msg.joint_names), times, *rows)


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
    """Return the fields of a trajectory of the body tcp; with velocities where the trajectory has them."""
    points = []
    for i, ns in enumerate(record.time_ns.tolist()):
        turn = named("xyzw", record.quaternion[i])
        point = {"transforms": [{"translation": named("xyz", record.position[i]), "rotation": turn}]}
        if record.velocity is not None:
            point["velocities"] = [{"linear": named("xyz", record.velocity[i])}]
        points.append({**point, "time_from_start": time_fields(ns)})
    return {"header": _header(record.start_ns, record.frame), "joint_names": [TOOL], "points": points}


def trajectory_from_bytes(data: bytes, as_sent: bool = False) -> Trajectory:
    """Read a trajectory_msgs/MultiDOFJointTrajectory of the tool; raise MessageError, TrajectoryError.

    as_sent: with the quaternions of the message. They have length 1 already, and to divide them by their length
    again could change a last bit.
    """
    try:
        read = read_trajectory(bytes(data))
    except ValueError:
        raise MessageError("trajectory: cannot be read as MultiDOFJointTrajectory") from None
    if read.frame_id != WORKPIECE:
        raise MessageError(f"trajectory: the frame is {read.frame_id!r}, but must be {WORKPIECE}")
    if read.names not in ((TOOL,), (OLD_TOOL,)):
        raise MessageError(f"trajectory: must hold one transform a point, of the joint {TOOL}")
    velocity = read.velocity[:, 0, :3]
    none = np.isnan(velocity).all()
    position, quaternion = read.position[:, 0], read.quaternion[:, 0]
    run = Trajectory(read.time, position, quaternion, None if none else velocity, read.frame_id, read.stamp or 0)
    if as_sent:
        object.__setattr__(run, "quaternion", np.array(quaternion))
    return run


def _state(record: CompensatorState) -> dict:
    """A value for each field, and for each learned pass its fields behind ``learned_1.``, ``learned_2.`` ..."""
    values = {key: getattr(record, key) for key in STATE_KEYS}
    for number, part in enumerate(record.learned, 1):
        values |= {f"learned_{number}.{key}": value for key, value in part._asdict().items()}
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    message = f"{record.method}, learned from {len(record.learned)} of {record.passes} passes"
    return {"name": record.name, "message": message, "values": pairs}


def _read_state(msg) -> CompensatorState:
    values = {pair.key: pair.value for pair in msg.values}
    learned: list[LearnedRecording] = []
    try:
        while (begin := f"learned_{len(learned) + 1}.") + "fingerprint" in values:
            recording, digest = values[begin + "recording"], values[begin + "fingerprint"]
            counts = int(values[begin + "poses"]), int(values[begin + "wrenches"])
            learned.append(LearnedRecording(recording, digest, *counts))
        method, passes, finished, target, reference = (values[key] for key in STATE_KEYS)
        return CompensatorState(msg.name, method, int(passes), finished == "True", target, reference, tuple(learned))
    except KeyError as error:
        raise ValueError(f"is no state of a compensator: {error} is missing") from None


STATE_KEYS = ("method", "passes", "finished", "target", "reference")
KINDS = {
    PoseSample: _stamped("geometry_msgs/msg/PoseStamped", PoseSample, 3, 4),
    WrenchSample: _stamped("geometry_msgs/msg/WrenchStamped", WrenchSample, 6),
    TwistSample: _stamped("geometry_msgs/msg/TwistStamped", TwistSample, 6),
    JointSample: _stored(
        "sensor_msgs/msg/JointState",
        lambda r: {"header": _header(r.stamp, ""), "name": list(r.names), "position": r.position},
        lambda msg: JointSample(_ns(msg.header.stamp), tuple(msg.name), msg.position),
    ),
    ClockSample: _stored(
        "rosgraph_msgs/msg/Clock", lambda r: {"clock": time_fields(r.stamp)}, lambda msg: ClockSample(_ns(msg.clock))
    ),
    Text: _stored("std_msgs/msg/String", lambda record: {"data": record.text}, lambda msg: Text(msg.data)),
    JointProgram: _stored("trajectory_msgs/msg/JointTrajectory", _program, _read_program),
    StockMap: _stored("nav_msgs/msg/OccupancyGrid", _map, _read_map),
    CompensatorState: _stored("diagnostic_msgs/msg/DiagnosticStatus", _state, _read_state),
    Trajectory: MessageKind(TRAJECTORY, lambda run: serialise(TRAJECTORY, _trajectory(run)), trajectory_from_bytes),
}


def _by_type(kinds: Iterable[MessageKind]) -> dict[str, Callable]:
    """Return the reader of each type; raise ValueError for two records of one type: no reader could choose one."""
    readers: dict[str, Callable] = {}
    for kind in kinds:
        if kind.type in readers:
            raise ValueError(f"{kind.type} has a record already: one record carries a type")
        readers[kind.type] = kind.read
    return readers


READERS = _by_type(KINDS.values())


def type_of(record) -> str:
    """The type of the message that carries a record or records of a class."""
    return KINDS[record if isinstance(record, type) else type(record)].type


def to_bytes(record) -> bytes:
    """The message that carries a record, serialised; a Trajectory becomes one of the body tcp."""
    return KINDS[type(record)].write(record)


def from_bytes(type_name: str, data: bytes):
    """The record of a serialised message.

    Raises ValueError where the bytes are no such message, KeyError for a type without a record, and what
    ``trajectory_from_bytes`` raises.
    """
    return READERS[type_name](data)
