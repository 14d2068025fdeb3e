"""Pictures of what was identified or mapped, as one page that needs no network."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from kr270_milling.identification.compliance import Fit

__all__ = ["compliance_figures", "points", "write_page"]

STYLE = """body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}
table{border-collapse:collapse;margin:1rem 0}td,th{padding:.2rem .8rem;text-align:right;border-bottom:1px solid #ccc}
td:first-child,th:first-child{text-align:left}.wide{overflow-x:auto}
@media(prefers-color-scheme:dark){body{background:#14171a;color:#e6e6e6}.plot{filter:invert(.9) hue-rotate(180deg)}}"""


def _figure(title: str, x: str, y: str):
    import plotly.graph_objects as go

    layout = dict(template="plotly_white", height=380, margin=dict(l=70, r=20, t=50, b=60))
    figure = go.Figure(layout=layout)
    return figure.update_layout(title=title, xaxis_title=x, yaxis_title=y)


def points(title: str, x: str, y: str, series: dict, lines: tuple[str, ...] = (), style: dict | None = None):
    """Name -> (x values, y values); lines: names that are drawn as lines; style: name -> (colour, symbol)."""
    figure = _figure(title, x, y)
    for name, (across, up) in series.items():
        mode = "lines" if name in lines else "markers"
        colour, symbol = (style or {}).get(name, (None, "circle"))
        marker = dict(color=colour, symbol=symbol, size=8, line=dict(width=1.5, color=colour))
        figure.add_scatter(
            name=name, x=np.asarray(across).tolist(), y=np.asarray(up).tolist(), mode=mode, marker=marker
        )
    return figure


def compliance_figures(found: Fit) -> list:
    """Compliances with their intervals, residuals of each test and against the normal distribution, correlation."""
    from scipy.stats import norm

    bars = _figure("Joint compliances", "", "[urad/(N m)]")
    values, widths = found.values[:6], np.where(np.isfinite(found.half_widths[:6]), found.half_widths[:6], 0.0)
    spread = dict(type="data", array=(1e6 * widths).tolist())
    joints, names = found.problem.names[:6], found.problem.names
    bars.add_bar(name="identified, 95 %", x=joints, y=(1e6 * values).tolist(), error_y=spread)
    bars.add_bar(name="arm file", x=joints, y=(1e6 * found.problem.arm.joint_compliance).tolist())
    heat = _figure("Correlation of what was fitted", "", "")
    heat.add_heatmap(x=names, y=names, z=found.correlation.tolist(), zmin=-1, zmax=1, colorscale="RdBu",
                     texttemplate="%{z:.2f}")  # fmt: skip
    heat.update_layout(yaxis_autorange="reversed", height=480)
    left = 1e6 * found.residuals[:, :3]
    tests = np.arange(1, len(left) + 1)
    scaled = np.sort((found.residuals / found.problem.measured.sigma)[found.problem.finite])
    normal = norm.ppf((np.arange(scaled.size) + 0.5) / scaled.size)
    modelled = 1e6 * (found.problem.measured.displacement - found.residuals)[:, :3]
    seen = 1e6 * found.problem.measured.displacement[:, :3]
    axes = list(enumerate("xyz"))
    return [
        bars,
        points("Measured against modelled displacement", "modelled [um]", "measured [um]",
               {a: (modelled[:, i], seen[:, i]) for i, a in axes}),
        points("Residuals of each load test", "test", "measured less modelled [um]",
               {a: (tests, left[:, i]) for i, a in axes}),
        points("Residuals against the normal distribution", "normal quantile", "residual [standard deviations]",
               {"residuals": (normal, scaled), "normal": (normal, normal)}, ("normal",)),
        heat,
    ]  # fmt: skip


def write_page(
    path, title: str, sentences: list[str], tables: list[tuple[str, list[str], list[list]]], figures
) -> Path:
    """One HTML file with everything in it."""
    from plotly.io import to_html

    parts = [f"<h1>{html.escape(title)}</h1>", *(f"<p>{html.escape(s[:1].upper() + s[1:])}.</p>" for s in sentences)]
    for heading, columns, rows in tables:
        head = "".join(f"<th>{html.escape(c)}</th>" for c in columns)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(str(c))}</td>" for c in row) + "</tr>" for row in rows)
        parts.append(f"<h2>{html.escape(heading)}</h2><div class=wide><table><tr>{head}</tr>{body}</table></div>")
    for i, figure in enumerate(figures):
        part = to_html(
            figure, full_html=False, include_plotlyjs=i == 0, config={"displaylogo": False, "responsive": True}
        )
        parts.append(f"<div class='wide plot'>{part}</div>")
    page = (
        f"<!doctype html><html lang=en><head><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head><body>{''.join(parts)}</body></html>"
    )
    path = Path(path)
    path.write_text(page, encoding="utf-8")
    return path
