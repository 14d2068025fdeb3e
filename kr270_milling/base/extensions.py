"""Other packages: those of the optional parts of the installation, and objects that packages or a script register.

The groups of entry points are ``kr270_milling.force_laws``, ``kr270_milling.methods`` and ``kr270_milling.readers``.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Container
from typing import TYPE_CHECKING

from kr270_milling.base.errors import ConfigError, MillingError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


def require_extra(what: str, extra: str, *modules: str, otherwise: str = "") -> None:
    """Raise MillingError where one of the modules is not installed.

    what: the command, method or file that needs it; extra: its name, empty where pip installs the module by its name;
    otherwise: another remedy, as text.
    """
    for name in modules:
        if importlib.util.find_spec(name) is None:
            source = f"'.[{extra}]'" if extra else name
            raise MillingError(f"{what} needs {name}, which is not installed: pip install {source}{otherwise}")


_of_script: list[EntryPoint] = []
_complete: set[str] = set()  # groups whose table was made


def register(group: str, name: str, value: str) -> None:
    """Add a force law, method or reader without an installed package: ``value`` is ``module:object``.

    group: force_laws, methods or readers. Call this before the first cell is read, for a force law before the
    first import of the models. Raises ConfigError.
    """
    from importlib.metadata import EntryPoint  # takes longer to import than ``--help`` runs

    point = EntryPoint(name, value, f"kr270_milling.{group}")
    if group in _complete:
        raise refused(point, "comes too late: register the object before the first cell is read")
    _of_script.append(point)


def registered(group: str, known: Container[str]) -> list[EntryPoint]:
    """The entry points of ``kr270_milling.<group>``, by name; raises ConfigError for a name that is taken."""
    from importlib.metadata import entry_points

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
    except Exception as error:  # noqa: BLE001 - code of another package may raise anything
        raise refused(point, f"cannot be imported ({type(error).__name__}: {error})") from None
    if not valid(loaded):
        raise refused(point, f"{point.value} is no {kind}")
    return loaded


def refused(point: EntryPoint, reason: str) -> ConfigError:
    """The error for an entry point that cannot be used."""
    package = point.dist.name if point.dist else "of this script"
    return ConfigError(f"package {package}", f"entry point {point.name} of {point.group}", None, reason)
