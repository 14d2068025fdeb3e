"""Identified servo lag and backlash as sentences, JSON, table, figure and parameter file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kr270_milling.base.column import TextTable, as_dict
from kr270_milling.show.report.identification import Outcome
from kr270_milling.show.report.study_page import points
from kr270_milling.studies.identification.doubts import Doubt
from kr270_milling.studies.identification.play import ARCSEC, Backlash, backlash_keys
from kr270_milling.studies.identification.servo import Move, Servo, servo_keys

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
    return Outcome("servo", title, result, [table], sentences, lambda: _figures(servo, move), keys, USE, refused)


def _figures(servo: Servo, move: Move) -> list:
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
