"""Pictures of what was identified or mapped, as one page that needs no network."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from kr270_milling.identification.compliance import Fit

__all__ = ["bars_with_intervals", "compliance_figures", "heat", "points", "write_page"]

STYLE = """body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}
table{border-collapse:collapse;margin:1rem 0}td,th{padding:.2rem .8rem;text-align:right;border-bottom:1px solid #ccc}
td:first-child,th:first-child{text-align:left}.wide{overflow-x:auto}
@media(prefers-color-scheme:dark){body{background:#14171a;color:#e6e6e6}.plot{filter:invert(.9) hue-rotate(180deg)}}"""


def _figure(title: str, x: str, y: str):
    import plotly.graph_objects as go

    layout = dict(template="plotly_white", height=380, margin=dict(l=70, r=20, t=50, b=60))
    figure = go.Figure(layout=layout)
    return figure.update_layout(title=title, xaxis_title=x, yaxis_title=y)


def bars_with_intervals(title: str, unit: str, names: list[str], series: dict):
    """Groups of bars; series: name -> (values, half widths or None)."""
    figure = _figure(title, "", f"[{unit}]")
    for name, (values, widths) in series.items():
        shown = None if widths is None else dict(type="data", array=np.where(np.isfinite(widths), widths, 0.0).tolist())
        figure.add_bar(name=name, x=names, y=np.asarray(values).tolist(), error_y=shown)
    return figure


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


def heat(title: str, names: list[str], table: np.ndarray):
    """A square table of numbers between -1 and 1."""
    figure = _figure(title, "", "")
    text = np.round(table, 2).astype(str).tolist()
    figure.add_heatmap(x=names, y=names, z=table.tolist(), zmin=-1, zmax=1, colorscale="RdBu", text=text,
                       texttemplate="%{text}")  # fmt: skip
    return figure.update_layout(yaxis_autorange="reversed", height=480)


def compliance_figures(found: Fit) -> list:
    """Compliances with their intervals, residuals of each test and against the normal distribution, correlation."""
    from scipy.stats import norm

    joints = [f"joint {j}" for j in range(1, 7)]
    file, values, widths = (1e6 * v[:6] for v in (found.problem.arm.joint_compliance, found.values, found.half_widths))
    series = {"identified, 95 %": (values, widths), "arm file": (file, None)}
    left = 1e6 * found.residuals[:, :3]
    tests = np.arange(1, len(left) + 1)
    scaled = np.sort((found.residuals / found.problem.measured.sigma)[found.problem.finite])
    normal = norm.ppf((np.arange(scaled.size) + 0.5) / scaled.size)
    modelled = 1e6 * (found.problem.measured.displacement - found.residuals)[:, :3]
    seen = 1e6 * found.problem.measured.displacement[:, :3]
    axes = list(enumerate("xyz"))
    return [
        bars_with_intervals("Joint compliances", "urad/(N m)", joints, series),
        points("Measured against modelled displacement", "modelled [um]", "measured [um]",
               {a: (modelled[:, i], seen[:, i]) for i, a in axes}),
        points("Residuals of each load test", "test", "measured less modelled [um]",
               {a: (tests, left[:, i]) for i, a in axes}),
        points("Residuals against the normal distribution", "normal quantile", "residual [standard deviations]",
               {"residuals": (normal, scaled), "normal": (normal, normal)}, ("normal",)),
        heat("Correlation of what was fitted", found.problem.names, found.correlation),
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
