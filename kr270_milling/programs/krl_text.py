"""Numbers, frames and comments as a KR C4 reads them."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

import numpy as np

from kr270_milling.base.frames import Pose, abc_from_rotation

__all__ = ["axis_text", "comments", "frame_row", "frame_text", "number", "position_text"]

WIDEST = 100  #: characters of a comment line


def number(value: float, digits: int) -> str:
    """With so many decimals, and no minus before a zero."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text


def frame_row(pose: Pose) -> np.ndarray:
    """X, Y, Z [mm], A, B, C [deg], (..., 6)."""
    return np.concatenate([pose.position * 1e3, np.degrees(abc_from_rotation(pose.rotation))], axis=-1)


def frame_text(row: Sequence[float] | np.ndarray) -> str:
    """X, Y, Z [mm] to 0.1 um, A, B, C [deg] to 1e-5."""
    texts = [number(v, 4 if i < 3 else 5) for i, v in enumerate(row)]
    return ",".join(f"{name} {text}" for name, text in zip("XYZABC", texts, strict=True))


def position_text(row: Sequence[float], status: int, turn: int) -> str:
    """An E6POS."""
    external = ",".join(f"E{i} 0.0" for i in range(1, 7))
    return f"{frame_text(row)},S {status},T {turn},{external}"


def axis_text(degrees: Sequence[float]) -> str:
    """An E6AXIS."""
    joints = ",".join(f"A{i} {number(v, 4)}" for i, v in enumerate(degrees, 1))
    return f"{joints}," + ",".join(f"E{i} 0.0" for i in range(1, 7))


def comments(texts: Iterable[str]) -> list[str]:
    """Each text as comment lines that a controller's editor shows."""
    ascii_only = (text.encode("ascii", "replace").decode() for text in texts)
    return [f"; {line}" for text in ascii_only for line in textwrap.wrap(text, WIDEST)]
