"""What the nodes of a graph are started with, the cell as a file among it, and what the recorder of a pass is told."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import yaml

from kr270_milling.base.record import tree_of
from kr270_milling.cell.cell import Cell

__all__ = ["cell_text", "recording_parameters", "ros_arguments", "write_cell"]


def ros_arguments(parameters: Path, namespace: str, *more: str) -> list[str]:
    """Arguments of a node with a parameter file in a namespace."""
    space = ["-r", f"__ns:={namespace}"] if namespace != "/" else []
    return ["--ros-args", "--params-file", str(parameters), *space, *more]


def recording_parameters(cell: Cell, out: Path, name: str, plant: Cell | None = None) -> dict:
    """Parameters of the recorder for the pass ``name``; its directory is the last, because it begins the recording.

    plant: the cell that runs this pass where it is not the one that plans; it is attached as well.
    """
    attach = [str(out / "cell.yaml")]
    if plant is not None:
        (out / "log" / name).mkdir(exist_ok=True)
        attach.append(str(out / "log" / name / "plant.yaml"))
        write_cell(plant, Path(attach[-1]))
    if cell.path.file:
        attach.append(str(Path(cell.path.file).resolve()))  # the nodes run in another directory
    return {"attach": attach, "command": shlex.join(sys.argv), "directory": str(out / name)}


def cell_text(cell: Cell) -> str:
    """The YAML text with the numbers that the cell was built from; read again they are the same, bit for bit."""
    tree = _without_empty(tree_of(cell))
    if cell.path.file:
        tree["path"]["file"] = str(Path(cell.path.file).resolve())
    text = yaml.safe_dump({"/**": {"ros__parameters": tree}}, sort_keys=False, default_flow_style=None, width=110)
    return "# Written by kr270_milling: the cell as it was run.\n" + text


def write_cell(cell: Cell, path: Path) -> None:
    path.write_text(cell_text(cell), encoding="utf-8")


def _without_empty(tree: dict) -> dict:
    """Without empty lists, whose type ROS cannot tell, and groups that hold nothing else, which it refuses."""
    kept = {key: _without_empty(value) if isinstance(value, dict) else value for key, value in tree.items()}
    return {key: value for key, value in kept.items() if value or not isinstance(value, (list, dict))}
