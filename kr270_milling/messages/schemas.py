"""Message definitions as a recording stores them: one text per type, its dependencies behind it ("ros2msg").

The definitions are the ``.msg`` files that every ROS message package installs under ``share/<package>/msg``. They
are found from the place of the Python package, which is not imported, so that this works without a ROS graph.
"""

from __future__ import annotations

import functools
import importlib.util
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path

from kr270_milling.bag.errors import RecordingError

__all__ = ["Field", "fields", "schema_text", "starts_with_stamp", "type_hash"]

SEPARATOR = "=" * 80
PRIMITIVES = frozenset((
    "bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "uint64", "string", "wstring",
))  # fmt: skip
TYPE_NAME = re.compile(r"([a-z][a-z0-9_]*)/msg/([A-Za-z][A-Za-z0-9_]*)")
FIELD = re.compile(r"([A-Za-z][\w/]*)((?:<=\d+)?(?:\[[^\]]*\])?)\s+([A-Za-z]\w*)\s*(.*)")


@dataclass(frozen=True)
class Field:
    """One field of a message; ``type`` is a primitive or "pkg/msg/Name", ``suffix`` its bound and array part."""

    name: str
    type: str
    suffix: str


def fields(text: str, package: str) -> tuple[Field, ...]:
    """The fields of one definition in their order, without constants; ``package`` completes bare type names."""
    found = []
    for line in text.splitlines():
        match = FIELD.match(line.split("#", 1)[0].strip())
        if match and not match[4].startswith("="):
            found.append(Field(match[3], _full_name(match[1], package), match[2]))
    return tuple(found)


def _full_name(name: str, package: str) -> str:
    if name in PRIMITIVES:
        return name
    if name == "Header":
        return "std_msgs/msg/Header"
    parts = name.split("/")
    return f"{parts[0] if len(parts) > 1 else package}/msg/{parts[-1]}"


@functools.cache
def _definition(type_name: str) -> Path:
    """The ``.msg`` file of a type: beside the Python package in a wheel, an overlay or /opt/ros."""
    match = TYPE_NAME.fullmatch(type_name)
    if not match:
        raise RecordingError(type_name, 'this is not the name of a message type like "geometry_msgs/msg/PoseStamped"')
    tail = Path("share", match[1], "msg", match[2] + ".msg")
    spec = importlib.util.find_spec(match[1])
    places = list(spec.submodule_search_locations or []) if spec else []
    roots = [root for place in places for root in Path(place).resolve().parents]
    roots += [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    for root in roots:
        if (root / tail).is_file():
            return root / tail
    raise RecordingError(type_name, f"no {tail} was found; the message package {match[1]} is not installed")


@functools.cache
def _source(type_name: str) -> str:
    return _definition(type_name).read_text(encoding="utf-8")


@functools.cache
def schema_text(type_name: str) -> str:
    """The definition of a type followed by those of all types in it, each once, parted by 80 "=" and "MSG: name"."""
    order = [type_name]
    for name in order:  # grows while it is walked, which reaches every dependency once
        for field in fields(_source(name), name.split("/")[0]):
            if field.type not in PRIMITIVES and field.type not in order:
                order.append(field.type)
    parts = [_source(type_name)]
    parts += [f"MSG: {name.replace('/msg/', '/')}\n{_source(name)}" for name in order[1:]]
    return f"\n{SEPARATOR}\n".join(parts)


@functools.cache
def type_hash(type_name: str) -> str:
    """The RIHS01 hash of a type as the package that defines it states it; "" where it states none."""
    path = _definition(type_name).with_suffix(".json")
    if not path.is_file():
        return ""
    hashes = json.loads(path.read_text(encoding="utf-8")).get("type_hashes", [])
    return next((entry["hash_string"] for entry in hashes if entry["type_name"] == type_name), "")


def starts_with_stamp(type_name: str, text: str) -> bool:
    """Whether the bytes of a message begin with a time: a Header, or a Time as in Clock, is the first field."""
    main = re.split(r"^={80}$", text, maxsplit=1, flags=re.MULTILINE)[0]
    first = fields(main, type_name.split("/")[0])[:1]
    starts = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    return bool(first) and first[0].type in starts and not first[0].suffix
