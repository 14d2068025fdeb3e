"""Parameter records: one dataclass, read from a parameter file.

A physics module owns its record::

    @dataclass(frozen=True, eq=False)
    class Tool(Record):
        diameter: float = parameter(unit="mm", above=0.0, high=200.0, text="cutter diameter")

In a file it reads ``diameter_mm: 20.0``; in code ``tool.diameter`` is 0.020 [m]. Bounds are in the file's unit.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
import typing

import numpy as np

from kr270_milling.base.errors import ConfigError, ParameterError, nearest
from kr270_milling.base.parameter_file import refusal
from kr270_milling.base.units import UNITS

#: key of an earlier version -> what its user must know
MOVED = {
    "cutting.end_ratio": "is not a known key: since 0.4.0 cutting.end_share, 0 to 1, is the share of the end edge that "
    "pushes a sinking tool up",
    "limits.backlash_deg": "is not a known key: the backlash is arm.backlash_arcsec since 0.3.0",
    "imperfections.backlash_deg": "is not a known key: its unit is arcsec since 0.3.0, imperfections.backlash_arcsec",
    "uncertainty.backlash_deg": "is not a known key: since 0.3.0 uncertainty.backlash is a multiple of "
    "arm.backlash_arcsec",
}


@dataclasses.dataclass(frozen=True)
class Spec:
    """The properties of one parameter: name, type, default, unit, bounds and help text."""

    name: str
    kind: type  # float, int, bool, str, np.ndarray (of floats), tuple (of strings) or a Record
    default: typing.Any  # in SI; MISSING: there is none
    unit: str = ""
    text: str = ""
    low: float = -math.inf  # bounds in the file's unit
    high: float = math.inf
    above: float = -math.inf  # exclusive lower bound
    choices: tuple[str, ...] = ()
    size: int | None = None  # of an array; None: any
    key: str = ""  # in a file; empty: from name and unit

    def __post_init__(self):
        object.__setattr__(self, "key", self.key or (f"{self.name}_{self.unit}" if self.unit else self.name))

    @property
    def scale(self) -> float:
        return UNITS[self.unit]

    @property
    def optional(self) -> bool:
        """Return whether the value may be missing: NaN in the record, and no key in a file."""
        return self.kind is float and isinstance(self.default, float) and math.isnan(self.default)

    @property
    def allowed(self) -> str:
        """Return the allowed values as the end of an error message."""
        if self.kind in (str, tuple):
            what = "one of " + ", ".join(self.choices) if self.choices else "a text"
            return what if self.kind is str else f"a list, each {what}"
        if self.kind is bool:
            return "true or false"
        if issubclass(self.kind, Record):
            return f"a record {self.kind.__name__}, or a dict of its values"
        number = "a whole number" if self.kind is int else "a finite number"
        if self.kind is np.ndarray:
            number = f"a list of {'' if self.size is None else f'{self.size} '}finite numbers"
        bounds = (("above", self.above), ("at least", self.low), ("at most", self.high))
        limits = " and ".join(f"{word} {bound:.10g}" for word, bound in bounds if math.isfinite(bound))
        return f"{number} {limits}".strip()

    def read(self, value):
        """Convert a value of a parameter file to the type of the parameter, in the file's unit; raise ValueError.

        A whole number is accepted for a float.
        """
        if self.kind is float:
            return _number(value)
        if self.kind in (tuple, np.ndarray):
            if not isinstance(value, list) or (self.kind is tuple and not all(isinstance(v, str) for v in value)):
                raise ValueError
            return value if self.kind is tuple else [_number(v) for v in value]
        if type(value) is not self.kind:
            raise ValueError
        return value

    def to_si(self, value):
        """Convert a value from the file's unit to SI."""
        if self.kind is np.ndarray:
            return np.array(value, float) * self.scale
        return value * self.scale if self.kind is float else value

    def to_file(self, value):
        """Convert a value from SI to the file's unit and to plain Python types."""
        if self.kind is np.ndarray:
            return (value / self.scale).tolist()
        if self.kind is float:
            return float(value / self.scale)
        return list(value) if self.kind is tuple else value

    def checked(self, value):
        """Return the value (SI), arrays read-only; raise ParameterError for a value that is not allowed."""
        types: dict = {float: numbers.Real, int: numbers.Integral, bool: (bool, np.bool_)}
        try:
            if self.kind is np.ndarray:
                value = np.array(value, float)
                value.setflags(write=False)
            elif self.kind is tuple:
                value = tuple(value)
            elif not isinstance(value, types.get(self.kind, self.kind)):
                raise TypeError
            allowed = self._allows(value) or (self.optional and math.isnan(value))
        except (TypeError, ValueError, OverflowError):
            raise ParameterError(self.key, value, self.allowed) from None
        if not allowed:
            raise ParameterError(self.key, _readable(self.to_file(value)), self.allowed)
        return value

    def _allows(self, value) -> bool:
        """Return whether the value (SI) has the right type and size and is within the bounds.

        The bounds are converted to SI by the same product as a value of the file, and a product keeps the order of two
        numbers. A value that is within the bounds in the file's unit is therefore within the bounds in SI.
        """
        if self.choices and not set(value if self.kind is tuple else [value]) <= set(self.choices):
            return False
        if self.kind is np.ndarray and (value.ndim != 1 or self.size not in (None, value.size)):
            return False
        if self.kind is int:
            whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
            return whole and abs(value) < 2**63 and self.low <= value <= self.high and value > self.above
        if self.kind not in (float, np.ndarray):
            return True
        low, high, above = self.low * self.scale, self.high * self.scale, self.above * self.scale
        if isinstance(value, float):
            return math.isfinite(value) and low <= value <= high and value > above
        values = np.atleast_1d(np.asarray(value, float))
        return bool(np.all(np.isfinite(values) & (values >= low) & (values <= high) & (values > above)))


