"""Every key of the parameter file, from the records that check it."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.base.record import Record, Spec, specs
from kr270_milling.cell.records import Parameters

__all__ = ["Key", "keys_of"]

TYPES = {
    float: "number",
    int: "whole number",
    bool: "true or false",
    str: "text",
    np.ndarray: "numbers",
    tuple: "texts",
}


@dataclass(frozen=True)
class Key:
    """One key; bounds and default in its unit."""

    key: str  #: dotted, as --set takes it
    type: str
    unit: str  #: "" for none
    low: float | None
    high: float | None
    above: float | None  #: exclusive lower bound
    choices: tuple[str, ...]
    size: int | None  #: of a list, None: any
    required: bool
    default: object  #: None for a required key, or for one that only the section in use must have
    text: str

    @property
    def range(self) -> str:
        """The allowed values in words; "" for all."""
        if self.choices:
            return " | ".join(self.choices)
        lower = f"> {self.above:g}" if self.above is not None else f">= {self.low:g}" if self.low is not None else ""
        upper = f"<= {self.high:g}" if self.high is not None else ""
        return ", ".join(part for part in (lower, upper) if part)


def keys_of(section: str = "", record: type[Record] = Parameters) -> list[Key]:
    """The keys of a section, such as ``tool`` or ``cutting.linear_edge``, or of all; raises InputError for another."""
    found = list(_keys(record, "", True))
    if not section:
        return found
    chosen = [key for key in found if key.key == section or key.key.startswith(section.rstrip(".") + ".")]
    if not chosen:
        sections = sorted({key.key.rpartition(".")[0] for key in found} - {""})
        raise InputError("keys", f"{section!r} is no section; known are {', '.join(sections)}")
    return chosen


def _keys(record: type[Record], prefix: str, needed: bool):
    """needed: whether the section itself must be there."""
    for spec in specs(record):
        if issubclass(spec.kind, Record):
            yield from _keys(spec.kind, f"{prefix}{spec.key}.", needed and spec.default is dataclasses.MISSING)
        else:
            yield _key(spec, prefix)


def _key(spec: Spec, prefix: str) -> Key:
    required = spec.default is dataclasses.MISSING
    return Key(
        key=prefix + spec.key,
        type=TYPES[spec.kind],
        unit=spec.unit,
        low=_bound(spec.low),
        high=_bound(spec.high),
        above=_bound(spec.above),
        choices=spec.choices,
        size=spec.size,
        required=required,
        default=None if required or spec.optional else _default(spec),
        text=spec.text,
    )


def _bound(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _default(spec: Spec):
    """In the unit of the file, without the digits of the way to SI and back; None where there is none."""
    default = spec.default
    if default is None:
        return None
    if spec.kind is np.ndarray:
        return [float(f"{value / spec.scale:.12g}") for value in np.ravel(default)]
    if spec.kind is float:
        return float(f"{default / spec.scale:.12g}")
    return list(default) if spec.kind is tuple else default
