"""Objects of other installed packages, which these packages register as entry points of Python, and of a script.

The groups are ``kr270_milling.force_laws``, ``kr270_milling.methods`` and ``kr270_milling.readers``.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from importlib.metadata import EntryPoint, entry_points

from kr270_milling.base.errors import ConfigError

_of_script: list[EntryPoint] = []
_complete: set[str] = set()  # groups whose table was made


def register(group: str, name: str, value: str) -> None:
    """Add a force law, method or reader without an installed package: ``value`` is ``module:object``.

    group: force_laws, methods or readers. Call this before the first cell is read, for a force law before the
    first import of the models. Raises ConfigError.
    """
    point = EntryPoint(name, value, f"kr270_milling.{group}")
    if group in _complete:
        raise refused(point, "comes too late: register the object before the first cell is read")
    _of_script.append(point)


def registered(group: str, known: Container[str]) -> list[EntryPoint]:
    """The entry points of ``kr270_milling.<group>``, by name; raises ConfigError for a name that is taken."""
    _complete.add(group)
    own = [point for point in _of_script if point.group == f"kr270_milling.{group}"]
    points = sorted([*entry_points(group=f"kr270_milling.{group}"), *own], key=lambda point: point.name)
    for before, point in zip([None, *points], points, strict=False):
        if point.name in known or (before is not None and before.name == point.name):
            raise refused(point, "this name is taken; choose another one")
    return points


def load_as(point: EntryPoint, valid: Callable[[object], bool], kind: str):
    """The object of an entry point; raises ConfigError where the import fails or the object is of another kind."""
    try:
        loaded = point.load()
    except (ImportError, AttributeError, SyntaxError) as error:
        raise refused(point, f"cannot be imported ({type(error).__name__}: {error})") from None
    if not valid(loaded):
        raise refused(point, f"{point.value} is no {kind}")
    return loaded


def refused(point: EntryPoint, reason: str) -> ConfigError:
    """The error for an entry point that cannot be used."""
    package = point.dist.name if point.dist else "of this script"
    return ConfigError(f"package {package}", f"entry point {point.name} of {point.group}", None, reason)
