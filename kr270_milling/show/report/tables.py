"""The tables of the page as texts, with one minus sign and without directories of a machine; its assumptions.

The sentences of the assumptions are in ``page/assumptions.txt``: what the paper does not give or misprints, what was
taken instead, and why. Only what affects the run is listed; values are those of the cell.

The first screen shows what was asked, the decision in words and numbers as tiles, and the findings. The report judges
nothing itself: it shows the ``Decision``, the ``Checked`` path and the ``Judgement`` of each pass.
"""

from __future__ import annotations

import contextlib
import functools
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jinja2
import numpy as np

from kr270_milling.base.column import Column, TextTable, columns, fixed
from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, mean_force
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.cell.paths import CellPath
from kr270_milling.decide.check import RAPID_MOVES, Checked, exchange_share
from kr270_milling.decide.decision import CAUTION, NO, YES, Decision
from kr270_milling.decide.findings import SEVERITIES
from kr270_milling.decide.part import FeatureRow, PartAssessment
from kr270_milling.decide.part.assessment import Judgement, um_text
from kr270_milling.physics.motion.arm_model import modal_models
from kr270_milling.physics.motion.scores import Scores
from kr270_milling.physics.robot import Arm
from kr270_milling.physics.robot.mass import MODELS


def model_frequencies(cell: Cell) -> dict[str, np.ndarray]:
    """First natural frequencies [Hz] at the start of the path with each mass model that has an answer there."""
    start = arm_of(cell).joints(path_of(cell).target)[:1]
    frequencies = {}
    for name in MODELS:
        with contextlib.suppress(MillingError):
            dynamics = cell.dynamics.replace(mass_model=name)
            (model,) = modal_models(cell.arm, cell.mount, dynamics, cell.workpiece.pose, start)
            frequencies[name] = model.frequency / (2 * np.pi)
    return frequencies


@functools.cache
def _assumptions() -> jinja2.Template:
    text = (Path(__file__).parent / "page" / "assumptions.txt").read_text(encoding="utf-8")
    return jinja2.Template(text, undefined=jinja2.StrictUndefined)


def assumptions(cell: Cell, paper: bool) -> list[tuple[str, ...]]:
    """Return point, value and reason of each assumption of this cell.

    paper: also those about the paper's text and Table 2.
    """
    passing = cell.tool.spindle_speed / (2 * np.pi) * cell.tool.teeth
    rows: list[tuple[str, ...]] = list(cell.cutting.active.assumptions(path_of(cell).feed_rate / passing))
    modes = model_frequencies(cell).items()
    _assumptions().render(
        row=lambda *texts: rows.append(tuple(map(str, texts))),
        cell=cell,
        paper=paper,
        passing=passing,
        helix=np.degrees(cell.tool.helix),
        micro_step=np.degrees(cell.exchange.micro_step),
        modes="; ".join(f"{name}: {', '.join(f'{f:.2f}' for f in hz[:3])} Hz" for name, hz in modes),
        way=path_of(cell).length,
        engaged=path_of(cell).full_engagement,
    )
    return rows


UM = 1e6
#: source of the columns `paper`
PAPER = (
    "Klimchik, Bondarenko, Pashkevich, Briot, Furet: Compliance error compensation in robotic-based milling (2014), "
    "Table 2"
)
#: name of a pass -> its scores in Table 2; NaN: not in the table
TABLE_2 = {
    "original": Scores(58.1e-6, 63.2e-6, 6.70, np.nan, np.nan),
    "linear": Scores(0.14e-6, 4.70e-6, 6.70, np.nan, np.nan),
}


def fixed_text(value: float | None, digits: int, least: float = 0.0) -> str:
    """``fixed`` with a typographer's minus; a dash where there is no number."""
    return "–" if value is None or not np.isfinite(value) else fixed(value, digits, least).replace("-", "−")


def micro(text: str) -> str:
    """Return a text with the signs of typography: µm, µrad, mm³ and ±."""
    raised = {"2": "²", "3": "³"}
    text = re.sub(r"(?:(?<=\d )|(?<=/))(mm|m|s)([23])\b", lambda unit: unit[1] + raised[unit[2]], text)
    return re.sub(r"\bu(?=m\b|rad\b)", "µ", text).replace("+-", "±")


def shown(value, key: str = "") -> str:
    """Return a value of the configuration as text; a file by its name alone."""
    if isinstance(value, list):
        return "[" + ", ".join(map(shown, value)) + "]"
    if isinstance(value, str):
        return Path(value).name if key.endswith("file") else value
    return (f"{value:.10g}" if isinstance(value, float) else str(value)).replace("-", "−")


def typographic(table: TextTable) -> TextTable:
    """Return a table with the page's minus sign and micro sign, and no "-0.00"."""
    rows = tuple(tuple(map(typeset, row)) for row in table.rows)
    return TextTable(micro(table.title), tuple(map(micro, table.columns)), rows, micro(table.note))


def typeset(text: str) -> str:
    """Return a text with the page's minus sign and micro sign, and no "-0.00"."""
    if re.fullmatch(r"-0(\.0*)?", text):
        return text[1:]
    return micro(re.sub(r"(?<![\w-])-(?=\d)", "−", text))


