"""The assumption table: what the paper does not give or misprints, what was taken instead, and why.

Only what affects the run at hand is listed; values are those of the cell, never copies of them. The sentences stand in
``page/assumptions.txt``.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import NamedTuple

import jinja2
import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.robot.mass import MODELS
from kr270_milling.simulation.arm_model import modal_models

__all__ = ["Assumption", "assumptions", "mode_frequencies"]

TEXT = Path(__file__).parent / "page" / "assumptions.txt"


class Assumption(NamedTuple):
    """One row of the table."""

    point: str
    value: str
    reason: str


def mode_frequencies(cell: Cell) -> dict[str, np.ndarray]:
    """First natural frequencies [Hz] at the start of the path with each mass model that has an answer there."""
    start = cell.joints(cell.target())[:1]
    found = {}
    for name in MODELS:
        with contextlib.suppress(MillingError):
            dynamics = cell.dynamics.replace(mass_model=name)
            (model,) = modal_models(cell.arm, cell.mount, dynamics, cell.workpiece.pose, start)
            found[name] = model.frequency / (2 * np.pi)
    return found


def assumptions(cell: Cell, paper: bool) -> list[Assumption]:
    """The rows that hold for this cell; with ``paper`` also those about the paper's text and Table 2."""
    rows: list[Assumption] = []
    passing = cell.tool.spindle_speed / (2 * np.pi) * cell.tool.teeth
    per_tooth, law = cell.feed_rate / passing, cell.cutting.fractional
    u = per_tooth / law.specific_chip_thickness
    modes = mode_frequencies(cell).items()
    jinja2.Template(TEXT.read_text(encoding="utf-8"), undefined=jinja2.StrictUndefined).render(
        row=lambda *texts: rows.append(Assumption(*map(str, texts))),
        cell=cell,
        paper=paper,
        passing=passing,
        per_tooth=per_tooth,
        force=float(cell.cutting.force_per_depth(per_tooth)[0]) * 1e-3,
        printed=law.stiffness * (u + law.ratio * u * u) / (1 + u) * 1e-6,  # (26) to the letter, [kN] for 1 mm of depth
        helix=np.degrees(cell.tool.helix),
        micro_step=np.degrees(cell.exchange.micro_step),
        modes="; ".join(f"{name}: {', '.join(f'{f:.2f}' for f in hz[:3])} Hz" for name, hz in modes),
        way=cell.programmed.length,
    )
    return rows
