"""Topics as tables, message by message, so that memory stays bounded."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator

import numpy as np

from kr270_milling.bag.reader import Recording
from kr270_milling.base.errors import RecordingError
from kr270_milling.base.units import SECOND
from kr270_milling.messages.decode import plain
from kr270_milling.messages.series import FIXED, batches
from kr270_milling.messages.trajectory import TRAJECTORY, trajectories

__all__ = ["Table", "tables", "word"]

Table = tuple[list[str], list]  # column names; columns of equal length
TIMES = ["log_time_ns", "stamp_ns", "frame_id"]
POINT = ([f"position_{a}_m" for a in "xyz"] + [f"orientation_{a}" for a in "xyzw"],
         [f"velocity_{a}_m_per_s" for a in "xyz"] + [f"angular_velocity_{a}_rad_per_s" for a in "xyz"],
         [f"acceleration_{a}_m_per_s2" for a in "xyz"] + [f"angular_acceleration_{a}_rad_per_s2" for a in "xyz"],
)  # fmt: skip
JOINTS = "sensor_msgs/msg/JointState"
TWIST = "geometry_msgs/msg/TwistStamped"
ROWS, ROW_BYTES = 1024, 1024 * 1024  # of messages in one table; as Python's numbers and texts they take far more


def tables(recording: Recording, topic: str, type_name: str) -> Iterator[Table]:
    """The messages of a topic as tables; a new one may have other columns. Raises RecordingError."""
    if type_name in FIXED:
        return _series_tables(recording, topic, type_name)
    if type_name == TRAJECTORY:
        return _trajectory_tables(recording, topic)
    return _any_tables(recording, topic, _joint_cells if type_name == JOINTS else _any_cells)


def _series_tables(recording: Recording, topic: str, type_name: str) -> Iterator[Table]:
    columns = [f"{name}_{unit}" if unit else name for name, unit in _units(type_name, topic)]
    for rows in batches(recording, topic):
        yield TIMES + columns, [rows.log_time, rows.stamp, rows.frame_ids, *rows.values.T]


def _units(type_name: str, topic: str) -> list[tuple[str, str]]:
    if type_name != TWIST:
        return FIXED[type_name]
    # a deflection is a displacement in the message of a velocity
    units = ("m", "rad") if topic.split("/")[-1] == "deflection" else ("m_per_s", "rad_per_s")
    return [(name, units[name.startswith("angular")]) for name, _ in FIXED[TWIST]]


def _trajectory_tables(recording: Recording, topic: str) -> Iterator[Table]:
    """One row per point; the columns of a body carry its name if there are several."""
    for number, found in enumerate(trajectories(recording, topic)):
        count = len(found.time)
        columns = ["message", "stamp_ns", "frame_id", "time_from_start_ns"]
        values = [[number] * count, [found.stamp] * count, [found.frame_id] * count, found.time]
        for j, name in enumerate(found.names):
            prefix = f"{word(name)}_" if len(found.names) > 1 else ""
            pose = np.hstack([found.position[:, j], found.quaternion[:, j]])
            for names, part in zip(POINT, (pose, found.velocity[:, j], found.acceleration[:, j]), strict=True):
                columns += [prefix + column for column in names]
                values += list(part.T)
        yield columns, values


def _any_tables(recording: Recording, topic: str, cells_of: Callable[[object], dict]) -> Iterator[Table]:
    """Any other type, row by row."""
    rows: list[list] = []
    columns: list[str] = []
    size = 0
    for message, decoded in recording.decoded([topic], as_written=True):
        try:
            cells = {"log_time_ns": message.log_time, **cells_of(decoded)}
        except ValueError as error:
            raise RecordingError(recording.path, f"a message on {topic} {error}") from error
        if rows and (columns != list(cells) or len(rows) == ROWS or size + len(message.data) > ROW_BYTES):
            yield columns, list(zip(*rows, strict=True))
            rows, size = [], 0
        columns, size = list(cells), size + len(message.data)
        rows.append(list(cells.values()))
    if rows:
        yield columns, list(zip(*rows, strict=True))


def _joint_cells(state) -> dict:
    """A column per joint and quantity; what a message leaves out is NaN."""
    stamp = state.header.stamp
    cells = {"stamp_ns": stamp.sec * SECOND + stamp.nanosec, "frame_id": state.header.frame_id}
    for kind, unit in (("position", "rad"), ("velocity", "rad_per_s"), ("effort", "n_m")):
        values = getattr(state, kind).tolist() or [math.nan] * len(state.name)
        if len(values) != len(state.name):
            raise ValueError(f"names {len(state.name)} joints and gives {len(values)} values of {kind}")
        cells.update({f"{kind}_{word(name)}_{unit}": value for name, value in zip(state.name, values, strict=True)})
    return cells


def _any_cells(message) -> dict:
    """A column per number or text, sequences as JSON in one cell."""
    return _flat(plain(message))


def _flat(value: dict, prefix: str = "") -> dict:
    cells = {}
    for key, item in value.items():
        if isinstance(item, dict):
            cells.update(_flat(item, f"{prefix}{key}_"))
        else:
            cells[prefix + key] = json.dumps(item) if isinstance(item, list) else item
    return cells


def word(text: str) -> str:
    """A name without signs that a file name or a column cannot have."""
    return re.sub(r"\W+", "_", text).strip("_")[:100] or "unnamed"
