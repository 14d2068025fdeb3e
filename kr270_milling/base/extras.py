"""Packages of the optional parts of the installation, checked before a long computation starts."""

from __future__ import annotations

import importlib.util

from kr270_milling.base.errors import MillingError


def require_extra(what: str, extra: str, *modules: str, otherwise: str = "") -> None:
    """Raise MillingError where one of the modules is not installed.

    what: the command, method or file that needs it; extra: its name, empty where pip installs the module by its name;
    otherwise: another remedy, as text.
    """
    for name in modules:
        if importlib.util.find_spec(name) is None:
            source = f"'.[{extra}]'" if extra else name
            raise MillingError(f"{what} needs {name}, which is not installed: pip install {source}{otherwise}")
