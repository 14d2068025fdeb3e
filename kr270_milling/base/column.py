"""Columns of a result: key, factor, title, unit and digits beside the field or the property of its record.

Terminal tables, JSON, CSV files and the report take their columns from there::

    @dataclass(frozen=True)
    class Scores:
        max_deviation: float = column("max_deviation_um", 1e6, "largest deviation", "um", digits=2, short="max")

The key of JSON is ``max_deviation_um``, the heading is ``largest deviation [µm]`` in the report and ``max [um]`` in the
terminal. ``computed`` does the same for a property. ``as_dict`` makes the dictionary for JSON and CSV from them; the
tables of ``guide/contributing/json.md`` are compared with the same columns.

Tables print ``< 0.1`` for a deviation of a part (``least=CONVERGED``) that is smaller than what another grid changes.
JSON and CSV have the number. ``Scores`` of a straight cut keep their digits, for comparison with Table 2 of the paper.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

Value = TypeVar("Value")

#: [m]; a finer or coarser grid changes the deviation of the paper's pass by up to 0.06 um, see guide/numbers.md
CONVERGED = 1e-7


@dataclasses.dataclass(frozen=True)
class Column:
    """Name, unit and format of a field in files and tables; the value of the field is in SI."""

    name: str  #: field of the record
    key: str  #: in JSON and CSV, ends in its unit; "": not written; "*": the keys of the value, a record or dictionary
    factor: float  #: SI -> unit of the key
    title: str  #: in the report; "": the field is not shown there
    unit: str  #: in tables
    scale: float  #: SI -> unit of the tables
    digits: int  #: decimals in tables
    short: str  #: heading in the terminal; "": the field is not shown there
    infinite: str  #: text of an infinite value
    least: float  #: in SI; of a smaller size tables state only that it is smaller; 0: none

    def heading(self, short: bool = False) -> str:
        """Return the title, or the short one, with the unit."""
        return (self.short if short else self.title) + (f" [{self.unit}]" if self.unit else "")

    def text(self, written: float | str | bool) -> str:
        """Return a value of JSON as text, in the unit of the tables."""
        if isinstance(written, (str, bool)):
            return yes(written) if isinstance(written, bool) else written
        value = written / self.factor * self.scale
        return self.infinite if written == math.inf else fixed(value, self.digits, self.least * self.scale)


class TextTable(NamedTuple):
    """A table for terminal and report: the first column is a text, the others are right-aligned."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""  #: below the table of the report


def _about(
    key: str,
    factor: float = 1.0,
    title: str = "",
    unit: str = "",
    scale: float | None = None,
    digits: int = 1,
    short: str = "",
    infinite: str = "inf",
    least: float = 0.0,
) -> dict:
    """Return the column but for its name; scale: default the factor of the key."""
    return {**locals(), "scale": factor if scale is None else scale}


def column(*about, default: object = dataclasses.MISSING, **more):
    """Return a dataclass field with its column; about, more: of the ``Column``, without its name."""
    return dataclasses.field(default=default, metadata={"column": _about(*about, **more)})


class _Computed(cached_property):
    about: dict


def computed(*about, **more) -> Callable[[Callable[[Any], Value]], cached_property[Value]]:
    """Return a decorator that makes a cached property with its column; about, more: as of ``column``."""

    def decorate(function: Callable) -> cached_property:
        computed = _Computed(function)
        computed.about = _about(*about, **more)
        return computed

    return decorate


def columns(record) -> tuple[Column, ...]:
    """Return the columns of a record or of its class: the fields in their order, then the properties.

    A record without any column is written by the names of its fields.
    """
    fields = {f.name: f.metadata["column"] for f in dataclasses.fields(record) if "column" in f.metadata}
    kind = record if isinstance(record, type) else type(record)
    properties = {name: value.about for name, value in vars(kind).items() if isinstance(value, _Computed)}
    plain = {} if fields or properties else {f.name: _about(f.name) for f in dataclasses.fields(record)}
    return tuple(Column(name, **about) for name, about in (fields | properties | plain).items())


def as_dict(record) -> dict[str, Any]:
    """Return key -> value in the unit of the key, for JSON and CSV; records inside become dictionaries, too."""
    result: dict[str, Any] = {}
    for c in columns(record):
        if c.key:
            value = _written(getattr(record, c.name), c.factor)
            result |= value if c.key == "*" else {c.key: value}
    return result


def _written(value, factor: float):
    if dataclasses.is_dataclass(value):
        return as_dict(value)
    if isinstance(value, (list, tuple)):
        return [_written(v, factor) for v in value]
    if isinstance(value, dict):
        return {k: _written(v, factor) for k, v in value.items()}
    return value if value is None or factor == 1.0 else value * factor


def json_value(value, pack: Callable[[Any], Any] = lambda array: array.tolist()):
    """Return a value as strict JSON has it: numbers that are not finite are None. pack: array -> its plain value."""
    if dataclasses.is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(k): json_value(v, pack) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_value(v, pack) for v in value]
    if hasattr(value, "tolist"):
        return json_value(pack(value), pack)
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def columns_of(record, unit: str = "") -> tuple[tuple, ...]:
    """Return columns for ``table_of`` from the columns of a record class that have a short heading.

    unit: a unit that the title of the table states, so the headings do not.
    """
    shown = [c for c in columns(record) if c.short]
    return tuple((c.short if c.unit == unit else c.heading(short=True), c.key, c.text) for c in shown)


def table_of(title: str, columns: Sequence[tuple], rows: Iterable[Mapping], note: str = "") -> TextTable:
    """Return a table of records; columns: heading, key, and decimals of the number or a function value -> text."""
    texts = [[_cell(row[key], style) for _, key, style in columns] for row in rows]
    return TextTable(title, [heading for heading, *_ in columns], texts, note)


def _cell(value, style: int | Callable[[Any], str]) -> str:
    if callable(style):
        return style(value)
    return value if isinstance(value, str) else fixed(value, style)


def fixed(value: float, digits: int = 2, least: float = 0.0) -> str:
    """Return a number with so many decimals; "-" for NaN, "< 0.1" for a size below ``least`` = 0.1."""
    if abs(value) < least:
        return f"< {least:.3g}"
    return "-" if math.isnan(value) else f"{round(value, digits) + 0.0:.{digits}f}"


def counted(number: int, noun: str) -> str:
    """Return a number with its noun: 1 stop, 2 stops."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def yes(value: bool) -> str:
    return "yes" if value else "no"
