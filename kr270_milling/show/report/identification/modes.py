"""Identified modes, servo lag and backlash as sentences, JSON, table, figures and parameter file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kr270_milling.base.column import TextTable, as_dict, columns_of, table_of
from kr270_milling.show.report.identification import Outcome
from kr270_milling.show.report.study_page import points
from kr270_milling.studies.identification.doubts import Doubt
from kr270_milling.studies.identification.modes import Mode
from kr270_milling.studies.identification.play import ARCSEC, Backlash, backlash_keys
from kr270_milling.studies.identification.servo import Move, Servo, servo_keys
from kr270_milling.studies.identification.signals import Signals

USE = "name this file in `includes` of the cell: plan and simulated robots then have these numbers"


def servo_outcome(servo: Servo, move: Move, doubts: Sequence[Doubt], title: str, same_clock: bool) -> Outcome:
    """Return the result of ``identify servo``; same_clock: False leaves the dead time out."""
    rows = [
        ("frequency [Hz]", f"{servo.frequency:.4g}", f"{servo.frequency_half:.2g}"),
        ("damping ratio", f"{servo.damping:.3g}", f"{servo.damping_half:.2g}" if servo.damping_half else "assumed"),
    ]
    if same_clock:
        rows.append(("dead time [ms]", f"{1e3 * servo.delay:.3g}", f"{1e3 * servo.delay_half:.2g}"))
    left = f"the lag leaves {100 * servo.unexplained:.2g} % of the motion unexplained, scale {servo.gain:.4g}"
    sentences = [
        f"{len(move.measured)} samples every {1e3 * move.step:.3g} ms; {left}",
        *(doubt.text for doubt in doubts),
    ]
    refused = any(doubt.forbids for doubt in doubts)
    result = as_dict(servo) | {"doubts": [doubt.text for doubt in doubts], "usable": not refused}
    table = TextTable(title, ("servo lag", "value", "95 % +-"), tuple(rows))
    keys = servo_keys(servo, same_clock)
    return Outcome("servo", title, result, [table], sentences, lambda: _move_figures(servo, move), keys, USE, refused)


def _move_figures(servo: Servo, move: Move) -> list:
    """The move, and what the lag leaves of it."""
    time, thin = move.step * np.arange(len(move.measured)), slice(None, None, max(1, len(move.measured) // 4000))
    explained = servo.explained + move.measured.mean()
    drift = np.polynomial.Polynomial.fit(time, move.measured - explained, 1)(time)
    series = {"commanded": move.commanded, "measured": move.measured, "by the lag": explained + drift}
    rest = {"measured minus lag": move.measured - explained - drift}
    return [
        points(name, "time [s]", "as recorded", {k: (time[thin], v[thin]) for k, v in rows.items()}, tuple(rows))
        for name, rows in (("Test move", series), ("Rest", rest))
    ]


def backlash_outcome(identified: Backlash, title: str) -> Outcome:
    """Return the result of ``identify backlash``."""
    names = [f"joint {k}" for k in range(1, 7)]
    rows = [
        (
            name,
            f"{width / ARCSEC:.3g}",
            f"{100 * identified.half:.0f} %",
            "yes" if k in identified.joints else "by the multiple",
        )
        for k, (name, width) in enumerate(zip(names, identified.width, strict=True), 1)
    ]
    refused = any(doubt.forbids for doubt in identified.doubts)
    sentences = [
        f"{identified.multiple:.3g} times the backlash of the arm file; residual {1e6 * identified.residual:.3g} um",
        *(doubt.text for doubt in identified.doubts),
    ]
    if not identified.joints:
        sentences.append("the joints are not separated: one multiple for all; more postures separate them")
    result = as_dict(identified) | {"doubts": [doubt.text for doubt in identified.doubts], "usable": not refused}
    head = ("backlash", "arcsec", "95 % +-", "identified alone")
    table = TextTable(title, head, tuple(rows))
    return Outcome("backlash", title, result, [table], sentences, None, backlash_keys(identified), USE, refused)


def mode_outcome(
    modes: list[Mode],
    faint: list[Mode],
    signals: Signals,
    shapes: np.ndarray | None,
    title: str,
    doubts: Sequence[Doubt] = (),
) -> Outcome:
    """Return the result of ``identify damping``; shapes: mass-normalised shapes, (n, 6); None: not scaled.

    faint: modes that may be noise; they are listed and not used; doubts: about the signals and the units.
    """
    duration = len(signals.values) * signals.step
    axes = [signals.along_axes(mode.shape).tolist() for mode in modes]
    entries = [{**as_dict(m), "confirmed": m.confirmed, "shape": shape} for m, shape in zip(modes, axes, strict=True)]
    if shapes is not None:
        entries = [e | {"mass_normalised_shape": s} for e, s in zip(entries, shapes.tolist(), strict=True)]
    result = {
        "modes": entries,
        "faint": [
            {"frequency_hz": mode.frequency, "damping_ratio": mode.damping_ratio, "share_of_energy": mode.share}
            for mode in faint
        ],
        "duration_s": duration,
        "samples_per_s": 1 / signals.step,
        "channels": list(signals.names),
        "doubts": [doubt.text for doubt in doubts],
        "usable": not any(doubt.forbids for doubt in doubts),
    }
    sentences = [f"{duration:.3g} s at {1 / signals.step:.4g} samples a second", *(doubt.text for doubt in doubts)]
    if faint:
        listed = ", ".join(f"{mode.frequency:.4g} Hz ({100 * mode.share:.2g} %)" for mode in faint)
        sentences.append(f"left out, not above the noise (share of the energy): {listed}")
    if not all(mode.confirmed for mode in modes):
        sentences.append(
            "the decrement does not confirm each damping ratio: modes are near each other, or ring too briefly"
        )
    if shapes is None:
        sentences.append("the shapes are not scaled: use a hammer (--hammer) or the compliance of a cell (--cell)")
    shape = ("shape x y z rx ry rz", "shape", lambda values: " ".join(f"{v:.2f}" for v in values))
    shown = ("mode", "mode", 0), *columns_of(Mode), shape
    table = table_of(title, shown, [{"mode": i, **entry} for i, entry in enumerate(entries, 1)])
    use = "name this file in `includes`, or copy the keys that you need"
    sections = _sections(modes, shapes)
    refused = not result["usable"]
    return Outcome("modes", title, result, [table], sentences, lambda: _figures(signals), sections, use, refused)


def _sections(modes: list[Mode], shapes: np.ndarray | None) -> dict:
    """``dynamics.modes`` of a parameter file with mass-normalised shapes (n, 6); without shapes one damping ratio."""
    if shapes is None:
        mean = sum(mode.share * mode.damping_ratio for mode in modes)
        return {"dynamics": {"damping_ratio": (float(mean), "mean over the modes, by energy")}}
    rows = [
        {
            "frequency_hz": mode.frequency,
            "damping_ratio": (mode.damping_ratio, f"logarithmic decrement {mode.decrement:.3g}"),
            "shape": shape.tolist(),
        }
        for mode, shape in zip(modes, shapes, strict=True)
    ]
    return {"dynamics": {"follow_pose": ("false", "modes are of one posture"), "modes": rows}}


def _figures(signals: Signals) -> list:
    """The signal and its spectrum."""
    time = signals.step * np.arange(len(signals.values))
    data = signals.values - signals.values.mean(0)
    frequency = np.fft.rfftfreq(len(data), signals.step)
    spectrum = np.abs(np.fft.rfft(data, axis=0)) * 2 / len(data)
    thin = slice(None, None, max(1, len(time) // 4000))  # points of a signal in the figure
    low = frequency < min(200.0, frequency[-1])  # end of the spectrum in the figure
    by_channel = {name: (time[thin], data[thin, i]) for i, name in enumerate(signals.names)}
    spectra = {name: (frequency[low], spectrum[low, i]) for i, name in enumerate(signals.names)}
    return [
        points("Signal", "time [s]", "as recorded", by_channel, signals.names),
        points("Spectrum", "frequency [Hz]", "as recorded", spectra, signals.names),
    ]
