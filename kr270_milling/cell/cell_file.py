"""Write a cell as a parameter file that a node and ``read_cell`` read back bit for bit."""

from __future__ import annotations

from pathlib import Path

import yaml

from kr270_milling.base.record import tree_of
from kr270_milling.cell.cell import Cell

__all__ = ["cell_text", "write_cell_file"]


def cell_text(cell: Cell) -> str:
    """Return the cell as YAML text; its numbers are read back bit for bit."""
    tree = _without_empty(tree_of(cell))
    for file in cell.programmed.files:
        tree["path"]["file"] = str(file)
    text = yaml.safe_dump({"/**": {"ros__parameters": tree}}, sort_keys=False, default_flow_style=None, width=110)
    return "# Written by kr270_milling: the cell of this run.\n" + text


def write_cell_file(cell: Cell, path: Path) -> None:
    path.write_text(cell_text(cell), encoding="utf-8")


def _without_empty(tree: dict) -> dict:
    """Remove empty lists, whose type ROS cannot derive, and groups that are then empty, which ROS refuses."""
    values = {key: _without_empty(value) if isinstance(value, dict) else value for key, value in tree.items()}
    return {key: value for key, value in values.items() if value or not isinstance(value, (list, dict))}
