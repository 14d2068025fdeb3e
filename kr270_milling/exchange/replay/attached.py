"""The cell that a recording was made with, from its attachments."""

from __future__ import annotations

import tempfile
from pathlib import Path

import yaml

from kr270_milling.base.errors import ConfigError, RecordingError, one_line
from kr270_milling.base.parameter_file import find_file, read_yaml
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import path_of
from kr270_milling.recordings.bag.reader import Recording

__all__ = ["attached_cell", "recorded_cells"]

CELL, PLANT = "cell.yaml", "plant.yaml"


def attached_cell(recording: Recording) -> Cell:
    """Return the cell of the attached ``cell.yaml``, or of the only attached YAML file.

    Files that the cell names (includes, a tool path) are read from the attachments, else from the shipped files.
    Raises RecordingError, ConfigError.
    """
    names = _names(recording)
    parameter_files = [n for n in names if n.endswith((".yaml", ".yml")) and n != PLANT]
    if CELL not in names and len(parameter_files) != 1:
        what = f"has {', '.join(sorted(parameter_files))}" if parameter_files else "has no parameter file"
        raise RecordingError(
            recording.path, f"{what} attached, but {CELL} is needed to recompute it; give it by --cell"
        )
    if sum(a.size for a in recording.attachments) > 64 * 1024 * 1024:
        raise RecordingError(recording.path, "holds more attachments than a cell needs")
    return _read(recording, CELL if CELL in names else parameter_files[0])


def recorded_cells(recording: Recording, file=None) -> tuple[Cell, Cell]:
    """Return the cell that planned a pass and the one that cut in it, the attached ``plant.yaml`` if there is one.

    file: of the cell, for a recording without it, as of ``ros2 bag record``. Raises RecordingError, ConfigError.
    """
    cell = attached_cell(recording) if file is None else read_cell(find_file(file))
    return cell, _read(recording, PLANT) if PLANT in _names(recording) else cell


def _names(recording: Recording) -> set[str]:
    """Return the names of the attachments that can be files in one directory."""
    return {about.name for about in recording.attachments if _is_plain(about.name)}


def _is_plain(name: str) -> bool:
    alone = bool(name) and name == Path(name).name and name not in (".", "..") and "\0" not in name
    return alone and len(name.encode()) <= 200  # bytes


def _read(recording: Recording, main: str) -> Cell:
    with tempfile.TemporaryDirectory() as directory:
        names, file = _names(recording), Path(directory, main)
        for name in names:
            Path(directory, name).write_bytes(recording.attachment(name))
        _localise(recording, file, names, set())
        try:
            cell = read_cell(file)
            path_of(cell).timed  # noqa: B018 - reads the tool path while its file is there
        except ConfigError as error:
            where = f"{recording.path}, attached {Path(error.file).name}"
            raise ConfigError(where, error.key, error.value, error.allowed) from error
    return cell


def _localise(recording: Recording, file: Path, names: set[str], visited: set[str]) -> None:
    """Make a parameter file, and its includes, name the attached files instead of their original places.

    Raises RecordingError where a parameter file names a file that is neither attached nor shipped.
    """
    visited.add(file.name)
    try:
        tree = read_yaml(file)
        parameters = tree["/**"]["ros__parameters"]
    except (ConfigError, LookupError, TypeError):
        return  # read_cell reports the error
    includes, path = (parameters.get("includes"), parameters.get("path")) if isinstance(parameters, dict) else ([], {})
    includes, path = includes if isinstance(includes, list) else [], path if isinstance(path, dict) else {}
    named = [*includes, *filter(None, [path.get("file")])]
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
        if Path(name).name in names and Path(name).name not in visited:
            _localise(recording, file.with_name(Path(name).name), names, visited)
