"""What the nodes of a graph are started with, and what the recorder of a pass is told."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from kr270_milling.cell.cell import Cell
from kr270_milling.ros.cell_file import write_cell

__all__ = ["ros_arguments", "recording_parameters"]


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
