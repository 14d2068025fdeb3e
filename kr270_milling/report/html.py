"""The report page: what stands in it, as plain values, and the template that lays it out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import jinja2
import numpy as np
from markupsafe import Markup

from kr270_milling import __version__
from kr270_milling.base.record import flatten
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass, mean_force
from kr270_milling.decision.part import PartAssessment
from kr270_milling.report.assumptions import assumptions
from kr270_milling.report.gallery import Picture
from kr270_milling.report.paper import PAPER, TABLE_2
from kr270_milling.report.part_gallery import feature_table, part_verdict
from kr270_milling.report.symbols import SYMBOLS

__all__ = ["fixed", "page"]


def fixed(value: float, digits: int) -> str:
    """Fixed decimals with a typographer's minus, never "-0"; a dash where there is no number."""
    if not np.isfinite(value):
        return "–"
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "−")


def page(
    cell: Cell,
    passes: Sequence[ScoredPass],
    pictures: Sequence[Picture],
    *,
    title: str,
    source: str,
    command: str,
    date: str,
    paper: bool,
    parts: Sequence[PartAssessment] = (),
) -> str:
    """The whole HTML text; every text from outside is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html").render(
        title=title,
        paper=paper,
        paper_source=PAPER,
        verdict=part_verdict(parts) if parts else verdict(passes),
        part=feature_table(parts) if parts else None,
        run=_run(cell, source, command, date),
        scores=[_score_row(p, paper) for p in passes],
        inputs=_inputs(cell),
        pictures=[(p, inline(p)) for p in pictures],
        details=[_detail_row(cell, p) for p in passes],
        warning=_warning(cell, passes),
        assumptions=assumptions(cell, paper),
        configuration=[(key, _shown(value)) for key, value in flatten(cell).items()],
        symbols=SYMBOLS,
    )


def verdict(passes: Sequence[ScoredPass]) -> str:
    """The largest deviation before and after, in one sentence."""
    before = passes[0].scores.max_deviation
    if len(passes) == 1:
        return f"Largest path deviation of the fully engaged tool: {fixed(before * 1e6, 2)} µm, not compensated."
    best = min(passes[1:], key=lambda p: p.scores.max_deviation)
    after = best.scores.max_deviation
    change = f"{100 * (1 - after / before):.1f} % less" if after < before else "no better"
    return (
        f"Largest path deviation of the fully engaged tool: {fixed(before * 1e6, 2)} µm before, "
        f"{fixed(after * 1e6, 2)} µm after ('{best.name}'), {change}."
    )


def inline(picture: Picture) -> Markup:
    """The SVG for the page: ids made its own, size left to the page. Its texts were escaped when it was drawn."""
    own = picture.name + "-"
    text = re.sub(r'(?<= id=")(?=[^"]*")', own, picture.svg)
    text = re.sub(r'(?<=url\(#)|(?<=href="#)', own, text)
    head, rest = text.split(">", 1)
    head = re.sub(r' (width|height)="[^"]*"', "", head)
    return Markup(f"{head}>{rest}")


def _run(cell: Cell, source: str, command: str, date: str) -> list[tuple[str, str]]:
    tool, path = cell.tool, cell.path
    cut = f"{path.length * 1e3:g} mm at {path.feed_rate * 60:g} m/min, {path.depth_of_cut * 1e3:.4g} mm deep"
    if cell.timed_path is not None:
        way, duration = cell.timed_path.toolpath.length, cell.target().duration_ns * 1e-9
        cut = f"{Path(path.file).name}: {way:.4g} m of path, {duration:.4g} s, at most {cell.feed_rate * 60:g} m/min"
    return [
        ("cell", source),
        ("arm", cell.arm.name),
        ("cut", cut),
        ("tool", f"{tool.diameter * 1e3:g} mm, {tool.teeth} teeth, {tool.spindle_speed * 30 / np.pi:.0f} rpm"),
        ("command", command),
        ("version", f"kr270_milling {__version__}"),
        ("date", date),
        ("random numbers", "none: the same input gives the same numbers"),
    ]


def _score_row(one: ScoredPass, paper: bool) -> dict:
    s = one.scores
    row = {
        "name": one.name,
        "static": fixed(s.static_deviation * 1e6, 2),
        "max": fixed(s.max_deviation * 1e6, 2),
        "low": fixed(s.low_frequency, 2),
        "ringing": fixed(s.ringing_frequency, 2),
        "damping": fixed(s.ringing_damping, 3),
    }
    if paper:
        static, largest, low = TABLE_2.get(one.name, (np.nan, np.nan, np.nan))
        row.update(paper_static=fixed(static * 1e6, 2), paper_max=fixed(largest * 1e6, 2), paper_low=fixed(low, 2))
    return row


def _inputs(cell: Cell) -> list[tuple[str, list[str]]]:
    """Table 1: name with unit, six values."""
    return [
        ("joint position q [deg]", [_shown(v) for v in np.round(np.degrees(cell.start_joints), 9)]),
        ("joint compliance [10⁻⁶ rad/(N m)]", [_shown(v) for v in np.round(cell.arm.joint_compliance * 1e6, 9)]),
        ("link mass [kg]", [_shown(v) for v in cell.arm.link_mass]),
    ]


def _detail_row(cell: Cell, one: ScoredPass) -> dict:
    result, force = one.result, mean_force(one.result)
    shift = np.linalg.norm(one.result.reference - one.result.target, axis=1).max()
    return {
        "name": one.name,
        "force": " / ".join(fixed(f, 2) for f in force),
        "correction": fixed(result.correction.max() * 1e9, 1),
        "shift": fixed(shift * 1e6, 2),
        "volume": fixed(result.removed_volume * 1e9, 1),
        "steps": f"{result.micro_steps}",
        "wall": fixed(result.wall_time, 3),
    }


def _warning(cell: Cell, passes: Sequence[ScoredPass]) -> str:
    per_tooth = cell.feed_rate * 2 * np.pi / cell.tool.spindle_speed / cell.tool.teeth
    share = max(float(p.result.correction.max()) for p in passes) / per_tooth
    if share <= cell.exchange.warn_correction:
        return ""
    return (
        f"The largest correction of a predicted pose is {100 * share:.1f} % of the feed per tooth, above the "
        f"{100 * cell.exchange.warn_correction:g} % set: use a shorter exchange.period_ms or more exchange.iterations."
    )


def _shown(value) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(map(_shown, value)) + "]"
    return f"{value:.10g}" if isinstance(value, float) else str(value)
