"""The first screen of the page: what was asked, the decision as tiles, the findings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.decision.compensation import NO_METHOD
from kr270_milling.decision.findings import SEVERITIES, Finding
from kr270_milling.decision.part import PartAssessment
from kr270_milling.report.decision_block import Answer, DecisionBlock
from kr270_milling.report.payload import fixed

__all__ = ["Tile", "asked", "finding_rows", "tiles"]


@dataclass(frozen=True)
class Tile:
    """tone: "good", "bad" or "plain"; the word says the same, so that the colour is not needed."""

    label: str
    word: str
    sentence: str
    tone: str = "plain"


def asked(cell: Cell, passes: Sequence[ScoredPass]) -> str:
    """The question, in one sentence."""
    if cell.timed_path is not None:
        way, duration = cell.timed_path.toolpath.length, cell.target().duration_ns * 1e-9
        cut = f"{Path(cell.path.file).name} ({way:.3g} m of path in {duration:.3g} s)"
    else:
        cut = f"a straight cut of {cell.path.length * 1e3:g} mm, {cell.path.depth_of_cut * 1e3:.4g} mm deep,"
    speed = cell.tool.spindle_speed * 30 / np.pi
    how = f"a {cell.tool.diameter * 1e3:g} mm cutter with {cell.tool.teeth} teeth at {speed:.0f} rpm"
    then = "" if len(passes) == 1 else ", and what does compensation change"
    return f"How far off does {cell.arm.name} mill {cut} with {how}{then}?"


def tiles(decision: DecisionBlock, passes: Sequence[ScoredPass], parts: Sequence[PartAssessment]) -> list[Tile]:
    """The decision; what nobody decided is said to be open."""
    before, after, name = _largest(passes, parts)
    size = f"{fixed(before * 1e6, 2)} µm"
    found = [_judged("as programmed", decision.as_programmed, size, "largest deviation")]
    if len(passes) > 1:
        change = f", {100 * (1 - after / before):.1f} % less" if after < before else ", no better"
        size = f"{fixed(after * 1e6, 2)} µm"
        found.append(_judged("compensated", decision.compensated, size, f"largest deviation of '{name}'{change}"))
    if decision.may_be_run is not None:
        stops = sum(f.severity == "stop" for f in decision.findings)
        reason = "no finding forbids it" if decision.may_be_run else f"{stops} finding{'s' * (stops != 1)} forbid it"
        tone = "good" if decision.may_be_run else "bad"
        found.append(Tile("may be run", "yes" if decision.may_be_run else "no", reason, tone))
    if decision.recommended_method:
        why = "run the path as it was programmed" if decision.recommended_method == NO_METHOD else ""
        found.append(Tile("recommended method", decision.recommended_method, why))
    if decision.verdict:
        word, _, band = decision.verdict.partition(" (")
        found.append(Tile("verdict", word, band.rstrip(")").replace(" um", " µm")))
    if decision.stability:
        found.append(Tile("stability", "", decision.stability))
    return found


def _largest(passes: Sequence[ScoredPass], parts: Sequence[PartAssessment]) -> tuple[float, float, str]:
    """Before and after [m], and the name of the best compensated pass."""
    sizes = [part.whole.max_normal for part in parts] or [p.scores.max_deviation for p in passes]
    if len(passes) == 1:
        return sizes[0], sizes[0], passes[0].name
    best = min(range(1, len(passes)), key=lambda k: sizes[k])
    return sizes[0], sizes[best], passes[best].name


def _judged(label: str, judged: Answer | None, amount: str, said: str) -> Tile:
    """amount: the largest deviation, said: what it is, for a path that nobody judged."""
    if judged is None or judged.passes is None:
        return Tile(label, amount, f"{said}; no tolerance is given")
    word, tone = ("passes", "good") if judged.passes else ("fails", "bad")
    return Tile(label, word, judged.sentence or f"{said}: {amount}", tone)


def finding_rows(decision: DecisionBlock) -> list[dict]:
    """The worst first; where: the place in words."""
    return [_finding(one) for one in sorted(decision.findings, key=lambda f: SEVERITIES.index(f.severity))]


def _finding(one: Finding) -> dict:
    place = one.where
    words = [place.feature, f"line {place.line}" if place.line else None, f"XP{place.point}" if place.point else None]
    where = ", ".join(filter(None, words))
    return {**vars(one), "sentence": re.sub(r"\bum\b", "µm", one.sentence), "where": where, "point": place.point}
