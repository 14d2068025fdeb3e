"""Parameter records: one dataclass, read from a ROS parameter file offline and declared by a node on line.

A physics module owns its record::

    @dataclass(frozen=True, eq=False)
    class Tool(Record):
        diameter: float = parameter(unit="mm", above=0.0, high=200.0, text="cutter diameter")

In a file it reads ``diameter_mm: 20.0``; in code ``tool.diameter`` is 0.020 [m]. Bounds are in the file's unit.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import numbers
import typing

import numpy as np

from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.parameter_file import find_file, merge, override, read_tree, refusal
from kr270_milling.base.units import UNITS

__all__ = [
    "Record", "Spec", "parameter", "specs", "build", "flatten", "tree_of", "read_tree", "merge", "override",
    "find_file",
]  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Spec:
    """What is known of one parameter beside its value."""

    name: str
    kind: type  # float, int, bool, str, np.ndarray (of floats), tuple (of strings) or a Record
    unit: str
    text: str
    low: float
    high: float
    above: float  # exclusive lower bound
    choices: tuple[str, ...]
    size: int | None  # of an array; None: any
    default: typing.Any

    @property
    def key(self) -> str:
        return f"{self.name}_{self.unit}" if self.unit else self.name

    @property
    def scale(self) -> float:
        return UNITS[self.unit]

    @property
    def optional(self) -> bool:
        """Whether the value may be missing: NaN in the record, and no key in a file."""
        return self.kind is float and isinstance(self.default, float) and math.isnan(self.default)

    @property
    def allowed(self) -> str:
        """The sentence about what would be right."""
        if self.kind in (str, tuple):
            what = "one of " + ", ".join(self.choices) if self.choices else "a text"
            return what if self.kind is str else f"a list, each {what}"
        if self.kind is bool:
            return "true or false"
        number = "a whole number" if self.kind is int else "a finite number"
        if self.kind is np.ndarray:
            number = f"a list of {'' if self.size is None else f'{self.size} '}finite numbers"
        bounds = [f"above {self.above:g}" if self.above > -math.inf else "",
                  f"at least {self.low:g}" if self.low > -math.inf else "",
                  f"at most {self.high:g}" if self.high < math.inf else ""]  # fmt: skip
        return " ".join([number, " and ".join(b for b in bounds if b)]).strip()


def parameter(
    default=dataclasses.MISSING,
    *,
    text: str,
    unit: str = "",
    low: float = -math.inf,
    high: float = math.inf,
    above: float = -math.inf,
    choices: tuple[str, ...] = (),
    size: int | None = None,
):
    """A dataclass field that a parameter file may set; ``default`` is in SI, the bounds are in ``unit``."""
    meta = dict(unit=unit, text=text, low=low, high=high, above=above, choices=choices, size=size)
    if isinstance(default, (list, np.ndarray)):
        values = tuple(default)
        return dataclasses.field(default_factory=lambda: np.array(values, float), metadata=meta)
    return dataclasses.field(default=default, metadata=meta)


_SPECS: dict[type, tuple[Spec, ...]] = {}  # found once for each class


def specs(record: type[Record]) -> tuple[Spec, ...]:
    """The parameters of a record class in their order; a field that is itself a Record has ``kind`` that class."""
    if record not in _SPECS:
        _SPECS[record] = _specs(record)
    return _SPECS[record]


def _specs(record: type[Record]) -> tuple[Spec, ...]:
    hints = typing.get_type_hints(record)
    found = []
    for field in dataclasses.fields(record):
        default = field.default
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        meta = field.metadata or dict(unit="", text="", low=-math.inf, high=math.inf, above=-math.inf, choices=(),
                                      size=None)  # fmt: skip
        kind = typing.get_origin(hints[field.name]) or hints[field.name]
        found.append(Spec(name=field.name, kind=kind, default=default, **meta))
    return tuple(found)


@dataclasses.dataclass(frozen=True, eq=False)
class Record:
    """Base of the parameter dataclasses: checks every value at the door and makes arrays read-only.

    Raises ParameterError, with key and value in the file's unit. A record that was built from a parameter file keeps
    the numbers of the file, and gives them back as they stood there (``tree_of``).
    """

    def __post_init__(self):
        for spec in specs(type(self)):
            value = getattr(self, spec.name)
            if not issubclass(spec.kind, Record):
                object.__setattr__(self, spec.name, _checked(spec, value))
        self.check()

    def check(self) -> None:
        """Conditions between several values; a child raises ParameterError."""

    def replace(self, **changes):
        """A copy with some values (SI) replaced."""
        copy = dataclasses.replace(self, **changes)
        return _keep(copy, {name: value for name, value in _given(self).items() if name not in changes})


def _keep(record, given: dict):
    """The record, which remembers by their names the values that a file gives, in the file's units."""
    object.__setattr__(record, "_in_file_units", given)
    return record


def _given(record: Record) -> dict:
    return getattr(record, "_in_file_units", {})


def _checked(spec: Spec, value):
    if spec.kind is np.ndarray:
        value = np.array(value, float)
        value.setflags(write=False)
    elif spec.kind is tuple:
        value = tuple(value)
    if not (_allowed(spec, value) or (spec.optional and math.isnan(value))):
        raise ParameterError(spec.key, _readable(spec, value), spec.allowed)
    return value


