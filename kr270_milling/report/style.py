"""One look for every figure, and figures as small, repeatable SVG texts."""

from __future__ import annotations

import functools
import io
import re

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

__all__ = ["COLOURS", "GREY", "SHADE", "colour", "envelope", "line", "marked", "new_figure", "plain", "styled",
           "svg_text"]  # fmt: skip

#: [Okabe2008], told apart by every kind of colour vision; the first is for the original pass
COLOURS = ("#222222", "#D55E00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9")
GREY, SHADE = "#777777", "#DDEBF5"
WIDTH = 7.2  # [in]: at 700 px a 9 pt letter is 12 px high
BUCKETS = 500  # columns of the min/max envelope of a long series

STYLE = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans", "Helvetica", "Arial", "sans-serif"],
    "mathtext.fontset": "dejavusans",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "lines.linewidth": 1.0,
    "lines.solid_joinstyle": "round",
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.5,
    "svg.fonttype": "none",
    "svg.hashsalt": "kr270_milling",
}


@functools.cache
def _defaults() -> dict:
    """matplotlib's own settings, but for the backend: to ask for that would load pyplot."""
    kept = ("backend", "interactive", "toolbar", "webagg", "timezone")
    return {k: v for k, v in dict.items(matplotlib.rcParamsDefault) if not k.startswith(kept)}


def styled(draw):
    """Decorator: the function draws under STYLE, whatever the caller has set."""

    @functools.wraps(draw)
    def wrapper(*args, **kwargs):
        with matplotlib.rc_context():
            matplotlib.rcParams.update({**_defaults(), **STYLE})
            return draw(*args, **kwargs)

    return wrapper


def new_figure(height: float, rows: int = 1, columns: int = 1, **options) -> tuple[Figure, np.ndarray]:
    """A figure of the report's width and a height [in], and its axes (rows, columns)."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def envelope(x: np.ndarray, y: np.ndarray, buckets: int = BUCKETS) -> tuple[np.ndarray, np.ndarray]:
    """A long series thinned so that a plot of it looks the same: smallest and largest y of each bucket, in their order.

    x, y: (n,). At most 2 * buckets + 2 points; the ends and every extremum stay. NaN count as no value.
    """
    x, y = np.asarray(x), np.asarray(y)
    if y.size <= 2 * buckets + 2:
        return x, y
    edges = np.linspace(0, y.size, buckets + 1).astype(int)
    starts = edges[:-1]
    bucket = np.repeat(np.arange(buckets), np.diff(edges))
    keep = [np.array([0, y.size - 1])]
    for reduce, filler in ((np.minimum, np.inf), (np.maximum, -np.inf)):
        filled = np.where(np.isnan(y), filler, y)
        best = reduce.reduceat(filled, starts)
        first = np.flatnonzero(filled == best[bucket])
        keep.append(first[np.unique(bucket[first], return_index=True)[1]])
    index = np.unique(np.concatenate(keep))
    return x[index], y[index]


def colour(number: int) -> str:
    """Of the pass with this number; 0 is the original one."""
    return COLOURS[number % len(COLOURS)]


def plain(name: str) -> str:
    """A name from outside as matplotlib shows it letter by letter: no formulas, no hidden legend entries."""
    return name.replace("$", r"\$").lstrip("_") or "-"


def line(axes: Axes, x: np.ndarray, y: np.ndarray, colour: str, label: str | None = None, buckets: int = BUCKETS,
         **options) -> None:  # fmt: skip
    """Draw a series of any length."""
    axes.plot(*envelope(x, y, buckets), color=colour, label=label, **options)


def marked(axes: Axes, engaged_from: float, end: float) -> None:
    """Shade the fully engaged, scored part of a time axis [s]."""
    if engaged_from < end:
        axes.axvspan(engaged_from, end, color=SHADE, linewidth=0, zorder=0)


@styled
def svg_text(figure: Figure) -> str:
    """The figure as one ``<svg>`` element, without date, creator and doctype: the same figure, the same text."""
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = stream.getvalue()
    return re.sub(r"<metadata>.*?</metadata>\s*", "", text[text.index("<svg") :], flags=re.S)
