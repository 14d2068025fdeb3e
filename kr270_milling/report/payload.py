"""Numbers for the page: JSON in which long rows are base64 of little-endian float32, and numbers in words."""

from __future__ import annotations

import base64
import dataclasses
import json

import numpy as np

__all__ = ["fixed", "packed", "to_json"]

LONG = 12  #: a longer row is packed


def fixed(value: float, digits: int) -> str:
    """Fixed decimals with a typographer's minus, never "-0"; a dash where there is no number."""
    if value is None or not np.isfinite(value):
        return "–"
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


def packed(values: np.ndarray) -> dict:
    """``{"f32": base64, "shape": [...]}``; whole numbers as ``i32``. The page reads it into a typed array."""
    array = np.asarray(values)
    kind = "i32" if array.dtype.kind in "iub" else "f32"
    raw = np.ascontiguousarray(array, "<i4" if kind == "i32" else "<f4").tobytes()
    return {kind: base64.b64encode(raw).decode(), "shape": list(array.shape)}


def to_json(value) -> str:
    """JSON for a ``<script>`` element: nothing in it can end the element; what is not finite is null."""
    text = json.dumps(_plain(value), allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _plain(value):
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return packed(value) if value.size > LONG else _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
