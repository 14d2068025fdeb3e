"""Export topics as CSV files, message by message, with bounded memory."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
import operator
import re
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.base.files import staged
from kr270_milling.base.units import SECOND
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import FIXED, TRAJECTORY, read_trajectory, unpack_stamped
from kr270_milling.recordings.messages.definitions import plain

Row = tuple[list[str], list]  # names of the columns, cells


def export(
    recording: Recording,
    directory,
    topics: Collection[str] | None = None,
    progress: Callable | None = None,
) -> tuple[list[Path], dict[str, str]]:
    """Write one file for each topic into a directory; progress(messages done, of all).

    Returns the written files, and a sentence for each topic that cannot be read; the other topics are written. Raises
    RecordingError for an unknown topic and a full disk.
    """
    known = recording.topics()
    missing = sorted(set(topics or ()) - set(known))
    if missing:
        raise RecordingError(recording.path, f"has no topic {', '.join(missing)}")
    files: list[Path] = []
    refused: dict[str, str] = {}
    exported = 0
    try:
        Path(directory).mkdir(parents=True, exist_ok=True)
        for topic, about in known.items():
            if about.count and (topics is None or topic in topics):
                try:
                    files += _export_topic(recording, topic, Path(directory), files)
                except RecordingError as error:
                    refused[topic] = str(error)
            exported += about.count
            if progress:
                progress(exported, recording.count)
    except OSError as error:
        raise RecordingError(directory, f"the tables cannot be written: {error.strerror or error}") from error
    except InputError as error:
        raise RecordingError(directory, error.reason) from error
    return files, refused


def _export_topic(recording: Recording, topic: str, directory: Path, taken: list[Path]) -> list[Path]:
    """Write the files of a topic: a new file each time the columns change. They appear when all are complete."""
    max_files = 100  # most files of a topic; a new file begins when the columns change
    files: list[Path] = []
    with staged(directory) as (draft, _):
        for columns, alike in itertools.groupby(rows(recording, topic), key=operator.itemgetter(0)):
            if len(files) == max_files:
                raise RecordingError(recording.path, f"the columns of {topic} change more than {max_files} times")
            number, file = 1, directory / f"{_word(topic)}.csv"
            while file in (*taken, *files):  # another topic has this name
                number += 1
                file = directory / f"{_word(topic)}_{number}.csv"
            files.append(file)
            with open(draft / files[-1].name, "xb") as stream:
                _write_csv(stream, columns, (cells for _, cells in alike))
    return files


def _write_csv(stream, columns: list[str], rows: Iterable[list]) -> None:
    with io.TextIOWrapper(stream, encoding="utf-8", newline="") as text:
        writer = csv.writer(text)
        writer.writerow(map(_inert, columns))
        writer.writerows(map(_inert, row) for row in rows)  # a number is the shortest text that gives the same bits


def _inert(cell):
    """Return a cell that no spreadsheet takes for a formula: an apostrophe before texts such as =1+1."""
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(("=", "+", "-", "@", "\t", "\r")) else cell


def rows(recording: Recording, topic: str) -> Iterator[Row]:
    """Yield the messages of a topic as rows; columns may change from row to row. Raises RecordingError."""
    kind = recording.topics()[topic].type
    try:
        if kind in FIXED:
            yield from _series_rows(recording, topic, kind)
        elif kind == TRAJECTORY:
            yield from _trajectory_rows(recording, topic)
        else:
            cells_of = _joint_cells if kind == "sensor_msgs/msg/JointState" else lambda message: _flat(plain(message))
            decode = recording.decoder(topic)
            for message in recording.messages([topic]):
                cells = {"log_time_ns": message.log_time, **cells_of(decode(message.data))}
                yield list(cells), list(cells.values())
    except ValueError as error:
        raise RecordingError(recording.path, f"a message on {topic} is not a {kind}: {error}") from error


def _series_rows(recording: Recording, topic: str, kind: str) -> Iterator[Row]:
    units = FIXED[kind]
    if kind == "geometry_msgs/msg/TwistStamped":  # a deflection is a displacement in the fields of a velocity
        deflection = topic.split("/")[-1] == "deflection"
        linear, angular = ("m", "rad") if deflection else ("m_per_s", "rad_per_s")
        units = [(name, linear if name.startswith("linear") else angular) for name, _ in units]
    columns = ["log_time_ns", "stamp_ns", "frame_id", *(f"{name}_{unit}" if unit else name for name, unit in units)]
    for message in recording.messages([topic]):
        stamp, frame, numbers = unpack_stamped(message.data, len(units), alone=True)
        yield columns, [message.log_time, stamp, frame, *numbers]


def _trajectory_rows(recording: Recording, topic: str) -> Iterator[Row]:
    """Yield one row for each point; with several bodies the columns have the name of the body."""
    quantities = [
        *(f"position_{a}_m" for a in "xyz"),
        *(f"orientation_{a}" for a in "xyzw"),
        *(f"velocity_{a}_m_per_s" for a in "xyz"),
        *(f"angular_velocity_{a}_rad_per_s" for a in "xyz"),
        *(f"acceleration_{a}_m_per_s2" for a in "xyz"),
        *(f"angular_acceleration_{a}_rad_per_s2" for a in "xyz"),
    ]
    for number, message in enumerate(recording.messages([topic])):
        trajectory = read_trajectory(message.data)
        prefixes = [f"{_word(name)}_" if len(trajectory.names) > 1 else "" for name in trajectory.names]
        columns = ["message", "stamp_ns", "frame_id", "time_from_start_ns"]
        columns += [prefix + name for prefix in prefixes for name in quantities]
        bodies = np.concatenate(
            [trajectory.position, trajectory.quaternion, trajectory.velocity, trajectory.acceleration], axis=2
        )
        for time, body in zip(trajectory.time.tolist(), bodies, strict=True):
            yield columns, [number, trajectory.stamp, trajectory.frame_id, time, *body.ravel().tolist()]


def _joint_cells(state) -> dict:
    """Return a column for each joint and quantity; missing values are NaN."""
    stamp = state.header.stamp
    cells = {"stamp_ns": stamp.sec * SECOND + stamp.nanosec, "frame_id": state.header.frame_id}
    for kind, unit in (("position", "rad"), ("velocity", "rad_per_s"), ("effort", "n_m")):
        values = getattr(state, kind).tolist() or [math.nan] * len(state.name)
        if len(values) != len(state.name):
            raise ValueError(f"names {len(state.name)} joints and gives {len(values)} values of {kind}")
        cells.update({f"{kind}_{_word(name)}_{unit}": value for name, value in zip(state.name, values, strict=True)})
    return cells


def _flat(value: dict, prefix: str = "") -> dict:
    """Return a column for each number or text; a sequence is JSON in one cell."""
    cells = {}
    for key, item in value.items():
        if isinstance(item, dict):
            cells.update(_flat(item, f"{prefix}{key}_"))
        else:
            cells[prefix + key] = json.dumps(item) if isinstance(item, list) else item
    return cells


def _word(text: str) -> str:
    """Replace characters that a file name or a column cannot contain."""
    return re.sub(r"\W+", "_", text).strip("_")[:100] or "unnamed"
