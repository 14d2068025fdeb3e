"""A measured wall against the predicted wall as sentences, JSON, table and figure."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.column import TextTable
from kr270_milling.show.report.identification.outcome import Outcome
from kr270_milling.show.report.study_page import points
from kr270_milling.studies.identification.wall import WallComparison

__all__ = ["wall_outcome"]

COLUMNS = ("x, y [mm]", "measured [um]", "predicted [um]", "5 to 95 % of the plants [um]", "inside")


def wall_outcome(compared: WallComparison, name: str, cell: str) -> Outcome:
    """Return the result of ``compare`` with a table of places; name, cell: names of the files."""
    measured, line = compared.measured, compared.line
    columns = zip(
        1e3 * measured.place,
        *(1e6 * column for column in (measured.error, compared.predicted, compared.low, compared.high)),
        compared.inside,
        strict=True,
    )
    places = [
        {
            "x_mm": place[0],
            "y_mm": place[1],
            "measured_um": error,
            "predicted_um": predicted,
            "low_um": low,
            "high_um": high,
            "inside": bool(inside),
        }
        for place, error, predicted, low, high, inside in columns
    ]
    sentences = wall_advice(compared)
    result = {
        "places": places,
        "plants": compared.plants,
        "inside": int(compared.inside.sum()),
        "gain": line.gain,
        "gain_ci95": 1.96 * line.gain_sigma,
        "offset_um": 1e6 * line.offset,
        "residual_rms_um": 1e6 * line.residual,
        "advice": sentences,
    }
    rows = [
        [
            f"{p['x_mm']:.2f}, {p['y_mm']:.2f}",
            f"{p['measured_um']:.1f}",
            f"{p['predicted_um']:.1f}",
            f"{p['low_um']:.1f} to {p['high_um']:.1f}",
            "yes" if p["inside"] else "no",
        ]
        for p in places[:60]  # rows of the table
    ]
    title = f"Measured against predicted wall: {name} and {cell}"
    table = TextTable("Error of the wall, positive: material is left standing", COLUMNS, rows)
    return Outcome("compare_wall", title, result, [table], sentences, lambda: _figures(compared))


def wall_advice(compared: WallComparison) -> list[str]:
    """Return what the differences mean, and what to identify again."""
    line, count = compared.line, len(compared.predicted)
    inside = int(compared.inside.sum())
    sentences = [
        f"{inside} of {count} places are inside the band of {compared.plants} plants (90 % are expected)",
        f"measured = {line.gain:.2f} +- {1.96 * line.gain_sigma:.2f} times predicted, plus {1e6 * line.offset:.1f} um",
    ]
    # gains within this share of 1 need no new identification, as for a recording
    if abs(line.gain - 1.0) > max(0.1, 2.0 * line.gain_sigma):
        sentences.append("the factor is not 1: `identify forces` and `identify compliance`")
    if abs(line.offset) > max(2.0 * line.residual, 5e-6):
        sentences.append("an offset is no deflection: compare the radius of the tool and the zero of the workpiece")
    if inside < 0.9 * count and len(sentences) == 2:  # share of the places inside a band of 5 to 95 %
        sentences.append("factor and offset are right, but the places scatter more than the band: widen `uncertainty`")
    return sentences


def _figures(compared: WallComparison) -> list:
    """Measured and predicted error of each place."""
    measured, number = compared.measured, np.arange(1, len(compared.predicted) + 1)
    rows = {"measured": measured.error, "predicted": compared.predicted, "5 %": compared.low, "95 %": compared.high}
    series = {name: (number, 1e6 * row) for name, row in rows.items()}
    return [points("Error of the wall", "place", "[um]", series, ("predicted", "5 %", "95 %"))]