def line_scores(passes: Sequence[ScoredPass], paper: bool) -> TextTable:
    """Accuracy before and after of a straight cut; with ``paper`` the numbers of Table 2 beside ours."""
    heads, rows = ["pass"], [[scored.name] for scored in passes]
    for column in _titled(Scores):
        heads.append(_heading(column))
        for scored, row in zip(passes, rows, strict=True):
            row.append(_text(column, getattr(scored.scores, column.name)))
        if paper and np.isfinite(getattr(TABLE_2["original"], column.name)):
            heads.append("paper")
            for scored, row in zip(passes, rows, strict=True):
                row.append(_text(column, getattr(TABLE_2.get(scored.name), column.name, np.nan)))
    note = (
        "Path deviation: actual tool centre minus target, perpendicular to the feed. Static: its mean over the last "
        "quarter of the pass. Largest: its largest magnitude while the tool is fully engaged. Low frequency: the "
        "lowest lateral mode of the model; ringing: undamped frequency and damping ratio of the pass."
    )
    title = "Before and after" + (" (Table 2)" if paper else "")
    return TextTable(title, tuple(heads), tuple(map(tuple, rows)), note)


def part_scores(parts: Sequence[PartAssessment]) -> TextTable:
    """Return the table of the whole part, one row a pass."""
    note = (
        "Deviation: actual tool centre minus target, horizontal and across the path, while the tool cuts. Wall and "
        "floor: what remains on the finished part, against the part that a rigid arm would leave."
    )
    rows = tuple((part.name, *_values(part.whole)) for part in parts)
    return TextTable("Before and after, whole part", ("pass", *map(_heading, _titled(FeatureRow))), rows, note)


def feature_table(parts: Sequence[PartAssessment]) -> TextTable:
    """Return the table of features, one row for each feature and pass."""
    known = [{row.name: row for row in (*part.rows, part.whole)} for part in parts]
    rows = tuple(
        (name, part.name, *_values(of[name]))
        for name in known[0]
        for part, of in zip(parts, known, strict=True)
        if name in of
    )
    return TextTable("Feature by feature", ("feature", "pass", *map(_heading, _titled(FeatureRow))), rows)


def _values(row: FeatureRow) -> list[str]:
    return [_text(column, getattr(row, column.name)) for column in _titled(FeatureRow)]


def _titled(record) -> list[Column]:
    """Columns of the report."""
    return [column for column in columns(record) if column.title]


def _heading(column: Column) -> str:
    return micro(column.heading())


def _text(column: Column, value: float) -> str:
    return fixed_text(value * column.scale, column.digits, column.least * column.scale)


def input_rows(arm: Arm, joints: np.ndarray) -> list[tuple[str, list[str]]]:
    """Table 1: name with unit, six values; joints [rad], (6,): the commanded joints at the start."""
    rows = [
        ("commanded joint position q at the start [deg]", np.round(np.degrees(joints), 3) + 0.0),
        ("joint compliance [10⁻⁶ rad/(N m)]", np.round(arm.joint_compliance * UM, 9)),
        ("link mass [kg]", arm.link_mass),
    ]
    return [(name, [shown(value) for value in values.tolist()]) for name, values in rows]


def details(passes: Sequence[ScoredPass]) -> TextTable:
    """Forces and exchange of every pass."""
    rows = []
    for scored in passes:
        result = scored.result
        shift = float(np.linalg.norm(result.reference - result.target, axis=1).max())
        rows.append(
            (
                scored.name,
                " / ".join(fixed_text(v, 2) for v in mean_force(result)),
                fixed_text(shift * UM, 2),
                fixed_text(result.removed_volume * 1e9, 3),
                fixed_text(float(result.correction.max()) * 1e9, 2),
                str(result.micro_steps),
                fixed_text(result.wall_time, 3),
            )
        )
    columns = (
        "pass",
        "mean force x / y / z, last quarter [N]",
        "largest correction [µm]",
        "removed volume [mm³]",
        "largest correction of a predicted pose [nm]",
        "micro-steps",
        "computed in [s]",
    )
    note = (
        "In each exchange period the arm predicts the pose of the tool, the cut answers with the mean wrench on the "
        "way there, and the arm corrects its pose with that wrench. The chip geometry was wrong by this correction "
        "of the pose."
    )
    return TextTable("Forces and exchange", columns, tuple(rows), note)


def warning(cell: Cell, passes: Sequence[ScoredPass]) -> str:
    """Return a sentence about the pass with the coarsest exchange if the exchange was too coarse, else ""."""
    path = path_of(cell)
    shares = [(scored.name, exchange_share(path, scored, cell.tolerances)) for scored in passes]
    name, (share, text, _) = max(shares, key=lambda item: item[1][0])
    return f"pass {name}: {text}" if share > path.exchange.warn_correction else ""


TONES = {YES: "good", CAUTION: "caution", NO: "bad"}  #: colour of the tile


def cut_text(path: CellPath) -> str:
    """Path and tool of a cell."""
    tool, speed = path.tool, path.tool.spindle_speed * 30 / np.pi
    cutter = f"a cutter of {tool.diameter * 1e3:g} mm with {tool.teeth} teeth at {speed:.0f} rpm"
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
