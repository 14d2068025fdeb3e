"""Predict and compensate the compliance errors of robotic milling [Klimchik2014].

>>> from kr270_milling import compensate, read_cell
>>> compensate(read_cell("paper.yaml"), "linear").original
<Pass original: static 58.10 um, max 62.79 um>
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from kr270_milling.base.errors import MillingError
from kr270_milling.base.version import __version__

if TYPE_CHECKING:
    from kr270_milling.api import (
        check,
        compare,
        compensate,
        identify,
        placements,
        read_cell,
        read_recording,
        simulate,
        stability,
        stiffness,
        sweep,
        verdict,
    )
    from kr270_milling.path.trajectory import Trajectory

__all__ = [
    "MillingError", "Trajectory", "__version__", "check", "compare", "compensate", "identify", "placements",
    "read_cell", "read_recording", "simulate", "stability", "stiffness", "sweep", "verdict",
]  # fmt: skip


def __getattr__(name: str):
    """Import a name when it is asked for, so that the command line starts at once."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "path.trajectory" if name == "Trajectory" else "api"
    return getattr(importlib.import_module(f"{__name__}.{module}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
