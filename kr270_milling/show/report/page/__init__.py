"""HTML pages out of plain values: one base template with style, scripts and data; plotly is inside or next to it."""

from __future__ import annotations

import base64
import functools
import json
from collections.abc import Sequence
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup

from kr270_milling.base.column import json_value
from kr270_milling.base.extensions import require_extra
from kr270_milling.base.version import __version__

HERE = Path(__file__).parent
PLOTLY_FILE = "plotly.min.js"  #: next to pages that do not contain plotly
#: series: the colours of Okabe and Ito (black, vermilion, blue, green, purple, sky blue), darker or lighter for
#: contrast, then grey and brown; diverging: from blue to vermilion about a neutral middle. Both are distinct for every
#: kind of colour vision.
COLOURS = {
    "light": {
        "series": ["#222222", "#c44e00", "#0067a5", "#007d5a", "#a8518a", "#2d8fc4", "#777777", "#a0703c"],
        "diverging": [[0, "#084f96"], [0.25, "#6ba9d6"], [0.5, "#e4e4e4"], [0.75, "#f09a68"], [1, "#a32a00"]],
    },
    "dark": {
        "series": ["#f2f2f2", "#ff8f4f", "#62b5ff", "#3fd0a2", "#e59ac6", "#a9ddff", "#9aa5b0", "#c79a66"],
        "diverging": [[0, "#7cc0ff"], [0.25, "#3c78b8"], [0.5, "#4a525b"], [0.75, "#c8643a"], [1, "#ffa06a"]],
    },
}


@functools.cache
def plotly_script() -> Markup:
    """plotly.min.js as the plotly package ships it."""
    require_extra("a page", "", "plotly")
    import plotly

    text = (Path(plotly.__file__).parent / "package_data" / PLOTLY_FILE).read_text(encoding="utf-8")
    return Markup(text.replace("</script", "<\\/script"))


@functools.cache
def _templates() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def page_text(template: str, scripts: Sequence[str], shared: bool = False, **values) -> str:
    """Return the HTML text of a page in the report's style; texts among the values are escaped.

    template, scripts: names of files in this folder, without suffix; shared: the page loads plotly from PLOTLY_FILE in
    its folder and does not contain plotly.
    """
    return (
        _templates()
        .get_template(f"{template}.html")
        .render(
            version=__version__,
            colours=json.dumps(COLOURS, separators=(",", ":")),
            style=Markup(_text("report.css")),
            shared=PLOTLY_FILE if shared else "",
            plotly=plotly_script(),
            scripts=Markup("\n".join(_text(f"{name}.js") for name in scripts)),
            **values,
        )
    )


def _text(name: str) -> str:
    return (HERE / name).read_text(encoding="utf-8")


def to_json(value) -> Markup:
    """JSON for a ``<script>`` element: no text in it can end the element; numbers that are not finite are null.

    Long rows become ``{"f32": base64, "shape": [...]}``, whole numbers ``i32``: little-endian, read into typed arrays.
    """
    text = json.dumps(json_value(value, _packed), allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    return Markup(text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026"))


def _packed(array: np.ndarray | np.generic):
    if array.size <= 12:  # numbers
        return array.tolist()
    kind, dtype = ("i32", "<i4") if array.dtype.kind in "iub" else ("f32", "<f4")
    raw = np.ascontiguousarray(array, dtype).tobytes()
    return {kind: base64.b64encode(raw).decode(), "shape": list(array.shape)}
