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
import os
import sysconfig
import typing
from pathlib import Path

import numpy as np

from kr270_milling.errors import ConfigError, ParameterError

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
        shown = [float(v) for v in (value / spec.scale).ravel()]
        if value.ndim != 1 or spec.size not in (None, value.size):
            raise ParameterError(spec.key, shown, spec.allowed)
    elif spec.kind in (float, int):
        shown = value / spec.scale
    elif spec.kind is tuple:
        value = shown = tuple(value)
    else:
        shown = value
    if spec.choices and not set(shown if spec.kind is tuple else [shown]) <= set(spec.choices):
        raise ParameterError(spec.key, shown, spec.allowed)
    if spec.kind in (float, int, np.ndarray):
        numbers = np.atleast_1d(np.asarray(shown, float))
        slack = 1e-12 * np.abs(numbers)  # the way to SI and back may cost an ulp
        inside = (numbers + slack >= spec.low) & (numbers - slack <= spec.high) & (numbers > spec.above)
        if not np.all(inside & np.isfinite(numbers)):  # NaN fails
            raise ParameterError(spec.key, shown, spec.allowed)
    return value


def build(record: type[Record], tree: dict, file="", prefix: str = "", lenient: frozenset = frozenset()):
    """A record from the nested dict of a parameter file.

    ``lenient`` names the dotted keys whose whole numbers may stand for floats (those typed on a command line).
    Raises ConfigError for unknown, missing and unusable keys.
    """
    if not isinstance(tree, dict):
        raise ConfigError(file, prefix.rstrip("."), tree, "a group of keys")
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
    refuse = ConfigError(file, path, value, spec.allowed)
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
    return np.array([_number(v, refuse, lenient) for v in value], float) * spec.scale


def _number(value, refuse: ConfigError, lenient: bool) -> float:
    if isinstance(value, str):  # YAML 1.1 reads 1e-5 as a text, the ROS parser as a number
        try:
            return float(value)
        except ValueError:
            raise refuse from None
    if type(value) is float or (lenient and type(value) is int):
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


def read_tree(path, seen: tuple = ()) -> dict:
    """The ``/**: ros__parameters:`` dict of a parameter file, merged over the files that its ``includes`` names."""
    import yaml

    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(path, "", None, f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ConfigError(path, "", None, "is not UTF-8 text") from None
    try:
        document = yaml.load(text, Loader=_strict_loader())
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ConfigError(path, "", None, "is not valid YAML: " + " ".join(str(error).split())) from None
    tree = document
    for key in ("/**", "ros__parameters"):
        if not isinstance(tree, dict) or set(tree) != {key}:
            raise ConfigError(path, "", None, "must have the form '/**: ros__parameters: ...' of a ROS parameter file")
        tree = tree[key]
    if not isinstance(tree, dict):
        raise ConfigError(path, "/**.ros__parameters", tree, "a group of keys")
    merged: dict = {}
    includes = tree.pop("includes", [])
    if not isinstance(includes, list) or not all(isinstance(i, str) for i in includes):
        raise ConfigError(path, "includes", includes, "a list of file names")
    for name in includes:
        if path.resolve() in seen:
            raise ConfigError(path, "includes", name, "free of circles")
        merged = merge(merged, read_tree(find_file(name, path.parent), (*seen, path.resolve())))
    return merge(merged, tree)


@functools.cache
def _strict_loader():
    import yaml

    class Loader(yaml.SafeLoader):
        """Refuses the same key twice."""

        def construct_mapping(self, node, deep=False):
            keys = [self.construct_object(k, deep=True) for k, _ in node.value]
            for i, key in enumerate(keys):
                if key in keys[:i]:
                    raise yaml.YAMLError(
                        f"the key {key!r} stands twice, again in line {node.value[i][0].start_mark.line + 1}"
                    )
            return super().construct_mapping(node, deep)

    return Loader


def merge(below: dict, above: dict) -> dict:
    """``above`` laid over ``below``, group by group."""
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = merge(merged[key], value) if both else value
    return merged


def override(tree: dict, assignments: typing.Iterable[str]) -> tuple[dict, frozenset]:
    """Apply ``key=value`` texts (dotted keys); returns the new tree and the keys set, for ``build``'s ``lenient``."""
    import yaml

    keys = set()
    for text in assignments:
        key, equals, value = text.partition("=")
        if not equals or not all(key.split(".")):
            raise ConfigError("--set", text, None, "must have the form key=value")
        try:
            parsed: object = yaml.safe_load(value)
        except yaml.YAMLError:
            raise ConfigError("--set", key, value, "a number, a text or a list in brackets") from None
        for part in reversed(key.split(".")):
            parsed = {part: parsed}
        tree = merge(tree, typing.cast(dict, parsed))
        keys.add(key)
    return tree, frozenset(keys)


def find_file(name: str, beside: Path | None = None) -> Path:
    """A parameter file by path, beside another file, or among the shipped ones; raises ConfigError if nowhere."""
    places = [Path(name)] if beside is None else [beside / name]
    places += [directory / Path(name).name for directory in shipped_directories()]
    for place in places:
        if place.is_file():
            return place
    raise ConfigError(name, "", None, f"is no such file (looked at {', '.join(str(p) for p in places)})")


def shipped_directories() -> list[Path]:
    """Where the shipped ``config`` lies: under the ament index, under the Python prefix, in a source checkout."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) + [sysconfig.get_path("data")]
    found = [Path(p) / "share" / "kr270_milling" / "config" for p in prefixes if p]
    found.append(Path(__file__).resolve().parent.parent / "config")
    return [p for p in found if p.is_dir()]
