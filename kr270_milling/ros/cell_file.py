"""A cell as one flat-standing parameter file: what was merged from several files and the command line."""

from __future__ import annotations

from pathlib import Path

import yaml

from kr270_milling.base.record import tree_of
from kr270_milling.cell.cell import Cell

__all__ = ["cell_text", "write_cell"]


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
