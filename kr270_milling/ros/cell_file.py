"""A cell as one flat-standing parameter file: what was merged from several files and the command line."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import yaml

from kr270_milling.base.record import Record, specs
from kr270_milling.cell.cell import Cell

__all__ = ["cell_text", "write_cell"]


def cell_text(cell: Cell) -> str:
    """The YAML text; read again it gives the very same numbers, bit for bit."""
    tree = _tree(cell)
    if cell.path.file:
        tree["path"]["file"] = str(Path(cell.path.file).resolve())
    text = yaml.safe_dump({"/**": {"ros__parameters": tree}}, sort_keys=False, default_flow_style=None, width=110)
    return "# Written by kr270_milling: the cell as it was run.\n" + text


def write_cell(cell: Cell, path: Path) -> None:
    path.write_text(cell_text(cell), encoding="utf-8")


def _tree(record: Record) -> dict:
    tree: dict = {}
    for spec in specs(type(record)):
        value = getattr(record, spec.name)
        if issubclass(spec.kind, Record):
            tree[spec.key] = _tree(value)
        elif spec.kind is np.ndarray:
            tree[spec.key] = [_in_file_unit(float(v), spec.scale) for v in value]
        elif spec.kind is float:
            tree[spec.key] = _in_file_unit(value, spec.scale)
        else:
            tree[spec.key] = list(value) if spec.kind is tuple else value
    return {key: value for key, value in tree.items() if value != []}  # ROS cannot tell the type of an empty list


def _in_file_unit(value: float, scale: float) -> float:
    """The number whose product with ``scale`` is ``value`` again; the shortest of them."""
    quotient = value / scale
    above, below = math.nextafter(quotient, math.inf), math.nextafter(quotient, -math.inf)
    near = (float(f"{quotient:.15g}"), quotient, above, below)
    return next((number for number in near if number * scale == value), quotient)
