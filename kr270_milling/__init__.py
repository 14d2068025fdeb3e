"""Predict and compensate the compliance errors of robotic milling [Klimchik2014].

>>> from kr270_milling import compensate, read_cell
>>> compensate(read_cell("paper.yaml"), "linear").original
<Pass original: static 58.10 um, max 62.79 um>
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from kr270_milling.base.version import __version__

if TYPE_CHECKING:
    from kr270_milling.api import check, compensate, read_cell, read_recording, simulate
    from kr270_milling.api import verdict_of as verdict
    from kr270_milling.path.trajectory import Trajectory

__all__ = ["Trajectory", "__version__", "check", "compensate", "read_cell", "read_recording", "simulate", "verdict"]

#: name -> module and name there; imported when asked for, so that the command line starts at once
_PLACES = {
    **{name: ("api", name) for name in ("check", "compensate", "read_cell", "read_recording", "simulate")},
    "verdict": ("api", "verdict_of"),
    "Trajectory": ("path.trajectory", "Trajectory"),
}


def __getattr__(name: str):
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, original = _PLACES[name]
    return getattr(importlib.import_module(f"{__name__}.{module}"), original)
