"""Objects of other installed packages, which these packages register as entry points of Python, and of scripts.

The groups are ``kr270_milling.force_laws``, ``kr270_milling.methods`` and ``kr270_milling.readers``.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from importlib.metadata import EntryPoint, entry_points
from typing import Any, NamedTuple

from kr270_milling.base.errors import ConfigError

__all__ = ["load_as", "refused", "register", "registered"]


class ScriptPoint(NamedTuple):
    """An object of a script, with the names of an entry point."""

    name: str
    group: str
    thing: Any
    dist: None = None

    @property
    def value(self) -> str:
        return repr(self.thing)

    @property
    def module(self) -> str:
        return self.thing.__module__

    @property
    def attr(self) -> str:
        return self.thing.__qualname__

    def load(self) -> object:
        return self.thing


_of_scripts: list[ScriptPoint] = []
_closed: set[str] = set()  # groups whose table is complete


def register(group: str, name: str, thing: object) -> None:
    """Add a force law, method or reader of a script, as an installed package does by an entry point.

    group: force_laws, methods or readers. Call this before the first cell is read: the table of the group is complete
    then, and ConfigError is raised.
    """
    point = ScriptPoint(name, f"kr270_milling.{group}", thing)
    if group in _closed:
        raise refused(point, "the table is complete; register the object before the first import of the models")
    _of_scripts.append(point)


def registered(group: str, known: Container[str]) -> list[EntryPoint | ScriptPoint]:
    """The entry points of ``kr270_milling.<group>``, by name; raises ConfigError for a name that is taken."""
    _closed.add(group)
    own = [point for point in _of_scripts if point.group == f"kr270_milling.{group}"]
    points = sorted([*entry_points(group=f"kr270_milling.{group}"), *own], key=lambda point: point.name)
    for before, point in zip([None, *points], points, strict=False):
        if point.name in known or (before is not None and before.name == point.name):
            raise refused(point, "this name is taken; choose another one")
    return points


def load_as(point: EntryPoint | ScriptPoint, valid: Callable[[object], bool], kind: str):
    """The object of an entry point; raises ConfigError where the import fails or the object is of another kind."""
    try:
        loaded = point.load()
    except (ImportError, AttributeError, SyntaxError) as error:
        raise refused(point, f"cannot be imported ({type(error).__name__}: {error})") from None
    if not valid(loaded):
        raise refused(point, f"{point.value} is no {kind}")
    return loaded


def refused(point: EntryPoint | ScriptPoint, reason: str) -> ConfigError:
    """The error for an entry point that cannot be used."""
    package = point.dist.name if point.dist else "an installed package"
    package = "this script" if isinstance(point, ScriptPoint) else f"package {package}"
    return ConfigError(package, f"entry point {point.name} of {point.group}", None, reason)