def _number(value) -> float:
    # YAML 1.1 reads 1e-5 as a text, the ROS parser as a number
    known = type(value) in (str, float) or (type(value) is int and abs(value) < 2**63)
    number = float(value) if known else math.nan
    if math.isnan(number):
        raise ValueError
    return number


def _readable(value):
    """Round away the digits that the conversion to SI and back may have added."""
    if isinstance(value, list):
        return [_readable(v) for v in value]
    return float(f"{value:.14g}") if isinstance(value, float) else value


def parameter(default=dataclasses.MISSING, **about):
    """Return a dataclass field that a parameter file may set; ``default`` is in SI.

    about: fields of its ``Spec``: text, unit, low, high, above, choices, or a function that returns them, and size.
    """
    if isinstance(default, (list, np.ndarray)):
        values = tuple(default)
        return dataclasses.field(default_factory=lambda: np.array(values, float), metadata=about)
    return dataclasses.field(default=default, metadata=about)


def section(record: type, key: str = ""):
    """Return a dataclass field for a section that a file may leave out; key: in the file, if not the field's name."""
    return dataclasses.field(default_factory=record, metadata={"key": key})


def derived(default):
    """A dataclass field that no parameter file sets."""
    return dataclasses.field(default=default, metadata={"derived": True})


R = typing.TypeVar("R", bound="Record")
_SPECS: dict[type, tuple[Spec, ...]] = {}  # cache, one entry for each record class


def specs(record: type[Record]) -> tuple[Spec, ...]:
    """Return the parameters of a record class in their order; ``kind`` of a nested record is its class."""
    if record not in _SPECS:
        hints = typing.get_type_hints(record)
        result = []
        for field in dataclasses.fields(record):
            if "derived" in field.metadata:  # no parameter
                continue
            default = field.default if field.default_factory is dataclasses.MISSING else field.default_factory()
            kind = typing.get_origin(hints[field.name]) or hints[field.name]
            about = dict(field.metadata)
            if callable(about.get("choices")):  # known once the packages of others are loaded
                about["choices"] = about["choices"]()
            result.append(Spec(field.name, kind, default, **about))
        _SPECS[record] = tuple(result)
    return _SPECS[record]


