"""The cell that a recording was made with, out of its attachments."""

from __future__ import annotations

import tempfile
from pathlib import Path

import yaml

from kr270_milling.bag.reader import Recording
from kr270_milling.base.errors import ConfigError, RecordingError, one_line
from kr270_milling.base.parameter_file import read_tree, read_yaml
from kr270_milling.cell.cell import Cell, read_cell

__all__ = ["CELL", "cell_of", "is_first_version", "plant_of"]

CELL, PLANT = "cell.yaml", "plant.yaml"
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
    names = _names(recording)
    parameter_files = [n for n in names if n.endswith((".yaml", ".yml")) and n != PLANT]
    if CELL not in names and len(parameter_files) != 1:
        what = f"has {', '.join(sorted(parameter_files))}" if parameter_files else "has no parameter file"
        raise RecordingError(recording.path, f"{what} attached, but {CELL} is needed to recompute it")
    if sum(a.size for a in recording.attachments) > MOST_ATTACHED:
        raise RecordingError(recording.path, "holds more attachments than a cell needs")
    return _read(recording, CELL if CELL in names else parameter_files[0])


def plant_of(recording: Recording, cell: Cell) -> Cell:
    """What cut in the pass: the attached ``plant.yaml``, else the cell itself."""
    return _read(recording, PLANT) if PLANT in _names(recording) else cell


def is_first_version(recording: Recording) -> bool:
    """Whether version 0.1.0 wrote it."""
    return recording.library.startswith("kr270_milling/0.1.")


def _names(recording: Recording) -> set[str]:
    """Of the attachments that can be files in one directory."""
    return {about.name for about in recording.attachments if _is_plain(about.name)}


def _is_plain(name: str) -> bool:
    alone = bool(name) and name == Path(name).name and name not in (".", "..") and "\0" not in name
    return alone and len(name.encode()) <= LONGEST_NAME


def _read(recording: Recording, main: str) -> Cell:
    with tempfile.TemporaryDirectory() as directory:
        names, file = _names(recording), Path(directory, main)
        for name in names:
            Path(directory, name).write_bytes(recording.attachment(name))
        _localise(recording, file, names, set())
        try:
            cell = read_cell(file, _first_version_terms(file) if is_first_version(recording) else ())
            cell.timed_path  # noqa: B018 - reads the tool path while its file is there
        except ConfigError as error:
            where = f"{recording.path}, attached {Path(error.file).name}"
            raise ConfigError(where, error.key, error.value, error.allowed) from error
    return cell


def _first_version_terms(file: Path) -> tuple[str, ...]:
    """Assignments for keys that a cell does not have because version 0.1.0 did not know them.

    It had eq. (1) as printed, forces only, and chips over the nominal angle.
    """
    tree = read_tree(file)
    lacking = [(g, k, v) for g, k, v in FIRST_VERSION if isinstance(tree.get(g), dict) and k not in tree[g]]
    return tuple(f"{group}.{key}={value}" for group, key, value in lacking)


def _localise(recording: Recording, file: Path, names: set[str], seen: set[str]) -> None:
    """Let a parameter file, and those that it includes, name the attached files, wherever they lay; none of them may
    make us read any other file of this machine but a shipped one."""
    seen.add(file.name)
    try:
        tree = read_yaml(file)
        parameters = tree["/**"]["ros__parameters"]
    except (ConfigError, LookupError, TypeError):
        return  # read_cell tells what is wrong
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
        if Path(name).name in names and Path(name).name not in seen:
            _localise(recording, file.with_name(Path(name).name), names, seen)
