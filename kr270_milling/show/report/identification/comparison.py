"""Measured against predicted passes and walls as sentences, JSON, tables and figures."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.column import TextTable, fixed
from kr270_milling.show.report.identification import Outcome
from kr270_milling.show.report.study_page import points
from kr270_milling.studies.identification.comparison import ComparedChannel, LinearFit
from kr270_milling.studies.identification.wall import WallComparison

SURE = 2.0  #: standard deviations
COLUMNS = ("quantity", "measured / simulated", "95 % +-", "offset", "difference RMS")
UNITS = {"m": (1e6, "um", "um"), "N": (1.0, "n", "N")}  #: unit of a channel -> factor, suffix of keys, unit in tables


def comparison_outcome(
    channels: list[ComparedChannel], lags: dict, ringing: dict, recording: str, cell: str
) -> Outcome:
    """Return the result of ``compare``; recording, cell: names of the files."""
    sentences = advice(channels, ringing)
    clocks = [
        f"the clock of the {name} is {1e3 * lag:.2f} ms behind that of the simulation"
        if abs(lag) < 86400.0  # [s]
        else f"the clock of the {name} does not begin with the pass"
        for name, lag in lags.items()
    ]
    result = {
        "channels": [_as_dict(channel) for channel in channels],
        "lag_s": lags,
        "ringing": {name: {"frequency_hz": f, "damping_ratio": z} for name, (f, z) in ringing.items()},
        "advice": sentences,
    }
    title = f"Measured against simulated: {recording} and {cell}"
    table = TextTable("Measured against simulated", COLUMNS, [_row(channel) for channel in channels])
    return Outcome("compare", title, result, [table], [*clocks, *sentences], lambda: _figures(channels))


def advice(channels: list[ComparedChannel], ringing: dict[str, tuple[float, float]]) -> list[str]:
    """Return what to identify again."""
    sentences = []
    largest = max((float(np.abs(c.simulated).mean()) for c in channels if c.unit == "N"), default=0.0)
    forces = [c for c in channels if c.unit == "N" and np.abs(c.simulated).mean() > 0.2 * largest]  # others are noise
    sentences += [
        f"{c.name} is {c.line.gain:.2f} +- {SURE * c.line.gain_sigma:.2f} times the simulated one: `identify forces`"
        for c in forces
        if _differs(c.line, 1.0)
    ]
    deviation = next((c for c in channels if c.name == "deviation"), None)
    if deviation is not None:
        weights = [float(np.abs(c.simulated).mean()) for c in forces]
        expected = float(np.average([c.line.gain for c in forces], weights=weights)) if forces else 1.0
        if expected > 0.0 and _differs(deviation.line, expected):
            ratio = deviation.line.gain / expected
            cause = "`identify compliance`" if forces else "`identify compliance`, or forces, which were not measured"
            sentences.append(f"the deviation is {ratio:.2f} times what the measured forces explain: {cause}")
    if all(np.isfinite(values).all() for values in ringing.values()) and ringing:
        (ours, damping), (theirs, measured) = ringing["simulated"], ringing["measured"]
        # relative differences of frequency and damping
        if abs(theirs / ours - 1.0) > 0.05 or abs(measured / damping - 1.0) > 0.5:
            sentences.append(
                f"the tool rings at {theirs:.2f} Hz with a damping ratio of {measured:.3f}, "
                f"simulated {ours:.2f} Hz and {damping:.3f}: `identify damping`"
            )
    return sentences or ["measurement and simulation agree: nothing to identify again"]


def _differs(line: LinearFit, expected: float) -> bool:
    away = abs(line.gain - expected)
    # batches of a material scatter by 10 %
    return away > 0.1 * max(expected, 0.1) and away > SURE * line.gain_sigma


def _rms(channel: ComparedChannel) -> float:
    return float(((channel.measured - channel.simulated) ** 2).mean() ** 0.5)


def _as_dict(channel: ComparedChannel) -> dict:
    factor, suffix, _ = UNITS[channel.unit]
    return {
        "name": channel.name,
        "gain": channel.line.gain,
        "gain_ci95": 1.96 * channel.line.gain_sigma,
        f"offset_{suffix}": factor * channel.line.offset,
        f"residual_rms_{suffix}": factor * _rms(channel),
        f"residual_rms_smoothed_{suffix}": factor * channel.line.residual,
    }


def _row(channel: ComparedChannel) -> list[str]:
    factor, _, unit = UNITS[channel.unit]
    line, offset = channel.line, factor * channel.line.offset
    numbers = [f"{line.gain:.3f}", f"{1.96 * line.gain_sigma:.3f}"]
    return [channel.name, *numbers, f"{fixed(offset)} {unit}", f"{factor * _rms(channel):.2f} {unit}"]


def _figures(channels: list[ComparedChannel]) -> list:
    figures = []
    for channel in channels:
        thin = slice(None, None, max(1, len(channel.time) // 5000))
        factor, _, unit = UNITS[channel.unit]
        both = {"measured": channel.measured, "simulated": channel.simulated}
        series = {name: (channel.time[thin], factor * values[thin]) for name, values in both.items()}
        figures.append(points(channel.name, "time [s]", f"{channel.name} [{unit}]", series, tuple(series)))
    return figures


def wall_outcome(compared: WallComparison, name: str, cell: str) -> Outcome:
    """Return the result of ``compare`` with a table of places; name, cell: names of the files."""
    heading = ("x, y [mm]", "measured [um]", "predicted [um]", "5 to 95 % of the plants [um]", "inside")
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
    table = TextTable("Error of the wall, positive: material is left standing", heading, rows)
    return Outcome("compare_wall", title, result, [table], sentences, lambda: _wall_figures(compared))


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


def _wall_figures(compared: WallComparison) -> list:
    """Measured and predicted error of each place."""
    measured, number = compared.measured, np.arange(1, len(compared.predicted) + 1)
    rows = {"measured": measured.error, "predicted": compared.predicted, "5 %": compared.low, "95 %": compared.high}
    series = {name: (number, 1e6 * row) for name, row in rows.items()}
    return [points("Error of the wall", "place", "[um]", series, ("predicted", "5 %", "95 %"))]
