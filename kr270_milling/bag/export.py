"""Topics as tables: CSV, and Parquet where pyarrow is installed. Message by message, so that memory stays bounded."""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from kr270_milling.bag.reader import Recording
from kr270_milling.bag.sink import open_directory
from kr270_milling.base.errors import RecordingError
from kr270_milling.messages.decode import plain
from kr270_milling.messages.series import FIXED, JOINTS, batches, joint_parts
from kr270_milling.messages.trajectory import TRAJECTORY, trajectories

__all__ = ["export_csv", "export_parquet"]

Table = tuple[list[str], list]  # column names; columns of equal length
TIMES = ["log_time_ns", "stamp_ns", "frame_id"]
POINT = ([f"position_{a}_m" for a in "xyz"] + [f"orientation_{a}" for a in "xyzw"],
         [f"velocity_{a}_m_per_s" for a in "xyz"] + [f"angular_velocity_{a}_rad_per_s" for a in "xyz"],
         [f"acceleration_{a}_m_per_s2" for a in "xyz"] + [f"angular_acceleration_{a}_rad_per_s2" for a in "xyz"],
)  # fmt: skip
TWIST = "geometry_msgs/msg/TwistStamped"
MAX_FILES = 100  # of one topic; a new one begins where the columns change
ROWS, ROW_BYTES = 1024, 1024 * 1024  # of messages in one table; as Python's numbers and texts they take far more


def _tables(recording: Recording, topic: str, type_name: str) -> Iterator[Table]:
    if type_name in FIXED or type_name == JOINTS:
        return _series_tables(recording, topic, type_name)
    if type_name == TRAJECTORY:
        return _trajectory_tables(recording, topic)
    return _any_tables(recording, topic)


def _series_tables(recording: Recording, topic: str, type_name: str) -> Iterator[Table]:
    for rows in batches(recording, topic):
        times = [rows.log_time, rows.stamp, rows.frame_ids]
        if type_name == JOINTS:
            names = [_word(name) for name in rows.layout.names]
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
            prefix = f"{_word(name)}_" if len(found.names) > 1 else ""
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


def _word(text: str) -> str:
    return re.sub(r"\W+", "_", text).strip("_")[:100] or "unnamed"


def _export(recording: Recording, directory, topics, progress, open_table: Callable, suffix: str) -> list[Path]:
    directory = Path(os.path.abspath(directory))
    known = recording.topics()
    missing = sorted(set(topics or ()) - set(known))
    if missing:
        raise RecordingError(recording.path, f"has no topic {', '.join(missing)}")
    handle = open_directory(directory)
    files: list[Path] = []
    done = 0
    try:
        for topic, about in known.items():
            if about.count and (topics is None or topic in topics):
                files += _export_topic(recording, topic, about.type, handle, directory, open_table, suffix, files)
            done += about.count
            if progress:
                progress(done, recording.count)
    except OSError as error:
        raise RecordingError(directory, f"the tables cannot be written: {error.strerror or error}") from error
    finally:
        os.close(handle)
    return files


def _export_topic(recording, topic, type_name, handle, directory, open_table, suffix, others) -> list[Path]:
    """A topic's files: one, and a further one each time the columns change. They appear when all are written."""
    files: list[Path] = []
    whole = False

    def begin(names: list[str]):
        if len(files) == MAX_FILES:
            raise RecordingError(recording.path, f"the columns of {topic} change more than {MAX_FILES} times")
        files.append(_free_path(directory, _word(topic), suffix, [*others, *files]))
        return open_table(_create(handle, files[-1]), names)

    try:
        _write_all(_tables(recording, topic, type_name), begin)
        whole = True
    finally:
        for path in files:
            _settle(handle, path, whole)
    return files


def _write_all(tables: Iterator[Table], begin: Callable) -> None:
    table, columns = None, None
    try:
        for names, values in tables:
            if names != columns:
                if table:
                    table.close()
                    table = None
                table, columns = begin(names), names
            table.write(values)
    finally:
        if table:
            table.close()  # raises once more where the disk is full


def _free_path(directory: Path, stem: str, suffix: str, taken: list[Path]) -> Path:
    number, path = 1, directory / f"{stem}.{suffix}"
    while path in taken:
        number += 1
        path = directory / f"{stem}_{number}.{suffix}"
    return path


def _create(handle: int, path: Path):
    """A new file in the directory, under a name of its own until it is whole; a link there is not followed."""
    with suppress(FileNotFoundError):
        os.unlink(_part(path), dir_fd=handle)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    return os.fdopen(os.open(_part(path), flags, 0o666, dir_fd=handle), "wb")


def _part(path: Path) -> str:
    return f".{path.name}.{os.getpid()}.part"


def _settle(handle: int, path: Path, whole: bool) -> None:
    """Give a file its name, in place of one that has it, a link included; or remove what is not whole."""
    if whole:
        os.replace(_part(path), path.name, src_dir_fd=handle, dst_dir_fd=handle)
        return
    with suppress(FileNotFoundError):
        os.unlink(_part(path), dir_fd=handle)


class _CsvTable:
    def __init__(self, stream, names: list[str]):
        import io

        self._stream = io.TextIOWrapper(stream, encoding="utf-8", newline="")
        self._writer = csv.writer(self._stream)
        self._writer.writerow(names)

    def write(self, columns: list) -> None:
        # Python's numbers print as the shortest text that reads back to the same bits
        lists = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns]
        self._writer.writerows(zip(*lists, strict=True))

    def close(self) -> None:
        self._stream.close()


class _ParquetTable:
    def __init__(self, stream, names: list[str]):
        self._stream, self._names, self._writer = stream, names, None

    def write(self, columns: list) -> None:
        import pyarrow
        import pyarrow.parquet

        schema = self._writer.schema if self._writer else None
        table = pyarrow.table(dict(zip(self._names, map(list, columns), strict=True)), schema=schema)
        if self._writer is None:
            self._writer = pyarrow.parquet.ParquetWriter(self._stream, table.schema)
        self._writer.write_table(table)

    def close(self) -> None:
        if self._writer:
            self._writer.close()
        self._stream.close()


def export_csv(
    recording: Recording, directory, topics: Collection[str] | None = None, progress: Callable | None = None
) -> list[Path]:
    """Write a CSV file per topic into a directory and return the files; progress(messages done, of all)."""
    return _export(recording, directory, topics, progress, _CsvTable, "csv")


def export_parquet(
    recording: Recording, directory, topics: Collection[str] | None = None, progress: Callable | None = None
) -> list[Path]:
    """The same as Parquet; raises RecordingError where pyarrow is not installed."""
    import importlib.util

    if importlib.util.find_spec("pyarrow") is None:
        raise RecordingError(directory, "Parquet needs the package pyarrow, which is not installed")
    return _export(recording, directory, topics, progress, _ParquetTable, "parquet")
