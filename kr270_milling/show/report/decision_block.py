"""The first screen of a report: what was asked, the decision in words and numbers as tiles, the findings.

The report judges nothing itself: it shows the ``Decision``, the ``Checked`` path and the ``Judgement`` of each pass.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from kr270_milling.cell.paths import CellPath
from kr270_milling.decide.check import RAPID_MOVES, Checked
from kr270_milling.decide.decision import CAUTION, NO, YES, Decision
from kr270_milling.decide.findings import SEVERITIES
from kr270_milling.decide.tolerance import Judgement, um_text
from kr270_milling.show.report.tables import micro, typeset

TONES = {YES: "good", CAUTION: "caution", NO: "bad"}  #: colour of the tile


def cut_text(path: CellPath) -> str:
    """Path and tool of a cell."""
    tool, speed = path.tool, path.tool.spindle_speed * 30 / np.pi
    cutter = f"a {tool.diameter * 1e3:g} mm cutter with {tool.teeth} teeth at {speed:.0f} rpm"
    return f"{path.description} with {cutter}"


class Tile(NamedTuple):
    """tone: "good", "caution", "bad" or "plain"; the word says the same, so that the colour is not needed.

    With "edge" after it only the edge has the colour.
    """

    label: str
    word: str
    sentence: str
    tone: str = "plain"


def tiles(
    names: Sequence[str],
    judgements: Sequence[Judgement],
    decision: Decision | None,
    checked: Checked | None,
    method: str,
    tool: str = "",
) -> list[Tile]:
    """Return the decision as tiles; None or empty: not shown.

    judgements: of the passes; method: its line; tool: name of the tool in a program with several tools.
    """
    first, rows = judgements[0], []
    if decision:
        rows.append(
            Tile(
                f"decision on {tool}" if tool else "decision",
                decision.level,
                micro(decision.sentence),
                TONES[decision.level],
            )
        )
    rows.append(_tile("as programmed", first, first.quantity))
    if len(names) > 1:
        best = min(range(1, len(names)), key=lambda k: judgements[k].error)
        after = judgements[best]
        less = f"{100 * (1 - after.error / first.error):.1f} % less" if after.error < first.error else "no better"
        rows.append(_tile("compensated", after, f"{first.quantity} of '{names[best]}', {less}"))
    notes = decision.notes if decision else ()
    if method or notes:
        label, _, text = (method or "note: ").partition(": ")
        word, _, why = text.partition(", ")
        rows.append(Tile(label, word, micro("; ".join(filter(None, [why, *notes])))))
    if decision and decision.verdict:
        word, _, band = decision.verdict.text.partition(" (")
        rows.append(Tile("verdict", word, micro(band.rstrip(")")), f"{TONES[decision.level]} edge"))
    if checked and checked.rapid_text:
        rows.append(Tile(RAPID_MOVES, "", micro(checked.rapid_text.removeprefix(f"{RAPID_MOVES}: "))))
    if checked and checked.stability:
        rows.append(Tile("stability", "", typeset(checked.stability.text.removeprefix("stability: "))))
    return rows


def limit_bars(decision: Decision | None) -> list[tuple[str, int, str]]:
    """Return name, share in percent and measurement of the unknowns that limit the part, the largest first."""
    rows = [(row.name, round(100 * row.share), row.measurement) for row in (decision.limits if decision else ())]
    return [row for row in rows if row[1] > 0]


def _tile(label: str, judged: Judgement, quantity: str) -> Tile:
    """Return the tile of one version of the path; quantity: the words of the error that decides."""
    if math.isnan(judged.error):
        return Tile(label, *judged.words.split(": "))
    if judged.passes is None:
        return Tile(label, micro(um_text(judged.error)), f"{quantity}; no tolerance is given")
    word, tone = ("passes", "good") if judged.passes else ("fails", "bad")
    where = f" at {judged.feature}" if judged.feature else ""
    sizes = f"{um_text(judged.error)}{where}, {um_text(judged.tolerance)} allowed"
    return Tile(label, word, micro(f"{judged.quantity} {sizes}"), tone)


def finding_rows(checked: Checked | None) -> list[dict]:
    """Return the findings as rows, the worst first; where: the place in words."""
    rows = []
    for finding in sorted(checked.findings if checked else (), key=lambda f: SEVERITIES.index(f.severity)):
        point, line = finding.where.point, finding.where.line
        named = finding.where.called or (f"line {line}" if line else None)
        words = [finding.where.feature, named, f"XP{point}" if point else None]
        where = ", ".join(filter(None, words))
        rows.append({**vars(finding), "sentence": micro(finding.sentence), "where": where, "point": point})
    return rows
