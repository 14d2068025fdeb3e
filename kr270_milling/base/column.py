"""Columns of a result: key, factor, title, unit and digits beside the field of its record.

Terminal tables, JSON, CSV files and the report take their columns from the fields::

    @dataclass(frozen=True)
    class Scores:
        max_deviation: float = column("max_deviation_mm", 1e3, "largest deviation", "um", 1e6, 2, short="max")

The key of JSON is ``max_deviation_mm``, the heading is ``largest deviation [µm]`` in the report and ``max [um]`` in the
terminal.
"""

from __future__ import annotations

import dataclasses

__all__ = ["Column", "as_dict", "column", "columns"]


@dataclasses.dataclass(frozen=True)
class Column:
    """How a field is written and shown; the value of the field is in SI."""

    name: str  #: of the field
    key: str  #: in JSON and CSV, ends in its unit; "": the field is not written
    factor: float  #: SI -> unit of the key
    title: str  #: in the report; "": the field is not shown there
    unit: str  #: in tables
    scale: float  #: SI -> unit of the tables
    digits: int  #: decimals in tables
    short: str  #: heading in the terminal; "": the field is not shown there

    def heading(self, short: bool = False) -> str:
        """Return the title, or the short one, with the unit."""
        return (self.short if short else self.title) + (f" [{self.unit}]" if self.unit else "")


def column(
    key: str, factor: float = 1.0, title: str = "", unit: str = "", scale: float | None = None, digits: int = 1,
    short: str = "", default: object = dataclasses.MISSING,
):  # fmt: skip
    """Return a dataclass field with its column; scale: default the factor of the key; default: of the field."""
    about = dict(key=key, factor=factor, title=title, unit=unit, digits=digits, short=short)
    metadata = {"column": about | {"scale": factor if scale is None else scale}}
    return dataclasses.field(default=default, metadata=metadata)


def columns(record) -> tuple[Column, ...]:
    """Return the columns of a record or of its class, in the order of the fields."""
    fields = dataclasses.fields(record)
    return tuple(Column(field.name, **field.metadata["column"]) for field in fields if "column" in field.metadata)


def as_dict(record) -> dict[str, float]:
    """Return key -> value in the unit of the key, for JSON and CSV."""
    return {c.key: getattr(record, c.name) * c.factor for c in columns(record) if c.key}
