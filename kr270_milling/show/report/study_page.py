"""Pages of studies, identifications and several tools: sentences, tables and Plotly figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from html import escape
from pathlib import Path

import numpy as np

from kr270_milling.base.column import TextTable, columns, fixed, table_of
from kr270_milling.base.extensions import require_extra
from kr270_milling.base.files import write_files
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import path_of
from kr270_milling.cell.paths import CellPath
from kr270_milling.decide.arcs import arcs_along
from kr270_milling.decide.compensation import DecisionOnTools
from kr270_milling.decide.stability import modes_of
from kr270_milling.physics.robot import Arm
from kr270_milling.show.report import page
from kr270_milling.show.report.tables import TONES, cut_text, micro, typographic
from kr270_milling.studies.maps.lobes import engagement_text
from kr270_milling.studies.maps.placements import MAPPED, PlacementRow, Summary
from kr270_milling.studies.maps.sweep import SweepSummary

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


RPM = 30.0 / math.pi


def write_lobes(
    folder, cell: Cell, name: str, rows: Sequence[dict], summary: str, *, arm: bool, self_contained: bool = False
) -> Path:
    """Write ``lobes.html``; returns its path.

    name: of the cell file; rows: of ``Lobe`` as in JSON; summary: a sentence; arm: whether its modes are part of the
    limit; self_contained: as of ``write_page``.
    """
    speeds, limit, chatter = (
        [row[key] for row in rows] for key in ("spindle_speed_rpm", "depth_limit_mm", "chatter_hz")
    )
    ends = min(*speeds, cell.tool.spindle_speed * RPM), max(*speeds, cell.tool.spindle_speed * RPM)
    speed, depth = cell.tool.spindle_speed * RPM, 1e3 * _deepest(cell)
    own = f"the cell's cut: {depth:.3g} mm at {speed:.0f} rpm"
    lines = {"limit depth": (speeds, limit), own: ([speed], [depth])}
    style = {own: (COLOURS[1], "diamond")}
    across = "spindle speed [rpm]"
    figures = [points("Below the line the cut is stable", across, "depth of cut [mm]", lines, ("limit depth",), style)]
    figures[0].update_yaxes(rangemode="tozero")
    modes = _modes(cell, arm)
    if any(map(math.isfinite, chatter)):  # where nothing chatters there is no frequency to show
        ends_of = {owner: np.repeat([hertz for hertz, _ in of], 3) for owner, of in modes.items()}
        series = {f"modes of the {owner}": (np.resize([*ends, np.nan], of.size), of) for owner, of in ends_of.items()}
        names = "chatter", "modes of the tool", "modes of the arm"
        style = {name: (COLOURS[k], "circle") for k, name in enumerate(names)}
        both = series | {"chatter": (speeds, chatter)}
        figures.append(points("Chatter at the limit", across, "frequency [Hz]", both, tuple(series), style))
        shown = [*filter(math.isfinite, chatter), *(mode[0] for rows in modes.values() for mode in rows)]
        if max(shown) > 20.0 * min(shown):  # ratio of two frequencies beyond which their axis is logarithmic
            figures[1].update_yaxes(type="log", dtick="D2")
    for figure in figures:  # one above the other
        figure.update_xaxes(range=ends)
    listed = [(owner, fixed(hertz), fixed(ratio, 4)) for owner, of in modes.items() for hertz, ratio in of]
    table = TextTable("Modes", ("of", "frequency [Hz]", "damping ratio"), listed)
    sentences = [
        f"{name}: {cell.arm.name} mills {cut_text(path_of(cell))}",
        f"engagement of the lobes: {engagement_text(cell.path)}",
        summary,
    ]
    title = f"Stability lobes of {name}"
    return write_page(Path(folder) / "lobes.html", title, sentences, [table], figures, self_contained=self_contained)


def _modes(cell: Cell, arm: bool) -> dict[str, list[tuple[float, float]]]:
    """Frequency [Hz] and damping ratio of each mode of the limit, by "arm" and "tool"; without modes no entry."""
    modes, tools = modes_of(cell, arm), cell.tool.modes.frequency.size
    rows = list(zip((modes.frequency / (2.0 * math.pi)).tolist(), modes.damping_ratio.tolist(), strict=True))
    return {owner: of for owner, of in (("tool", rows[:tools]), ("arm", rows[tools:])) if of}


def _deepest(cell: Cell) -> float:
    """Return the depth of cut [m], for a program the largest."""
    if path_of(cell).straight:
        return cell.path.depth_of_cut
    return float(arcs_along(path_of(cell), cell.earlier).depth.max(initial=0.0))


def gain_text(summary: Summary, present: dict) -> str:
    """State the error of the present placement and of the best placement in a sentence."""
    if not summary.best:
        return "no placement is feasible"
    best = summary.best[0]
    there = f"the best placement, {_place(best)}, has {best['error_max_um']:.1f} um"
    if not present["feasible"]:
        return f"where the part is, {_place(present)}, the path is out of reach or beyond the limits; {there}"
    now = f"where the part is, {_place(present)}, the error is {present['error_max_um']:.1f} um before compensation"
    gain = _gain(best, present)
    return f"{now}; {there}, {abs(gain):.0f} % {'less' if gain >= 0.0 else 'more'}"


def _place(row: dict) -> str:
    keys = {"part": "turn_deg", "tool": "tool_turn_deg"}
    turns = "".join(f", {name} turned by {row[key]:.4g} deg" for name, key in keys.items() if row[key])
    return f"x {row['x_mm']:.0f}, y {row['y_mm']:.0f}, z {row['z_mm']:.0f} mm{turns}"


def _gain(row: dict, present: dict) -> float:
    """Return the gain [%] of the error before compensation."""
    return 100.0 * (1.0 - row["error_max_um"] / present["error_max_um"])


def write_map(
    folder, arm: Arm, path: CellPath, name: str, summary: Summary, present: dict, *, self_contained: bool = False
) -> Path:
    """Write heat maps over x and y with the best placements and the present one; returns the path of the page.

    name: of the cell file; present: row of `present_row`; self_contained: as of ``write_page``.
    """
    table_note = (
        "x, y, z: origin of the workpiece on base_link. Error: the largest static one across the feed on the path. "
        "After compensation: one standard deviation of what the uncertainty of the cell leaves. Gain: against the "
        "present place."
    )
    note = (
        "each field shows the z, the turns and the branch with the least error there; in an empty field the path is "
        "out of reach or beyond the joint limits"
    )
    star = dict(symbol="star", size=14, color=COLOURS[1], line=dict(color="white", width=1))
    diamond = dict(symbol="diamond", size=12, color="white", line=dict(color="black", width=2))
    marks = {"best placements": (summary.best, star), "the part now": ([present], diamond)}
    figures = []
    for title, values in zip(MAPPED.values(), summary.maps.values(), strict=True):
        figure = figure_of(title, "x [mm]", "y [mm]")
        figure.add_heatmap(x=summary.x, y=summary.y, z=values, colorscale="Cividis")
        for mark, (rows, marker) in marks.items():
            across, up = ([row[key] for row in rows] for key in ("x_mm", "y_mm"))
            figure.add_scatter(x=across, y=up, mode="markers", name=mark, marker=marker)
        figures.append(figure)
    rows = [{"place": "now"} | present, *({"place": f"best\u00a0{n}"} | row for n, row in enumerate(summary.best, 1))]
    known = present["feasible"]
    for row in rows:
        row["gain"] = _gain(row, present) if known and row["feasible"] else float("nan")
    shown = [(column.heading(short=not column.title), column.key, column.text) for column in columns(PlacementRow)]
    table = table_of(
        "Placements", [("", "place", str), *shown, ("gain [%]", "gain", lambda v: fixed(v, 1))], rows, table_note
    )
    sentences = [f"{name}: {arm.name} mills {cut_text(path)}", gain_text(summary, present), note]
    title = f"Where to clamp {path.path.file_name or 'the part'}"
    return write_page(Path(folder) / "map.html", title, sentences, [table], figures, self_contained=self_contained)


SHOWN = {"static_deviation_um": "static [um]", "max_deviation_um": "max [um]", "max_power_w": "power [W]"}


def sweep_tables(summary: SweepSummary) -> list[TextTable]:
    """The rows with the least and with the largest deviation."""
    head = ["row", *summary.keys, *SHOWN.values()]
    both = (("Least deviation", summary.best), ("Largest deviation", summary.worst))
    return [
        TextTable(
            title,
            head,
            [
                [str(row["index"]), *(_text(row[key]) for key in summary.keys), *(fixed(row[key]) for key in SHOWN)]
                for row in rows
            ],
        )
        for title, rows in both
        if rows
    ]


def write_sweep(folder, summary: SweepSummary, sentences: list[str], self_contained: bool = False) -> Path:
    """Write the largest deviation of the rows over each varied key, and the tables; returns the path.

    The page of the folder ``sweep`` is ``sweep.html`` beside it: Arrow reads every file of the folder as rows.
    """
    up = [row["max_deviation_um"] for row in summary.shown]
    figures = [
        points("Largest deviation", key, "largest deviation [um]", {"rows": ([row[key] for row in summary.shown], up)})
        for key in summary.keys
    ]
    place = Path(folder).resolve()
    page = place.with_name(f"{place.name}.html")
    title = "Sweep of " + ", ".join(summary.keys)
    return write_page(page, title, sentences, sweep_tables(summary), figures, self_contained=self_contained)


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


PLOTLY = "/* plotly.js, from the page of all tools */"  #: in the page of a tool, which the page around it fills in


def tools_page(title: str, decision: DecisionOnTools, names: Sequence[str], pages: Sequence[str]) -> str:
    """Return a page for all tools; pages: the report of each tool as text, without plotly."""
    tools = dict(decision.tools)
    rows = [(name, tools[name].level, TONES[tools[name].level], micro(tools[name].sentence)) for name in names]
    return page.page_text(
        "tools",
        ("tools",),
        title=title,
        level=decision.level,
        tone=TONES[decision.level],
        sentence=micro(decision.sentence),
        rows=rows,
        first=decision.worst[0],
        data=page.to_json(
            {
                "mark": PLOTLY,
                "pages": dict(
                    zip(names, (text.replace(page.plotly_script(), PLOTLY, 1) for text in pages), strict=True)
                ),
            }
        ),
    )
