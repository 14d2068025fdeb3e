"""Topics as tables, message by message, so that memory stays bounded."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

import numpy as np

from kr270_milling.bag.reader import Recording
from kr270_milling.messages.decode import plain
from kr270_milling.messages.series import FIXED, JOINTS, batches, joint_parts
from kr270_milling.messages.trajectory import TRAJECTORY, trajectories

__all__ = ["Table", "tables", "word"]

Table = tuple[list[str], list]  # column names; columns of equal length
TIMES = ["log_time_ns", "stamp_ns", "frame_id"]
POINT = ([f"position_{a}_m" for a in "xyz"] + [f"orientation_{a}" for a in "xyzw"],
         [f"velocity_{a}_m_per_s" for a in "xyz"] + [f"angular_velocity_{a}_rad_per_s" for a in "xyz"],
         [f"acceleration_{a}_m_per_s2" for a in "xyz"] + [f"angular_acceleration_{a}_rad_per_s2" for a in "xyz"],
)  # fmt: skip
TWIST = "geometry_msgs/msg/TwistStamped"
ROWS, ROW_BYTES = 1024, 1024 * 1024  # of messages in one table; as Python's numbers and texts they take far more


def tables(recording: Recording, topic: str, type_name: str) -> Iterator[Table]:
    """The messages of a topic as tables; a new one may have other columns. Raises RecordingError."""
    if type_name in FIXED or type_name == JOINTS:
        return _series_tables(recording, topic, type_name)
    if type_name == TRAJECTORY:
        return _trajectory_tables(recording, topic)
    return _any_tables(recording, topic)


def _series_tables(recording: Recording, topic: str, type_name: str) -> Iterator[Table]:
    for rows in batches(recording, topic):
        times = [rows.log_time, rows.stamp, rows.frame_ids]
        if type_name == JOINTS:
            names = [word(name) for name in rows.layout.names]
            kinds = [("position", "rad"), ("velocity", "rad_per_s"), ("effort", "n_m")]
            columns = [f"{kind}_{name}_{unit}" for kind, unit in kinds for name in names]
            values = np.hstack(joint_parts(rows))
        else:
            columns = [f"{name}_{unit}" if unit else name for name, unit in _units(type_name, topic)]
            values = rows.values
        yield TIMES + columns, times + list(values.T)


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


def _any_tables(recording: Recording, topic: str) -> Iterator[Table]:
    """Any other type: a column per number or text, sequences as JSON in one cell."""
    rows, columns, size = [], None, 0
    for message, decoded in recording.decoded([topic], as_written=True):
        cells = {"log_time_ns": message.log_time, **_flat(plain(decoded))}
        if rows and (columns != list(cells) or len(rows) == ROWS or size + len(message.data) > ROW_BYTES):
            yield columns, list(zip(*rows, strict=True))
            rows, size = [], 0
        columns, size = list(cells), size + len(message.data)
        rows.append(list(cells.values()))
    if rows:
        yield columns, list(zip(*rows, strict=True))


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
