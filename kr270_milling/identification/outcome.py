"""What an identification or a study ends with: numbers, tables, sentences, a page of pictures, a parameter file."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling import __version__
from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import write_include

__all__ = ["Outcome", "figure_of", "points", "write_page"]

CLEAR = "rgba(0,0,0,0)"
PAGE = """<!doctype html><html lang=en><head><meta charset=utf-8><meta name=viewport content='width=device-width'>
<title>{{ title }}</title><style>
body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}
table{border-collapse:collapse;margin:1rem 0}td,th{padding:.2rem .8rem;text-align:right;border-bottom:1px solid #8888}
td:first-child,th:first-child{text-align:left}.wide{overflow-x:auto}h1{overflow-wrap:anywhere;line-height:1.25}
.plots{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,30rem),1fr))}.plots>*{min-width:0}
@media(prefers-color-scheme:dark){body{background:#14181c;color:#e8ecf0}
.plots text:not(.heatmap-label text){fill:#e8ecf0!important}
.plots .gridlayer path,.plots .zerolinelayer path{stroke:#39434d!important}}
</style></head><body><h1>{{ title }}</h1>
{% for text in sentences %}<p>{{ (text[:1].upper() + text[1:]) | micro }}.</p>{% endfor %}
{% for heading, columns, rows in tables %}
{% if heading != title %}<h2>{{ heading }}</h2>{% endif %}
<div class=wide><table><tr>{% for name in columns %}<th>{{ name | micro }}</th>{% endfor %}</tr>
{% for row in rows %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>{% endfor %}</table></div>
{% endfor %}
<div class=plots>{% for plot in plots %}{{ plot | safe }}{% endfor %}</div></body></html>"""


@dataclass(frozen=True)
class Outcome:
    """What is printed, and written into a directory as a page and as a parameter file."""

    name: str  #: of its files
    title: str
    result: dict  #: for JSON
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]]]]  #: title, columns, rows
    said: Sequence[str]  #: sentences
    figures: Callable[[], list] | None = None  #: makes the pictures of the page; None: there is no page
    sections: dict | None = None  #: of the parameter file; None: there is none
    use: str = ""  #: how to include it

    def write(self, directory) -> list[Path]:
        """Write page and parameter file; returns their paths."""
        notes = [f"{self.title}, identified by kr270_milling {__version__}", *self.said, self.use]
        files = []
        with staged(directory) as (draft, final):
            if self.sections is not None:
                files.append(write_include(draft / f"{self.name}.yaml", self.sections, notes))
            if self.figures is not None:
                page = draft / f"{self.name}.html"
                files.append(write_page(page, self.title, self.said, self.tables, self.figures()))
            return [final(path) for path in files]


def figure_of(title: str, x: str, y: str):
    """A plotly figure without any trace yet."""
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
        across, up = np.asarray(across).tolist(), np.asarray(up).tolist()
        figure.add_scatter(name=name, x=across, y=up, mode=mode, marker=marker)
    return figure


def write_page(path: Path, title: str, sentences, tables, figures) -> Path:
    """One HTML file that needs no network; tables: title, columns, rows of each."""
    from jinja2 import Environment
    from plotly.io import to_html

    environment = Environment(autoescape=True)
    environment.filters["micro"] = _micro
    how: dict = dict(full_html=False, config={"displaylogo": False, "responsive": True})
    plots = [to_html(figure, include_plotlyjs=i == 0, **how) for i, figure in enumerate(figures)]
    page = environment.from_string(PAGE).render(title=title, sentences=sentences, tables=tables, plots=plots)
    path.write_text(page, encoding="utf-8")
    return path
