"""Every key of the parameter file, from the records that check it."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator

import numpy as np
import yaml

from kr270_milling.base.errors import InputError
from kr270_milling.base.parameter_file import from_display
from kr270_milling.base.record import Record, Spec, flat, specs
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.draft import straight_text

__all__ = ["keys_of"]

TYPES = {
    float: "number", int: "whole number", bool: "true or false", str: "text", np.ndarray: "numbers", tuple: "texts",
}  # fmt: skip


def keys_of(section: str = "", record: type[Record] = Cell) -> list[dict]:
    """The keys of a section, such as ``tool`` or ``cutting.linear_edge``, or of all; raises InputError for another.

    Of each: key as --set takes it, type, unit, low, high, above (exclusive lower bound), choices, size of a list
    (None: any), required, default (None for a required key), text, range in words; bounds and default in its unit;
    expert: ``init`` does not write the key.
    """
    rows = list(_keys(record, ""))
    if not section:
        return rows
    chosen = [row for row in rows if row["key"] == section or row["key"].startswith(section.rstrip(".") + ".")]
    if not chosen:
        sections = sorted({row["key"].rpartition(".")[0] for row in rows} - {""})
        raise InputError("keys", f"{section!r} is no section; known are {', '.join(sections)}")
    return chosen


def _keys(record: type[Record], prefix: str) -> Iterator[dict]:
    for spec in specs(record):
        if issubclass(spec.kind, Record):
            yield from _keys(spec.kind, f"{prefix}{spec.key}.")
        else:
            yield _row(spec, prefix)


@functools.cache
def _user_keys() -> frozenset[str]:
    """Return the keys that ``init`` writes; all others are for experts."""
    tree = yaml.safe_load(straight_text(""))["/**"]["ros__parameters"]
    return frozenset([*flat(from_display(tree, "")), "path.file", "path.tool"])


def _row(spec: Spec, prefix: str) -> dict:
    required = spec.default is dataclasses.MISSING
    bounds = {name: getattr(spec, name) for name in ("low", "high", "above")}
    return {
        "key": prefix + spec.key,
        "type": TYPES[spec.kind],
        "unit": spec.unit,
        **{name: value if math.isfinite(value) else None for name, value in bounds.items()},
        "choices": spec.choices,
        "size": spec.size,
        "required": required,
        "default": None if required or spec.optional else _default(spec),
        "text": spec.text,
        "range": _range(spec),
        "expert": prefix + spec.key not in _user_keys(),
    }


def _range(spec: Spec) -> str:
    """The allowed values in words; empty for all."""
    if spec.choices:
        return " | ".join(spec.choices)
    bounds = (">", spec.above), (">=", spec.low if math.isinf(spec.above) else math.inf), ("<=", spec.high)
    return ", ".join(f"{sign} {value:g}" for sign, value in bounds if math.isfinite(value))


def _default(spec: Spec):
    """In the unit of the file, without the digits of the way to SI and back."""
    if spec.kind is np.ndarray:
        return [float(f"{value / spec.scale:.12g}") for value in np.ravel(spec.default)]
    if spec.kind is float:
        return float(f"{spec.default / spec.scale:.12g}")
    return list(spec.default) if spec.kind is tuple else spec.default
