"""The assumption table: what the paper does not give or misprints, what was taken instead, and why.

Only what affects the run at hand is listed; values are those of the cell, never copies of them. The sentences are in
``page/assumptions.txt``.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import jinja2
import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.physics.motion.arm_model import modal_models
from kr270_milling.physics.robot.mass import MODELS

__all__ = ["assumptions", "model_frequencies"]

TEXT = Path(__file__).parent / "page" / "assumptions.txt"


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


def assumptions(cell: Cell, paper: bool) -> list[tuple[str, ...]]:
    """Return point, value and reason of each assumption of this cell.

    paper: also those about the paper's text and Table 2.
    """
    passing = cell.tool.spindle_speed / (2 * np.pi) * cell.tool.teeth
    rows: list[tuple[str, ...]] = list(cell.cutting.active.assumptions(path_of(cell).feed_rate / passing))
    modes = model_frequencies(cell).items()
    jinja2.Template(TEXT.read_text(encoding="utf-8"), undefined=jinja2.StrictUndefined).render(
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
