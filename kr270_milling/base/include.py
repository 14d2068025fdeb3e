"""A parameter file that a command writes: what was identified, or a cell of a study."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

__all__ = ["write_include"]


def write_include(path, sections: dict, notes: list[str], digits: int = 6) -> Path:
    """A ROS parameter file; sections: nested groups, a value is a number, a list, a text or (value, comment)."""
    lines = [f"# {note}" for note in notes] + ["/**:", "  ros__parameters:"]
    _write(lines, sections, 4, digits)
    path = Path(path)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _write(lines: list[str], group: dict, indent: int, digits: int) -> None:
    for key, value in group.items():
        value, comment = value if isinstance(value, tuple) else (value, "")
        comment = f"   # {comment}" if comment else ""
        if isinstance(value, dict):
            lines.append(f"{' ' * indent}{key}:{comment}")
            _write(lines, value, indent + 2, digits)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            lines.append(f"{' ' * indent}{key}:{comment}")
            for item in value:
                inner: list[str] = []
                _write(inner, item, indent + 4, digits)
                inner[0] = " " * (indent + 2) + "- " + inner[0].lstrip()
                lines += inner
        else:
            lines.append(f"{' ' * indent}{key}: {_text(value, digits)}{comment}")


def _text(value, digits: int) -> str:
    """As the ROS parser reads it: a number with a point, or with a point and an exponent."""
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(json.dumps(v) if isinstance(v, str) else _text(v, digits) for v in value) + "]"
    if isinstance(value, (bool, np.bool_)):
        return str(value).lower()
    if isinstance(value, (float, np.floating)):
        text = f"{float(value):.{digits}g}"
        if "e" in text:
            mantissa, exponent = text.split("e")
            return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{exponent}"
        return text if "." in text else text + ".0"
    return str(value)