def _readable(spec: Spec, value):
    """In the file's unit, without the digits that the way to SI and back may have added."""
    if spec.kind is np.ndarray:
        return [float(f"{v:.14g}") for v in (value / spec.scale).ravel().tolist()]
    return float(f"{value / spec.scale:.14g}") if spec.kind is float else value


def _allowed(spec: Spec, value) -> bool:
    """Whether the value (SI) has the right type and size and is within its bounds.

    The bounds are turned into SI as a value of the file is, by one product, which keeps the order of two numbers: a
    value that is within them in the file's unit is within them here, to the last digit.
    """
    if spec.choices and not set(value if spec.kind is tuple else [value]) <= set(spec.choices):
        return False
    if spec.kind is np.ndarray and (value.ndim != 1 or spec.size not in (None, value.size)):
        return False
    if spec.kind is int:
        whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
        return whole and abs(value) < 2**63 and spec.low <= value <= spec.high and value > spec.above
    if spec.kind not in (float, np.ndarray):
        return True
    values = np.atleast_1d(np.asarray(value, float))
    low, high, above = spec.low * spec.scale, spec.high * spec.scale, spec.above * spec.scale
    return bool(np.all(np.isfinite(values) & (values >= low) & (values <= high) & (values > above)))


def build(record: type[Record], tree: dict, file="", prefix: str = ""):
    """A record from the nested dict of a parameter file.

    A whole number may stand where a float is due. Raises ConfigError for unknown, missing and unusable keys.
    """
    if not isinstance(tree, dict):
        raise refusal(file, prefix.rstrip("."), tree, "a group of keys")
    known = {s.key: s for s in specs(record)}
    for key in tree:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, 1)
            hint = f"; did you mean {near[0]}?" if near else f"; known here: {', '.join(known)}"
            raise ConfigError(file, f"{prefix}{key}", None, "is not a known key" + hint)
    values = {}
    for key, spec in known.items():
        path = prefix + key
        if issubclass(spec.kind, Record):
            if key in tree or spec.default is dataclasses.MISSING:
                values[spec.name] = build(spec.kind, tree.get(key, {}), file, path + ".")
        elif key in tree:
            values[spec.name] = _from_file(spec, tree[key], file, path)
        elif spec.default is dataclasses.MISSING:
            raise ConfigError(file, path, None, f"is missing; it must be {spec.allowed} ({spec.text})")
    try:
        made = record(**values)
    except ParameterError as error:
        raise refusal(file, prefix + error.key, error.value, error.allowed) from None
    return _keep(made, {s.name: _plain(tree[key]) for key, s in known.items() if key in tree and _has_unit(s)})


def _from_file(spec: Spec, value, file, path: str):
    """The value in SI, of the very type that the spec asks for; a whole number is taken where a float is due."""
    refuse = refusal(file, path, value, spec.allowed)
    if spec.kind in (bool, str):
        if type(value) is not spec.kind:
            raise refuse
        return value
    if spec.kind is tuple:
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise refuse
        return tuple(value)
    if spec.kind is int:
        if type(value) is not int:
            raise refuse
        return value
    if spec.kind is float:
        return _number(value, refuse) * spec.scale
    if not isinstance(value, list):
        raise refuse
    return np.array([_number(v, refuse) * spec.scale for v in value], float)


def _number(value, refuse: ConfigError) -> float:
    number = math.nan
    if isinstance(value, str):  # YAML 1.1 reads 1e-5 as a text, the ROS parser as a number
        try:
            number = float(value)
        except ValueError:
            raise refuse from None
    elif type(value) is float or (type(value) is int and abs(value) < 2**63):
        number = float(value)
    if math.isnan(number):
        raise refuse
    return number


def _has_unit(spec: Spec) -> bool:
    return spec.kind in (float, np.ndarray)


def _plain(value):
    """A number or a list of them as floats: a file may write 1e-5, which YAML reads as a text."""
    return [float(v) for v in value] if isinstance(value, list) else float(value)


def tree_of(record: Record) -> dict:
    """The nested dict of a parameter file: the numbers that the record was built from where it was, in file units."""
    given = _given(record)
    tree: dict[str, typing.Any] = {}
    for spec in specs(type(record)):
        value = getattr(record, spec.name)
        if issubclass(spec.kind, Record):
            tree[spec.key] = tree_of(value)
        elif spec.optional and math.isnan(value):
            continue
        elif _has_unit(spec):
            tree[spec.key] = given[spec.name] if spec.name in given else (value / spec.scale)
            if isinstance(tree[spec.key], (np.ndarray, np.generic)):
                tree[spec.key] = tree[spec.key].tolist()
        else:
            tree[spec.key] = list(value) if spec.kind is tuple else value
    return tree


def flatten(record: Record) -> dict[str, object]:
    """Dotted keys and values in file units, as a node declares them and a report lists them."""
    return _flat(tree_of(record), "")


def _flat(tree: dict, prefix: str) -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in tree.items():
        flat.update(_flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value})
    return flat
