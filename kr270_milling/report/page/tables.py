"""The tables of the page, as texts: one kind of minus sign, no path of anybody's machine."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kr270_milling import __version__
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, mean_force
from kr270_milling.decision.part import PartAssessment
from kr270_milling.report.decision_block import ReportTable
from kr270_milling.report.paper import TABLE_2
from kr270_milling.report.payload import fixed

__all__ = [
    "detail_rows",
    "feature_table",
    "input_rows",
    "line_scores",
    "part_scores",
    "run_rows",
    "shown",
    "typographic",
    "warning",
]

UM = 1e6
#: column of the part's tables, key of FeatureRow, factor, digits
COLUMNS = (
    ("largest deviation to the side [µm]", "max_normal", UM, 1),
    ("mean [µm]", "mean_normal", UM, 1),
    ("95 % [µm]", "quantile_normal", UM, 1),
    ("largest wall error [µm]", "max_wall", UM, 1),
    ("largest floor error [µm]", "max_floor", UM, 1),
    ("largest force [N]", "max_force", 1.0, 1),
    ("largest power [W]", "max_power", 1.0, 0),
)


def shown(value, key: str = "") -> str:
    """A value of the configuration; of a file only its name."""
    if isinstance(value, list):
        return "[" + ", ".join(map(shown, value)) + "]"
    if isinstance(value, float):
        return f"{value:.10g}".replace("-", "−")
    if isinstance(value, str) and key.rpartition(".")[2] in ("file", "topic"):
        return Path(value).name if key.endswith("file") else value
    return str(value).replace("-", "−") if isinstance(value, int) else str(value)


def typographic(table: ReportTable) -> ReportTable:
    """A table of others with the page's minus sign and micro sign, and no "-0.00"."""
    rows = tuple(tuple(map(_typographic, row)) for row in table.rows)
    columns = tuple(_micro(column) for column in table.columns)
    return ReportTable(_micro(table.title), columns, rows, _micro(table.note))


def _typographic(text: str) -> str:
    if re.fullmatch(r"-0(\.0*)?", text):
        return text[1:]
    return _micro(re.sub(r"(?<![\w-])-(?=\d)", "−", text))


def _micro(text: str) -> str:
    return re.sub(r"\bum\b", "µm", text)


def line_scores(passes: Sequence[ScoredPass], paper: bool) -> ReportTable:
    """Accuracy before and after of a straight cut; with ``paper`` the numbers of Table 2 beside ours."""
    titles = ["static deviation [µm]", "largest deviation [µm]", "low frequency [Hz]"]
    columns = ["pass"]
    for title in titles:
        columns += [title, "paper"] if paper else [title]
    rows = []
    for one in passes:
        s = one.scores
        printed = TABLE_2.get(one.name, (np.nan, np.nan, np.nan))
        ours = (s.static_deviation * UM, s.max_deviation * UM, s.low_frequency)
        row = [one.name]
        for value, other, factor in zip(ours, printed, (UM, UM, 1.0), strict=True):
            row += [fixed(value, 2), fixed(other * factor, 2)] if paper else [fixed(value, 2)]
        rows.append((*row, fixed(s.ringing_frequency, 2), fixed(s.ringing_damping, 3)))
    columns += ["ringing found [Hz]", "its damping ratio"]
    note = (
        "Path deviation: actual tool centre minus target, perpendicular to the feed. Static: its mean over the last "
        "quarter of the pass. Largest: its largest magnitude while the tool is fully engaged. Low frequency: the "
        "lowest lateral mode of the model; ringing: the undamped frequency and damping ratio found in the pass."
    )
    title = "Before and after" + (" (Table 2)" if paper else "")
    return ReportTable(title, tuple(columns), tuple(rows), note)