@dataclasses.dataclass(frozen=True, eq=False)
class Record:
    """Base of the parameter dataclasses: checks every value on construction and makes arrays read-only.

    Raises ParameterError with key and value in the file's unit. A record from a parameter file stores the numbers of
    the file, so that ``tree_of`` returns them unchanged. Records with the same values are equal, so that what is
    computed from them is cached by their values.
    """

    def __post_init__(self):
        self._check_values(vars(self))

    def _check_values(self, names: typing.Container[str]) -> None:
        for spec in specs(type(self)):
            if spec.name in names:
                vars(self)[spec.name] = spec.checked(vars(self)[spec.name])
        self.check()

    def check(self) -> None:
        """Check conditions between several values; a child class raises ParameterError."""

    @functools.cached_property
    def _values(self) -> tuple:
        return tuple(_hashable(getattr(self, field.name)) for field in dataclasses.fields(self))

    @functools.cached_property
    def _hash(self) -> int:
        return hash(self._values)

    def __eq__(self, other) -> bool:
        return self is other or (type(other) is type(self) and other._values == self._values)

    def __hash__(self) -> int:
        return self._hash

    def __getstate__(self) -> dict:
        """Return the state without the hash, which differs from process to process."""
        return {name: value for name, value in vars(self).items() if name not in ("_values", "_hash")}

    def replace(self: R, **changes) -> R:
        """Return a copy with some values (SI) replaced; a dict replaces values of a section.

        Raises ParameterError for an unknown name.
        """
        names = [field.name for field in dataclasses.fields(self)]
        for name, value in changes.items():
            if name not in names:
                raise ParameterError(name, value, f"a name of {type(self).__name__}{nearest(name, names)}")
            section = getattr(self, name)
            if isinstance(value, dict) and isinstance(section, Record):
                changes[name] = section.replace(**value)
        copy = object.__new__(type(self))
        vars(copy).update({name: vars(self)[name] for name in names} | changes)
        copy._check_values(changes)  # the others are checked
        return _keep(copy, {name: value for name, value in _given(self).items() if name not in changes})


def _hashable(value):
    """Return an array as bytes and NaN, a value that is not given, as None."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    return None if isinstance(value, float) and math.isnan(value) else value


def _keep(record, from_file: dict):
    """Store name -> value of the file, in the file's units, in the record, and return the record."""
    object.__setattr__(record, "_in_file_units", from_file)
    return record


def stated(record: Record, name: str) -> bool:
    """Return whether the file of a record states a parameter."""
    return name in _given(record)


def _given(record: Record) -> dict:
    return getattr(record, "_in_file_units", {})


def build(record: type[Record], tree: dict, file="", prefix: str = ""):
    """Build a record from the nested dict of a parameter file.

    Raises ConfigError for keys that are unknown, missing or have a value that is not allowed.
    """
    if not isinstance(tree, dict):
        raise refusal(file, prefix.rstrip("."), tree, "a group of keys")
    known = {s.key: s for s in specs(record)}
    for key in tree:
        if key not in known:
            if prefix + key in MOVED:
                raise ConfigError(file, f"{prefix}{key}", None, MOVED[prefix + key])
            hint = nearest(str(key), known, f"; known here: {', '.join(known)}")
            raise ConfigError(file, f"{prefix}{key}", None, "is not a known key" + hint)
    values, from_file = {}, {}
    for key, spec in known.items():
        if issubclass(spec.kind, Record):
            if key in tree or spec.default is dataclasses.MISSING:
                values[spec.name] = build(spec.kind, tree.get(key, {}), file, f"{prefix}{key}.")
        elif key in tree:
            try:
                from_file[spec.name] = spec.read(tree[key])
            except ValueError:
                raise refusal(file, prefix + key, tree[key], spec.allowed) from None
            values[spec.name] = spec.to_si(from_file[spec.name])
        elif spec.default is dataclasses.MISSING:
            raise ConfigError(file, prefix + key, None, f"is missing; it must be {spec.allowed} ({spec.text})")
    try:
        return _keep(record(**values), from_file)
    except ParameterError as error:
        raise refusal(file, prefix + error.key, error.value, error.allowed) from None


def tree_of(record: Record) -> dict:
    """Return the nested dict of a parameter file, in file units; numbers that come from a file are unchanged."""
    from_file = _given(record)
    tree: dict[str, typing.Any] = {}
    for spec in specs(type(record)):
        value = getattr(record, spec.name)
        if issubclass(spec.kind, Record):
            tree[spec.key] = tree_of(value)
        elif not (spec.optional and math.isnan(value)):
            tree[spec.key] = from_file[spec.name] if spec.name in from_file else spec.to_file(value)
    return tree


def flatten(record: Record) -> dict[str, object]:
    """Return dotted key -> value in file units, for the parameters of a node and the table of a report."""
    return flat(tree_of(record))


def flat(tree: dict, prefix: str = "") -> dict[str, object]:
    """Return dotted key -> value of a nested dict."""
    values: dict[str, object] = {}
    for key, value in tree.items():
        values.update(flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value})
    return values
