"""One self-contained HTML page out of plain values: template, style, scripts and data are all inside."""

from __future__ import annotations

import base64
import dataclasses
import functools
import json
from collections.abc import Sequence
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup

from kr270_milling.base.version import __version__

__all__ = ["BASE_SCRIPT", "SCRIPTS", "page_text", "plotly_script", "to_json"]

HERE = Path(__file__).parent
BASE_SCRIPT = HERE / "base.js"
#: of the report, in the order in which the page runs them
SCRIPTS = (BASE_SCRIPT, *(
    HERE / f"{name}.js" for name in ("place", "maps", "series", "source", "part", "robot", "charts", "start")
))  # fmt: skip
LONG = 12  #: a longer row is packed


@functools.cache
def plotly_script() -> Markup:
    """plotly.min.js as the plotly package ships it."""
    import plotly

    return Markup(
        _text(Path(plotly.__file__).parent / "package_data" / "plotly.min.js").replace("</script", "<\\/script")
    )


def page_text(template: Path, scripts: Sequence[Path], **values) -> str:
    """The whole HTML text in the report's style, with plotly and our own scripts; other texts are escaped."""
    text, strict = _text(template), jinja2.StrictUndefined
    return jinja2.Template(text, autoescape=True, undefined=strict, trim_blocks=True, lstrip_blocks=True).render(
        version=__version__,
        style=Markup(_text(HERE / "report.css")),
        plotly=plotly_script(),
        scripts=Markup("\n".join(map(_text, scripts))),
        **values,
    )


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def to_json(value) -> Markup:
    """JSON for a ``<script>`` element: nothing in it can end the element; what is not finite is null.

    Long rows become ``{"f32": base64, "shape": [...]}``, whole numbers ``i32``: little-endian, read into typed arrays.
    """
    text = json.dumps(_plain(value), allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def _plain(value):
    if dataclasses.is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray) and value.size > LONG:
        kind, dtype = ("i32", "<i4") if value.dtype.kind in "iub" else ("f32", "<f4")
        raw = np.ascontiguousarray(value, dtype).tobytes()
        return {kind: base64.b64encode(raw).decode(), "shape": list(value.shape)}
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
