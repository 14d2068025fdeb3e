"""The page of a study or an identification: sentences, tables and Plotly figures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from html import escape
from pathlib import Path

import numpy as np

from kr270_milling.base.column import TextTable
from kr270_milling.base.extras import require_extra
from kr270_milling.base.files import write_files
from kr270_milling.show.report import page
from kr270_milling.show.report.tables import micro, typographic

COLOURS: list[str] = page.COLOURS["light"]["series"]  # type: ignore[assignment]  #: a page replaces them in its dark theme
DIVERGING = page.COLOURS["light"]["diverging"]  #: for values about zero


def figure_of(title: str, x: str, y: str):
    """Return a Plotly figure without a trace; x, y: titles of its axes."""
    require_extra("a figure", "", "plotly")
    import plotly.graph_objects as go

    figure = go.Figure(layout=dict(template="plotly_white", colorway=COLOURS, height=380))
    figure._ipython_display_ = partial(_show, figure)
    return figure.update_layout(title=micro(title), xaxis_title=micro(x), yaxis_title=micro(y))


def _show(figure) -> None:
    """Show a figure in a notebook, with a static image for converters of notebooks (nbconvert) that run no script."""
    import plotly.io

    try:
        plotly.io.show(figure, renderer=f"{plotly.io.renderers.default}+svg")
    except (RuntimeError, ValueError):  # without Kaleido, or without the browser that it starts
        plotly.io.show(figure)


def points(title: str, x: str, y: str, series: dict, lines: tuple[str, ...] = (), style: dict | None = None):
    """Return a figure of series, name -> (x values, y values).

    lines: names of the series that are lines; style: name -> (colour, symbol).
    """
    figure = figure_of(title, x, y)
    for number, (name, (across, up)) in enumerate(series.items()):
        mode = "lines" if name in lines else "markers"
        colour, symbol = (style or {}).get(name, (COLOURS[number % len(COLOURS)], "circle"))
        marker = dict(color=colour, symbol=symbol, size=8, line=dict(width=1.5, color=colour))
        across, up = np.asarray(across).tolist(), np.asarray(up).tolist()
        figure.add_scatter(name=micro(name), x=across, y=up, mode=mode, marker=marker, line=dict(color=colour))
    return figure


def write_page(path: Path, title: str, sentences, tables, figures, *, self_contained: bool = False) -> Path:
    """Write one HTML file that needs no network; tables: of type TextTable; figures: of Plotly.

    The pages of one folder share ``plotly.min.js`` next to them; self_contained: the page contains plotly instead.
    Returns the path of the page.
    """
    text = page.page_text(
        "study",
        ("base", "study"),
        shared=not self_contained,
        title=title,
        sentences=[_capital(micro(text)) for text in sentences],
        tables=[*map(typographic, tables)],
        figures=[_capital(figure.layout.title.text or "") for figure in figures],
        data=page.to_json({"figures": [_plain_figure(figure) for figure in figures]}),
    )
    beside = {} if self_contained else {path.with_name(page.PLOTLY_FILE): (page.plotly_script(),)}
    write_files({path: (text,), **beside})
    return path


def fragment(sentences: Sequence[str], tables: Sequence[TextTable]) -> str:
    """Sentences and tables as HTML without a page around them, for a notebook; all texts are escaped."""
    parts = [f"<p>{escape(micro(text))}</p>" for text in sentences]
    for table in map(typographic, tables):
        head = "".join(f"<th>{escape(name)}</th>" for name in table.columns)
        rows = ("".join(f"<td>{escape(text)}</td>" for text in row) for row in table.rows)
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        parts.append(f"<table><caption>{escape(table.title)}</caption><tr>{head}</tr>{body}</table>")
    return "".join(parts)


def _capital(text: str) -> str:
    """Return a text with a capital first letter, except a key or a name of a file."""
    return text if set("_.") & set(text.partition(" ")[0]) else text[:1].upper() + text[1:]


def _plain_figure(figure) -> dict:
    """Traces and layout of a figure without its style."""
    known = figure.to_plotly_json()
    layout = {key: value for key, value in known["layout"].items() if key not in ("template", "colorway", "title")}
    return {"data": known["data"], "layout": layout}
