"""Every key of the parameter file, from the records that check it."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator

import numpy as np
import yaml

from kr270_milling.base.errors import InputError
from kr270_milling.base.parameter_file import AXES, DISPLAYED, from_display
from kr270_milling.base.record import Record, Spec, flat, specs
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import SECTIONS
from kr270_milling.cell.draft import straight_text

TYPES = {
    float: "number", int: "whole number", bool: "true or false", str: "text", np.ndarray: "numbers", tuple: "texts",
}  # fmt: skip


def keys_of(section: str = "") -> list[dict]:
    """The keys of a section, such as ``tool`` or ``cutting.linear_edge``, or of all; raises InputError for another.

    Of each: key as --set takes it, type, unit, low, high, above (exclusive lower bound), choices, size of a list
    (None: any), required, default (None for a required key), text, range in words; bounds and default in its unit;
    expert: ``init`` does not write the key.
    """
    rows = list(_keys(Cell, ""))
    if not section:
        return rows
    chosen = [row for row in rows if row["key"] == section or row["key"].startswith(section.rstrip(".") + ".")]
    if not chosen:
        sections = sorted({row["key"].rpartition(".")[0] for row in rows} - {""})
        raise InputError("keys", f"{section!r} is no section; known are {', '.join(sections)}")
    return chosen


def schema() -> dict:
    """Return the JSON schema of a cell file, with which an editor completes and checks keys; no key is required.

    A file that others include may leave out any key. A group of lists may also be a list of groups.
    """
    cell = _group(Cell)
    keys = cell["properties"]
    tool = {**keys["tool"]["properties"], **{name: keys[name] for name in SECTIONS}}
    keys["includes"] = {"type": "array", "items": {"type": "string"}, "description": "files below this one"}
    keys["tools"] = {"type": "object", "additionalProperties": _object(tool), "description": "groups of keys by tool"}
    file = _object({"/**": _object({"ros__parameters": cell})})
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "cell of kr270_milling", **file}


def _object(properties: dict) -> dict:
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _group(record: type[Record], name: str = "") -> dict:
    """Return the schema of a group of keys."""
    kinds = {
        spec.key: _group(spec.kind, spec.key) if issubclass(spec.kind, Record) else _value(spec)
        for spec in specs(record)
    }
    if name in DISPLAYED:
        key, display, farthest = DISPLAYED[name]
        numbers = {axis: {"type": "number"} for axis in AXES}
        kinds[key] = {**_object(numbers), "description": f"{display} on the controller's display [mm, deg]"}
    if all(spec.kind is np.ndarray for spec in specs(record)):
        row = {key: {"anyOf": [kind, kind["items"]]} for key, kind in kinds.items()}
        return {"anyOf": [_object(kinds), {"type": "array", "items": _object(row)}]}
    return _object(kinds)


def _value(spec: Spec) -> dict:
    """Return the schema of the value of one key."""
    row = _row(spec, "")
    bounds = {"minimum": row["low"], "maximum": row["high"], "exclusiveMinimum": row["above"]}
    names = {float: "number", int: "integer", bool: "boolean", str: "string", np.ndarray: "number", tuple: "string"}
    value = {"type": names[spec.kind], **{key: bound for key, bound in bounds.items() if bound is not None}}
    if spec.choices:
        value["enum"] = list(spec.choices)
    if spec.kind in (np.ndarray, tuple):
        value = {"type": "array", "items": value}
        if spec.size is not None:
            value |= {"minItems": spec.size, "maxItems": spec.size}
    text = f"{spec.text} [{spec.unit}]" if spec.unit else spec.text
    return value | {"description": text} | ({} if row["default"] is None else {"default": row["default"]})


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
    return ", ".join(f"{sign} {value:.10g}" for sign, value in bounds if math.isfinite(value))


def _default(spec: Spec):
    """In the unit of the file, without the digits of the way to SI and back."""
    if spec.kind is np.ndarray:
        return [float(f"{value / spec.scale:.12g}") for value in np.ravel(spec.default)]
    if spec.kind is float:
        return float(f"{spec.default / spec.scale:.12g}")
    return list(spec.default) if spec.kind is tuple else spec.default
