"""The cell that a recording was made with, out of its attachments; and its messages as they were written."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import yaml

from kr270_milling.bag.reader import RawMessage, Recording
from kr270_milling.base import parameter_file as config_file
from kr270_milling.base.errors import ConfigError, RecordingError, one_line
from kr270_milling.base.parameter_file import read_tree
from kr270_milling.cell.cell import Cell, read_cell

__all__ = ["CELL", "cell_of", "in_file_order", "is_first_version", "plant_of"]

CELL, PLANT = "cell.yaml", "plant.yaml"
FEED = 30.0  # [us] of work on a message that goes through the nodes' protocols
LONGEST_NAME = 200  # [bytes], of an attached file
MOST_ATTACHED = 64 * 1024 * 1024  # [bytes] of attachments that are unpacked to read the cell
#: what version 0.1.0 did where its cells have no key for it: group, key, value
FIRST_VERSION = (
    ("dynamics", "reference_inertia", "false"),
    ("cutting", "moments", "false"),
    ("cutting", "chip_angle", "nominal"),
)


def cell_of(recording: Recording) -> Cell:
    """The cell that the recording was made with: the attached ``cell.yaml``, or the only attached YAML file.

    Files that it names (includes, a tool path) are taken from the attachments too, and only then from the shipped
    ones. Raises RecordingError, ConfigError.
    """
    names = [a.name for a in recording.attachments if _is_plain(a.name)]
    parameter_files = [n for n in names if n.endswith((".yaml", ".yml")) and n != PLANT]
    if CELL not in names and len(parameter_files) != 1:
        what = f"has {', '.join(sorted(parameter_files))}" if parameter_files else "has no parameter file"
        raise RecordingError(recording.path, f"{what} attached, but {CELL} is needed to recompute it")
    if sum(a.size for a in recording.attachments) > MOST_ATTACHED:
        raise RecordingError(recording.path, "holds more attachments than a cell needs")
    return _read(recording, CELL if CELL in names else parameter_files[0], names)


def plant_of(recording: Recording, cell: Cell) -> Cell:
    """What cut in the pass: the attached ``plant.yaml``, else the cell itself."""
    names = [a.name for a in recording.attachments if _is_plain(a.name)]
    return _read(recording, PLANT, names) if PLANT in names else cell


def _read(recording: Recording, main: str, names: list[str]) -> Cell:
    with tempfile.TemporaryDirectory() as directory:
        for name in names:
            Path(directory, name).write_bytes(recording.attachment(name))
        _localise(recording, Path(directory, main), names, set())
        try:
            cell = read_cell(Path(directory, main), _as_written(recording, Path(directory, main)))
            cell.timed_path  # noqa: B018 - reads the tool path while its file is there
        except ConfigError as error:
            where = f"{recording.path}, attached {Path(error.file).name}"
            raise ConfigError(where, error.key, error.value, error.allowed) from error
    return cell


def is_first_version(recording: Recording) -> bool:
    """Whether version 0.1.0 wrote it."""
    return recording.library.startswith("kr270_milling/0.1.")


def _as_written(recording: Recording, file: Path) -> tuple[str, ...]:
    """Assignments for keys that the attached cell does not have because its writer did not know them.

    Version 0.1.0 had eq. (1) as printed, forces only, and chips over the nominal angle.
    """
    if not is_first_version(recording):
        return ()
    tree, found = read_tree(file), []
    for group, key, value in FIRST_VERSION:
        known = tree.get(group)
        if isinstance(known, dict) and key not in known:
            found.append(f"{group}.{key}={value}")
    return tuple(found)


def _is_plain(name: str) -> bool:
    alone = bool(name) and name == Path(name).name and name not in (".", "..") and "\0" not in name
    return alone and len(name.encode()) <= LONGEST_NAME


def _localise(recording: Recording, file: Path, names: list[str], seen: set[str]) -> None:
    """Let a parameter file, and those that it includes, name the attached files, wherever they lay; none of them may
    make us read any other file of this machine but a shipped one."""
    seen.add(file.name)
    parameters, tree = _parameters(file)
    includes, path = parameters.get("includes"), parameters.get("path")
    includes, path = includes if isinstance(includes, list) else [], path if isinstance(path, dict) else {}
    named = [*includes, *([path["file"]] if path.get("file") else [])]
    far = [n for n in named if not isinstance(n, str) or not _is_plain(n)]
    foreign = [n for n in far if not isinstance(n, str) or Path(n).name not in names]
    if foreign:
        reason = f"its {file.name} names {repr(foreign[0])[:100]}, which is not attached"
        raise RecordingError(recording.path, one_line(reason))
    if far:
        includes[:] = [Path(n).name for n in includes]
        if path.get("file"):
            path["file"] = Path(path["file"]).name
        file.write_text(yaml.safe_dump(tree), encoding="utf-8")
    for name in includes:
        if Path(name).name in names and Path(name).name not in seen:
            _localise(recording, file.with_name(Path(name).name), names, seen)


def _parameters(file: Path) -> tuple[dict, dict]:
    """The parameters and the whole tree of an attached file; nothing of what cannot be used: read_cell tells why."""
    try:
        tree = config_file.read_yaml(file)
        parameters = tree["/**"]["ros__parameters"]
    except (ConfigError, LookupError, TypeError):
        return {}, {}
    return (parameters, tree) if isinstance(parameters, dict) else ({}, {})


def in_file_order(recording: Recording, progress=None) -> Iterator[RawMessage]:
    """All messages as they were written: several passes, whose stamps begin at 0 each, stay apart.

    Raises RecordingError where the file is damaged.
    """
    for done, message in enumerate(recording.messages(as_written=True), 1):
        yield message
        if done % 1000 == 0:
            recording.spend(1000 * FEED)
        if progress and (done % 1000 == 0 or done == recording.count):
            progress(done, recording.count)
