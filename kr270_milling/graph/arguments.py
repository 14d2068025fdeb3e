"""What the nodes of a graph are started with: their arguments, and the recorder's parameters."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import yaml

from kr270_milling.cell.cell import Cell
from kr270_milling.ros.cell_file import write_cell

__all__ = ["ros_arguments", "write_recorder_parameters"]


def ros_arguments(parameters: Path, namespace: str, *more: str) -> list[str]:
    """Arguments of a node with a parameter file in a namespace."""
    space = ["-r", f"__ns:={namespace}"] if namespace != "/" else []
    return ["--ros-args", "--params-file", str(parameters), *space, *more]


def write_recorder_parameters(cell: Cell, out: Path, name: str, namespace: str, plant: Cell | None = None) -> Path:
    """The parameter file of the recorder of the pass ``name``, which records the topics of the namespace.

    plant: the cell that runs this pass where it is not the one that plans; it is attached as well.
    """
    attach = [str(out / "cell.yaml")]
    if plant is not None:
        (out / "log" / name).mkdir(exist_ok=True)
        attach.append(str(out / "log" / name / "plant.yaml"))
        write_cell(plant, Path(attach[-1]))
    if cell.path.file:
        attach.append(str(Path(cell.path.file).resolve()))  # the nodes run in another directory
    values = {"directory": str(out / name), "attach": attach, "command": shlex.join(sys.argv)}
    if namespace != "/":
        values["topics"] = [f"{namespace}/*", "/diagnostics"]
    file = out / "log" / f"recorder_{name}.yaml"
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}), encoding="utf-8")
    return file