def part_scores(parts: Sequence[PartAssessment]) -> ReportTable:
    """The whole part, one row a pass."""
    rows = tuple((part.name, *_values(part.whole)) for part in parts)
    note = (
        "Deviation: actual tool centre minus target, horizontal and across the path, while the tool cuts. Wall and "
        "floor: what remains on the finished part, against the part that a rigid arm would leave."
    )
    return ReportTable("Before and after, whole part", ("pass", *(c[0] for c in COLUMNS)), rows, note)


def feature_table(parts: Sequence[PartAssessment]) -> ReportTable:
    """For each feature one row a pass."""
    names = [row.name for row in (*parts[0].rows, parts[0].whole)]
    rows = []
    for name in names:
        for part in parts:
            row = next((r for r in (*part.rows, part.whole) if r.name == name), None)
            if row is not None:
                rows.append((name, part.name, *_values(row)))
    return ReportTable("Feature by feature", ("feature", "pass", *(c[0] for c in COLUMNS)), tuple(rows))


def _values(row) -> list[str]:
    return [fixed(getattr(row, key) * factor, digits) for _, key, factor, digits in COLUMNS]


def run_rows(cell: Cell, source: str, command: str, date: str) -> list[tuple[str, str]]:
    tool, path = cell.tool, cell.path
    cut = f"{path.length * 1e3:g} mm at {path.feed_rate * 60:g} m/min, {path.depth_of_cut * 1e3:.4g} mm deep"
    if cell.timed_path is not None:
        way, duration = cell.timed_path.toolpath.length, cell.target().duration_ns * 1e-9
        cut = f"{Path(path.file).name}: {way:.4g} m of path, {duration:.4g} s, at most {cell.feed_rate * 60:g} m/min"
    return [
        ("cell", Path(source).name),
        ("arm", cell.arm.name),
        ("cut", cut),
        ("tool", f"{tool.diameter * 1e3:g} mm, {tool.teeth} teeth, {tool.spindle_speed * 30 / np.pi:.0f} rpm"),
        ("command", command),
        ("version", f"kr270_milling {__version__}"),
        ("date", date),
        ("random numbers", "none: the same input gives the same numbers"),
    ]


def input_rows(cell: Cell, joints: np.ndarray) -> list[tuple[str, list[str]]]:
    """Table 1: name with unit, six values; joints [rad], (6,): those that are commanded at the start."""
    return [
        (
            "commanded joint position q at the start [deg]",
            [shown(v + 0.0) for v in np.round(np.degrees(joints), 3).tolist()],
        ),
        ("joint compliance [10⁻⁶ rad/(N m)]", [shown(v) for v in np.round(cell.arm.joint_compliance * UM, 9).tolist()]),
        ("link mass [kg]", [shown(v) for v in cell.arm.link_mass.tolist()]),
    ]


def detail_rows(cell: Cell, passes: Sequence[ScoredPass]) -> list[tuple[str, ...]]:
    """Pass, mean force, shift of the reference, volume, correction of a pose, micro-steps, wall time."""
    rows: list[tuple[str, ...]] = []
    for one in passes:
        result = one.result
        shift = float(np.linalg.norm(result.reference - result.target, axis=1).max()) * UM
        exchange = fixed(float(result.correction.max()) * 1e9, 2), str(result.micro_steps), fixed(result.wall_time, 3)
        force, volume = " / ".join(fixed(v, 2) for v in mean_force(result)), fixed(result.removed_volume * 1e9, 3)
        rows.append((one.name, force, fixed(shift, 2), volume, *exchange))
    return rows


def warning(cell: Cell, passes: Sequence[ScoredPass]) -> str:
    """Where the exchange was too coarse."""
    per_tooth = cell.feed_rate * 2 * np.pi / cell.tool.spindle_speed / cell.tool.teeth
    share = max(float(p.result.correction.max()) for p in passes) / per_tooth
    if share <= cell.exchange.warn_correction:
        return ""
    return (
        f"The largest correction of a predicted pose is {100 * share:.1f} % of the feed per tooth, above the "
        f"{100 * cell.exchange.warn_correction:g} % set: use a shorter exchange.period_ms or more exchange.iterations."
    )
