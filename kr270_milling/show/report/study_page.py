"""The page of a study or an identification: sentences, tables and Plotly figures."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from kr270_milling.base.column import TextTable
from kr270_milling.show.report.page.page import HERE, page_text
from kr270_milling.show.report.tables import micro, typographic

__all__ = ["figure_of", "fragment", "points", "write_page"]

CLEAR = "rgba(0,0,0,0)"
CONFIG = {"displaylogo": False, "responsive": True}


def figure_of(title: str, x: str, y: str):
    """Return a Plotly figure without a trace; x, y: titles of its axes."""
    import plotly.graph_objects as go

    layout = dict(template="plotly_white", height=380, margin=dict(l=70, r=20, t=50, b=60), paper_bgcolor=CLEAR,
                  plot_bgcolor=CLEAR, legend=dict(orientation="h", y=1, yanchor="bottom"))  # fmt: skip
    figure = go.Figure(layout=layout)
    return figure.update_layout(title=_typographic(title), xaxis_title=_typographic(x), yaxis_title=_typographic(y))


def points(title: str, x: str, y: str, series: dict, lines: tuple[str, ...] = (), style: dict | None = None):
    """Return a figure of series, name -> (x values, y values).

    lines: names of the series that are lines; style: name -> (colour, symbol).
    """
    figure = figure_of(title, x, y)
    for name, (across, up) in series.items():
        mode = "lines" if name in lines else "markers"
        colour, symbol = (style or {}).get(name, (None, "circle"))
        marker = dict(color=colour, symbol=symbol, size=8, line=dict(width=1.5, color=colour))
        across, up = np.asarray(across).tolist(), np.asarray(up).tolist()
        figure.add_scatter(name=name, x=across, y=up, mode=mode, marker=marker)
    return figure


def write_page(path: Path, title: str, sentences, tables, figures) -> Path:
    """Write one HTML file that needs no network; tables: of type TextTable."""
    text = page_text(
        HERE / "study.html",
        [],
        title=title,
        sentences=[_typographic(text[:1].upper() + text[1:]) for text in sentences],
        tables=[table._replace(columns=[*map(_typographic, table.columns)]) for table in tables],
        plots=[_plot(figure) for figure in figures],
    )
    path.write_text(text, encoding="utf-8")
    return path


def fragment(sentences: Sequence[str], tables: Sequence[TextTable]) -> str:
    """Sentences and tables as HTML without a page around them, for a notebook; all texts are escaped."""
    parts = [f"<p>{escape(_typographic(text))}</p>" for text in sentences]
    for table in map(typographic, tables):
        head = "".join(f"<th>{escape(name)}</th>" for name in table.columns)
        rows = ("".join(f"<td>{escape(text)}</td>" for text in row) for row in table.rows)
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        parts.append(f"<table><caption>{escape(table.title)}</caption><tr>{head}</tr>{body}</table>")
    return "".join(parts)


def _plot(figure) -> str:
    from plotly.io import to_html

    return to_html(figure, full_html=False, include_plotlyjs=False, config=CONFIG)


def _typographic(text: str) -> str:
    return micro(text).replace("+-", "±")
