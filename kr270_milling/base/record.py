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
import functools
import math
import numbers
import typing

import numpy as np

from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.parameter_file import find_file, merge, override, read_tree, refusal

__all__ = ["Record", "Spec", "parameter", "specs", "build", "flatten", "read_tree", "merge", "override", "find_file"]

#: file unit -> factor to SI
UNITS = {
    "": 1.0, "m": 1.0, "mm": 1e-3, "um": 1e-6, "s": 1.0, "ms": 1e-3, "kg": 1.0, "n": 1.0, "hz": 1.0, "w": 1.0,
    "deg": math.pi / 180, "rpm": 2 * math.pi / 60, "m_per_min": 1 / 60, "mm_per_min": 1e-3 / 60, "mm_per_s": 1e-3,
    "m_per_s": 1.0, "m_per_s2": 1.0, "m_per_s3": 1.0, "deg_per_s": math.pi / 180, "deg_per_s2": math.pi / 180,
    "urad_per_n_m": 1e-6, "n_per_m": 1.0, "n_per_mm": 1e3, "n_per_mm2": 1e6, "um_per_n": 1e-6, "kw": 1e3, "n_m": 1.0,
}  # fmt: skip


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
    default: object

    @property
    def key(self) -> str:
        return f"{self.name}_{self.unit}" if self.unit else self.name

    @property
    def scale(self) -> float:
        return UNITS[self.unit]

    @property
    def allowed(self) -> str:
        """The sentence about what would be right."""
        if self.kind in (str, tuple):
            what = "one of " + ", ".join(self.choices) if self.choices else "a text"
            return what if self.kind is str else f"a list, each {what}"
        if self.kind is bool:
            return "true or false"
        number = "a whole number" if self.kind is int else "a finite number (write 1.0, not 1)"
        if self.kind is np.ndarray:
            number = f"a list of {'' if self.size is None else f'{self.size} '}finite numbers (write 1.0, not 1)"
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


@functools.cache
def specs(record: type[Record]) -> tuple[Spec, ...]:
    """The parameters of a record class in their order; a field that is itself a Record has ``kind`` that class."""
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


class Record:
    """Base of the parameter dataclasses: checks every value at the door and makes arrays read-only.

    Raises ParameterError, with key and value in the file's unit.
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
        return dataclasses.replace(self, **changes)


def _checked(spec: Spec, value):
    if spec.kind is np.ndarray:
        value = np.array(value, float)
        value.setflags(write=False)
        shown = [v / spec.scale for v in value.ravel().tolist()]
    elif spec.kind is tuple:
        value = shown = tuple(value)
    else:
        shown = value / spec.scale if spec.kind is float else value
    if not _allowed(spec, value, shown):
        raise ParameterError(spec.key, _readable(shown), spec.allowed)
    return value


def _readable(shown):
    """Without the digits that the way to SI and back may have added."""
    if isinstance(shown, list):
        return [_readable(v) for v in shown]
    return float(f"{shown:.14g}") if isinstance(shown, float) else shown


def _allowed(spec: Spec, value, shown) -> bool:
    """Whether the value (``shown`` in the file's unit) has the right type and size and is within its bounds."""
    if spec.choices and not set(shown if spec.kind is tuple else [shown]) <= set(spec.choices):
        return False
    if spec.kind is np.ndarray and (value.ndim != 1 or spec.size not in (None, value.size)):
        return False
    if spec.kind is int:
        whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
        return whole and abs(value) < 2**63 and spec.low <= value <= spec.high and value > spec.above
    if spec.kind not in (float, np.ndarray):
        return True
    given = np.atleast_1d(np.asarray(shown, float))
    if not np.isfinite(given).all():
        return False
    slack = 1e-12 * np.abs(given)  # the way to SI and back may cost an ulp
    return bool(np.all((given + slack >= spec.low) & (given - slack <= spec.high) & (given > spec.above)))


def build(record: type[Record], tree: dict, file="", prefix: str = "", lenient: frozenset = frozenset()):
    """A record from the nested dict of a parameter file.

    ``lenient`` names the dotted keys whose whole numbers may stand for floats (those typed on a command line).
    Raises ConfigError for unknown, missing and unusable keys.
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
                values[spec.name] = build(spec.kind, tree.get(key, {}), file, path + ".", lenient)
        elif key in tree:
            values[spec.name] = _from_file(spec, tree[key], file, path, path in lenient)
        elif spec.default is dataclasses.MISSING:
            raise ConfigError(file, path, None, f"is missing; it must be {spec.allowed} ({spec.text})")
    try:
        return record(**values)
    except ParameterError as error:
        raise ConfigError(file, prefix + error.key, error.value, error.allowed) from None


def _from_file(spec: Spec, value, file, path: str, lenient: bool):
    """The value in SI, of the very type that the spec asks for (as strict as the ROS parameter parser)."""
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
        return _number(value, refuse, lenient) * spec.scale
    if not isinstance(value, list):
        raise refuse
    return np.array([_number(v, refuse, lenient) * spec.scale for v in value], float)


def _number(value, refuse: ConfigError, lenient: bool) -> float:
    if isinstance(value, str):  # YAML 1.1 reads 1e-5 as a text, the ROS parser as a number
        try:
            return float(value)
        except ValueError:
            raise refuse from None
    if type(value) is float or (lenient and type(value) is int and abs(value) < 2**63):
        return float(value)
    raise refuse


def flatten(record: Record, prefix: str = "") -> dict[str, object]:
    """Dotted keys and values in file units, as a node declares them and a report lists them."""
    flat: dict[str, object] = {}
    for spec in specs(type(record)):
        value = getattr(record, spec.name)
        if issubclass(spec.kind, Record):
            flat.update(flatten(value, f"{prefix}{spec.key}."))
        elif spec.kind is np.ndarray:
            flat[prefix + spec.key] = [float(v) for v in value / spec.scale]
        elif spec.kind is tuple:
            flat[prefix + spec.key] = list(value)
        else:
            flat[prefix + spec.key] = value / spec.scale if spec.kind is float else value
    return flat
