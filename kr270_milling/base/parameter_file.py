"""Read and write parameter files (YAML, ``/**: ros__parameters: ...``), their includes and ``--set`` overrides."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import os
import re
import sysconfig
import typing
from pathlib import Path

from kr270_milling.base.errors import ConfigError

MOST_BYTES = 256 * 1024  # the YAML reader needs some seconds for a file of this size
#: group -> key with the numbers of the controller's display, their name there, largest distance [mm]
DISPLAYED = {"mount": ("tool_kuka", "TOOL_DATA", 5000.0), "workpiece": ("base_kuka", "BASE_DATA", 100000.0)}
AXES = "XYZABC"


def refusal(file, key: str, value, allowed: str) -> ConfigError:
    """Return the error for a value of a file; a key without a value has its own text."""
    if value is None:
        return ConfigError(file, key, None, f"has no value, it must be {allowed}")
    return ConfigError(file, key, value, allowed)


def read_tree(path) -> dict:
    """Return the ``/**: ros__parameters:`` dict of a parameter file, merged over the files of its ``includes``.

    Each file is read once, even if several files include it. Raises ConfigError, also for more than 64
    names in all files together and for a chain of more than 8 includes.
    """
    return _merged(Path(path), (), {}, [])


def _merged(path: Path, above: tuple[Path, ...], trees: dict[Path, dict], named: list[str]) -> dict:
    """Merge a file over its includes.

    above: the chain of files that include this file; trees: files already read; named: all included names so far.
    """
    place = path.resolve()
    if place in trees:
        return trees[place]
    includes, tree = _content(path)
    named += includes
    most_includes = 64  # names in all files together; merging a file of MOST_BYTES takes some milliseconds
    most_depth = 8  # length of a chain of includes
    if len(named) > most_includes or (includes and len(above) >= most_depth):
        most = f"at most {most_includes} names of files in all, {most_depth} deep"
        raise ConfigError(path, "includes", len(includes), most)
    merged: dict = {}
    for name in includes:
        included = find_file(name, path.parent)
        if included.resolve() in (*above, place):
            raise ConfigError(path, "includes", name, "free of circles")
        merged = merge(merged, _merged(included, (*above, place), trees, named))
    trees[place] = merge(merged, tree)
    return trees[place]


def _content(path: Path) -> tuple[list[str], dict]:
    """Return the names in ``includes`` and the other keys of a file."""
    tree = read_yaml(path)
    for key in ("/**", "ros__parameters"):
        if not isinstance(tree, dict) or set(tree) != {key}:
            raise ConfigError(path, "", None, "must have the form '/**: ros__parameters: ...' of a ROS parameter file")
        tree = tree[key]
    if not isinstance(tree, dict):
        raise refusal(path, "/**.ros__parameters", tree, "a group of keys")
    includes = tree.pop("includes", [])
    if not isinstance(includes, list) or not all(isinstance(i, str) for i in includes):
        raise refusal(path, "includes", includes, "a list of file names")
    return includes, from_display(_as_lists(tree, path), path)


def from_display(tree: dict, file, prefix: str = "") -> dict:
    """Return the tree of one file with the frames of the controller's display as ``xyz_mm`` and ``abc_deg``.

    mount.tool_kuka is tcp in $FLANGE, whose z points out of the flange; workpiece.base_kuka is the workpiece frame on
    $ROBROOT. A file that includes another one replaces its place in either form. Raises ConfigError, also where a file
    has both forms.
    """
    converted = {}
    for name, group in tree.items():
        if isinstance(group, dict):
            group = from_display(group, file, f"{prefix}{name}.")
            key, source, farthest = DISPLAYED.get(name, ("", "", 0.0))
            if key in group:
                group = _placed(group, key, source, farthest, file, f"{prefix}{name}.")
        converted[name] = group
    return converted


def _placed(group: dict, key: str, source: str, farthest: float, file, prefix: str) -> dict:
    """Return a group with ``xyz_mm`` and ``abc_deg`` in the place of the frame of the display."""
    import numpy as np

    from kr270_milling.base.frames import TOOL0, Pose, abc_from_rotation

    frame, form = group[key], f"X, Y, Z [mm] and A, B, C [deg], the numbers of {source} on the controller's display"
    twice = [name for name in ("xyz_mm", "abc_deg") if name in group]
    if twice:
        both = f"is given beside {prefix}{twice[0]}: give either {key} or xyz_mm and abc_deg"
        raise ConfigError(file, prefix + key, None, both)
    if not isinstance(frame, dict) or sorted(frame) != sorted(AXES):
        raise refusal(file, prefix + key, frame, form)
    values = []
    for axis in AXES:
        most = farthest if axis in "XYZ" else 360.0
        known = isinstance(frame[axis], (int, float, str)) and not isinstance(frame[axis], bool)
        try:
            values.append(float(frame[axis]) if known else math.nan)
        except ValueError:
            values.append(math.nan)
        if not abs(values[-1]) <= most:
            raise refusal(file, f"{prefix}{key}.{axis}", frame[axis], f"a number of {-most:g} to {most:g}")
    pose = Pose.from_abc(values[:3], np.radians(values[3:]))
    pose = TOOL0 @ pose if key == "tool_kuka" else pose
    rows = pose.position, np.degrees(abc_from_rotation(pose.rotation))
    rest = {name: value for name, value in group.items() if name != key}
    # the products of rotations add some 1e-13 to round numbers
    xyz, abc = ([round(value, 9) + 0.0 for value in row.tolist()] for row in rows)
    return rest | {"xyz_mm": xyz, "abc_deg": [180.0 if value == -180.0 else value for value in abc]}


def _as_lists(tree, file, key: str = ""):
    """Convert every list of groups into one group of lists; raise ConfigError.

    A ROS node has no lists of groups: ``[{a: 1.0}, {a: 2.0}]`` becomes ``{a: [1.0, 2.0]}``.
    """
    if isinstance(tree, dict):
        return {name: _as_lists(value, file, f"{key}.{name}".lstrip(".")) for name, value in tree.items()}
    if not isinstance(tree, list) or not tree or not all(isinstance(row, dict) for row in tree):
        return tree
    sizes = [{name: len(value) if isinstance(value, list) else 0 for name, value in row.items()} for row in tree]
    if any(size != sizes[0] for size in sizes):
        raise ConfigError(file, key, None, "must have the same keys in every group, with as many numbers each")
    columns: dict[str, list] = {name: [] for name in tree[0]}
    for row in tree:
        for name, value in row.items():
            columns[name] += value if isinstance(value, list) else [value]
    return columns


def read_yaml(path: Path):
    """Return the content of a YAML file of at most MOST_BYTES; raise ConfigError."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ConfigError(path, "", None, f"has more than {MOST_BYTES} bytes, so it is no parameter file")
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(path, "", None, f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ConfigError(path, "", None, "is not UTF-8 text") from None
    return parse(text, path, "")


def parse(text: str, file, key: str):
    """Return the content of a YAML text; repeated and merged ("<<") keys are refused; raises ConfigError."""
    import yaml

    try:
        return yaml.load(text, Loader=_strict_loader())  # noqa: S506 - a SafeLoader that is stricter still
    except RecursionError:
        raise ConfigError(file, key, None, "is not valid YAML: nested too deeply") from None
    except (yaml.YAMLError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        # PyYAML does not catch the errors of the constructor that an explicit tag selects
        raise ConfigError(file, key, None, "is not valid YAML: " + " ".join(str(error).split())) from None


@functools.cache
def _strict_loader():
    import yaml

    quick = (yaml.composer.Composer, yaml.CSafeLoader) if yaml.__with_libyaml__ else (yaml.SafeLoader,)

    class Loader(*quick):  # type: ignore[misc] # libyaml, which ROS uses, scans a file five times as fast as Python
        """Refuses repeated keys, numbers to the base 60 (1:30) and aliases (*name).

        ROS reads 1:30 as text and refuses aliases. A few lines of aliases can expand beyond any memory.
        """

        def __init__(self, stream):
            quick[-1].__init__(self, stream)
            self.anchors: dict = {}

        def compose_node(self, parent, index):
            if self.check_event(yaml.AliasEvent):
                line = self.peek_event().start_mark.line + 1
                raise yaml.YAMLError(f"line {line} contains an alias; write its value out")
            return super().compose_node(parent, index)

        def construct_mapping(self, node, deep=False):
            keys = set()
            for name, _ in node.value:
                key = self.construct_object(name, deep=True)
                if not isinstance(key, str):
                    raise yaml.YAMLError(f"the key in line {name.start_mark.line + 1} is not a text")
                if key in keys:
                    raise yaml.YAMLError(f"the key {key!r} occurs twice, again in line {name.start_mark.line + 1}")
                keys.add(key)
            return super().construct_mapping(node, deep)

        def construct_scalar(self, node):
            value = super().construct_scalar(node)
            number = node.tag in ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
            if number and re.search(r":|^[-+]?0[0-9_]", value):  # base 60; base 8, in which 010 is 8
                raise yaml.YAMLError(f"{value} in line {node.start_mark.line + 1} is not a number")
            return value

    return Loader


def merge(below: dict, above: dict) -> dict:
    """Return ``below`` with the values of ``above``, group by group."""
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = merge(merged[key], value) if both else value
    return merged


def override(tree: dict, assignments: typing.Iterable) -> tuple[dict, frozenset]:
    """Apply ``key=value`` texts (dotted keys); return the new tree and the keys that were set."""
    keys = set()
    for text in assignments:
        key, equals, value = text.partition("=") if isinstance(text, str) else ("", "", "")
        if not equals or not all(key.split(".")):
            raise ConfigError("--set", text, None, "must have the form key=value, a text for each key")
        parsed = parse(value, "--set", key)
        for part in reversed(key.split(".")):
            parsed = {part: parsed}
        tree = merge(tree, from_display(typing.cast(dict, _as_lists(parsed, "--set")), "--set"))
        keys.add(key)
    return tree, frozenset(keys)


def find_file(name: str, beside: Path | None = None) -> Path:
    """Return a parameter file by path, next to another file, or from the shipped files; raise ConfigError.

    A shipped file has its bare name or ``config/name``, so that a mistyped folder never opens another file.
    """
    places = [Path(name)] if beside is None else [beside / name]
    if Path(name).parent in (Path("."), Path("config")):
        places += [directory / Path(name).name for directory in shipped_directories()]
    kind = "no such file"
    for place in places:
        with contextlib.suppress(OSError, ValueError):  # too long, no permission, a zero byte in the name
            if place.is_file():
                return place
            kind = "a directory, not a file" if place.is_dir() else "no file" if place.exists() else kind
    raise ConfigError(name, "", None, f"is {kind} (looked at {', '.join(dict.fromkeys(map(str, places)))})")


def shipped_directories() -> list[Path]:
    """Return the directories of the shipped ``config``: source checkout, ament index, Python's prefix.

    The checkout is first, so that its code never reads the files of another installed version.
    """
    source = Path(__file__).resolve().parents[2]
    checkout = [source / "config"] if (source / "package.xml").is_file() else []
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) + [sysconfig.get_path("data")]
    installed = [Path(p) / "share" / "kr270_milling" / "config" for p in prefixes if p]
    return [p for p in (*checkout, *installed) if p.is_dir()]


def write_include(path, sections: dict, notes: list[str], digits: int = 6) -> Path:
    """Write a ROS parameter file; sections: nested groups; a value is a number, list, text or (value, comment)."""
    lines = [f"# {note}" for note in notes] + ["/**:", "  ros__parameters:"]
    _write_group(lines, sections, 4, digits)
    path = Path(path)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _write_group(lines: list[str], group: dict, indent: int, digits: int) -> None:
    for key, value in group.items():
        value, comment = value if isinstance(value, tuple) else (value, "")
        comment = f"   # {comment}" if comment else ""
        if isinstance(value, dict):
            lines.append(f"{' ' * indent}{key}:{comment}")
            _write_group(lines, value, indent + 2, digits)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            lines.append(f"{' ' * indent}{key}:{comment}")
            for item in value:
                inner: list[str] = []
                _write_group(inner, item, indent + 4, digits)
                inner[0] = " " * (indent + 2) + "- " + inner[0].lstrip()
                lines += inner
        else:
            lines.append(f"{' ' * indent}{key}: {_yaml_text(value, digits)}{comment}")


def _yaml_text(value, digits: int) -> str:
    """Return the value as YAML text; the ROS parser needs a decimal point in every float, also with an exponent."""
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(json.dumps(v) if isinstance(v, str) else _yaml_text(v, digits) for v in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        text = f"{value:.{digits}g}"
        if "e" in text:
            mantissa, exponent = text.split("e")
            return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{exponent}"
        return text if "." in text else text + ".0"
    return str(value)
