"""Topics as files: CSV, and Parquet where pyarrow is installed."""

from __future__ import annotations

import csv
import importlib.util
import io
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kr270_milling.bag.reader import Recording
from kr270_milling.bag.tables import Table, tables, word
from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.base.files import staged

__all__ = ["Exported", "export_csv", "export_parquet"]

MAX_FILES = 100  # of one topic; a new one begins where the columns change


@dataclass
class Exported:
    """What was written, and why a topic was not."""

    files: list[Path] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)  #: topic -> sentence


def export_csv(
    recording: Recording, directory, topics: Collection[str] | None = None, progress: Callable | None = None
) -> Exported:
    """Write a CSV file per topic into a directory; progress(messages done, of all). A topic that cannot be read is
    named in the result, and the others are written. Raises RecordingError for an unknown topic and a full disk."""
    return _export(recording, directory, topics, progress, _CsvTable, "csv")


def export_parquet(
    recording: Recording, directory, topics: Collection[str] | None = None, progress: Callable | None = None
) -> Exported:
    """The same as Parquet; raises RecordingError where pyarrow is not installed."""
    if importlib.util.find_spec("pyarrow") is None:
        raise RecordingError(directory, "Parquet needs the package pyarrow, which is not installed")
    return _export(recording, directory, topics, progress, _ParquetTable, "parquet")


def _export(recording: Recording, directory, topics, progress, open_table: Callable, suffix: str) -> Exported:
    known = recording.topics()
    missing = sorted(set(topics or ()) - set(known))
    if missing:
        raise RecordingError(recording.path, f"has no topic {', '.join(missing)}")
    result, done = Exported(), 0
    try:
        Path(directory).mkdir(parents=True, exist_ok=True)
        for topic, about in known.items():
            if about.count and (topics is None or topic in topics):
                _export_topic(recording, topic, Path(directory), open_table, suffix, result)
            done += about.count
            if progress:
                progress(done, recording.count)
    except OSError as error:
        raise RecordingError(directory, f"the tables cannot be written: {error.strerror or error}") from error
    except InputError as error:
        raise RecordingError(directory, error.reason) from error
    return result


def _export_topic(recording: Recording, topic: str, directory: Path, open_table, suffix: str, result: Exported) -> None:
    """A topic's files: one, and a further one each time the columns change. They appear when all are written."""
    files: list[Path] = []
    try:
        with staged(directory) as (draft, final):

            def begin(names: list[str]):
                if len(files) == MAX_FILES:
                    raise RecordingError(recording.path, f"the columns of {topic} change more than {MAX_FILES} times")
                files.append(_free_path(directory, word(topic), suffix, [*result.files, *files]))
                return open_table(open(draft / files[-1].name, "xb"), names)

            _write_all(tables(recording, topic, recording.topics()[topic].type), begin)
    except RecordingError as error:
        result.refused[topic] = str(error)
    else:
        result.files += files


def _write_all(parts: Iterator[Table], begin: Callable) -> None:
    table: Any = None
    columns = None
    try:
        for names, values in parts:
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


class _CsvTable:
    def __init__(self, stream, names: list[str]):
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
        self._stream, self._names = stream, names
        self._writer: Any = None

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
