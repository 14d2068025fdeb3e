"""Pictures of what was identified or mapped, as one page that needs no network."""

from __future__ import annotations

import html
import re
from pathlib import Path

import numpy as np

__all__ = ["figure_of", "points", "write_page"]

STYLE = """body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}
table{border-collapse:collapse;margin:1rem 0}td,th{padding:.2rem .8rem;text-align:right;border-bottom:1px solid #8888}
td:first-child,th:first-child{text-align:left}.wide{overflow-x:auto}h1{overflow-wrap:anywhere;line-height:1.25}
.plots{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,30rem),1fr))}.plots>*{min-width:0}
@media(prefers-color-scheme:dark){body{background:#14181c;color:#e8ecf0}
.plots text:not(.heatmap-label text){fill:#e8ecf0!important}
.plots .gridlayer path,.plots .zerolinelayer path{stroke:#39434d!important}}"""
CLEAR = "rgba(0,0,0,0)"


def figure_of(title: str, x: str, y: str):
    import plotly.graph_objects as go

    layout = dict(template="plotly_white", height=380, margin=dict(l=70, r=20, t=50, b=60), paper_bgcolor=CLEAR,
                  plot_bgcolor=CLEAR, legend=dict(orientation="h", y=1, yanchor="bottom"))  # fmt: skip
    figure = go.Figure(layout=layout)
    return figure.update_layout(title=_micro(title), xaxis_title=_micro(x), yaxis_title=_micro(y))


def _micro(text: str) -> str:
    return re.sub(r"\bum\b", "µm", text).replace("+-", "±")


def points(title: str, x: str, y: str, series: dict, lines: tuple[str, ...] = (), style: dict | None = None):
    """Name -> (x values, y values); lines: names that are drawn as lines; style: name -> (colour, symbol)."""
    figure = figure_of(title, x, y)
    for name, (across, up) in series.items():
        mode = "lines" if name in lines else "markers"
        colour, symbol = (style or {}).get(name, (None, "circle"))
        marker = dict(color=colour, symbol=symbol, size=8, line=dict(width=1.5, color=colour))
        figure.add_scatter(
            name=name, x=np.asarray(across).tolist(), y=np.asarray(up).tolist(), mode=mode, marker=marker
        )
    return figure


def write_page(path, title: str, sentences, tables, figures) -> Path:
    """One HTML file with everything in it; tables: title, columns, rows of each."""
    from plotly.io import to_html

    parts = [f"<h1>{html.escape(title)}</h1>"]
    parts += [f"<p>{html.escape(_micro(s[:1].upper() + s[1:]))}.</p>" for s in sentences]
    for heading, columns, rows in tables:
        head = "".join(f"<th>{html.escape(_micro(c))}</th>" for c in columns)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
        above = f"<h2>{html.escape(heading)}</h2>" * (heading != title)
        parts.append(f"{above}<div class=wide><table><tr>{head}</tr>{body}</table></div>")
    parts.append("<div class=plots>")
    for i, figure in enumerate(figures):
        part = to_html(
            figure, full_html=False, include_plotlyjs=i == 0, config={"displaylogo": False, "responsive": True}
        )
        parts.append(part)
    parts.append("</div>")
    page = (
        f"<!doctype html><html lang=en><head><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head><body>{''.join(parts)}</body></html>"
    )
    path = Path(path)
    path.write_text(page, encoding="utf-8")
    return path
