"""Records of a chart: curves on panels, with what is marked on them. The page draws them; here are only numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.report.stations import envelope_index

__all__ = ["Chart", "Curve", "Panel", "curve"]


@dataclass(frozen=True, eq=False)
class Curve:
    """colour: number of the series, 0 is the original pass; look: "", "dash", "dot", "points" or "area"."""

    name: str
    x: np.ndarray
    y: np.ndarray
    colour: int = 0
    look: str = ""
    text: str = ""  #: stands at the last point
    legend: bool = True


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes."""

    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    title: str = ""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    log: bool = False
    equal: bool = False  #: one length for both axes
    shade: tuple[float, float] | None = None  #: stretch of x that is shaded
    uprights: tuple[tuple[float, str], ...] = ()  #: marked places of x
    levels: tuple[tuple[float, str], ...] = ()  #: marked heights


@dataclass(frozen=True, eq=False)
class Chart:
    """name: of its element on the page; of_paper: the figure of the paper that it corresponds to, or ""."""

    name: str
    title: str
    of_paper: str
    caption: str
    panels: tuple[Panel, ...]
    columns: int = 1  #: of panels, where the screen is wide


def curve(name: str, x, y, colour: int = 0, look: str = "", **more) -> Curve:
    """A series of any length, thinned with its extrema kept."""
    rows = envelope_index(y)
    return Curve(name, np.asarray(x)[rows], np.asarray(y)[rows], colour, look, **more)
