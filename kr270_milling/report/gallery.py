"""The figures of a report with their captions, from a cell and its passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.report import figures_compare, figures_pass, figures_setup
from kr270_milling.report.derived import micro_step_forces, slot_walls
from kr270_milling.report.series import deviation_of
from kr270_milling.report.style import svg_text
from kr270_milling.robot import forward

__all__ = ["Picture", "gallery"]

#: a longer pass is not swept a second time for its micro-step forces
MOST_MICRO_STEPS = 500_000
NO_FORCES = np.empty((0, 3))


@dataclass(frozen=True)
class Picture:
    """name: of its file, without ending; of_paper: the figure of the paper that it corresponds to, or ""."""

    name: str
    title: str
    of_paper: str
    caption: str
    svg: str


def gallery(cell: Cell, passes: Sequence[ScoredPass]) -> list[Picture]:
    """All pictures in the order of the report; the first pass is the original one."""
    return [*_setup(cell), *_one_pass(cell, passes[0]), *_comparison(cell, passes)]


def _picture(name: str, title: str, of_paper: str, figure: Figure, caption: str) -> Picture:
    return Picture(name, title, of_paper, caption, svg_text(figure))


def _revolution(cell: Cell) -> float:
    return 2 * np.pi / cell.tool.spindle_speed


def _setup(cell: Cell) -> list[Picture]:
    target = cell.target()
    per_tooth = cell.path.feed_rate * _revolution(cell) / cell.tool.teeth
    frames = forward(cell.arm, cell.mount, cell.joints(target)[0])
    depth = cell.path.depth_of_cut
    return [
        _picture(
            "force_law", "Cutting force of one tooth", "Fig. 3",
            figures_setup.force_law(cell.cutting, depth, per_tooth),
            f"Force against uncut chip thickness at a depth of cut of {depth * 1e3:.4g} mm. A full chip is as thick as "
            f"the feed per tooth, {per_tooth * 1e6:.0f} µm. "
            + ("Thin chips take more force for their size." if cell.cutting.law == "fractional" else ""),
        ),
        _picture(
            "arm_posture", "The arm at the start", "Fig. 10",
            figures_setup.arm_posture(frames, cell.workpiece.pose, cell.stock),
            "Node points of the stiffness model, joined, with the axes of the workpiece frame at its origin: x is the "
            "feed, y is across it, z points out of the part.",
        ),
        _picture(
            "start_position", "Tool and workpiece at the start", "Fig. 11",
            figures_setup.start_position(cell.tool, cell.stock, target.position[0], target.sample_velocity(0)),
            "Seen from above the part. The numbered lines are the teeth at t = 0; the dashed lines are the walls that "
            "the cut should leave.",
        ),
    ]  # fmt: skip


def _one_pass(cell: Cell, one: ScoredPass) -> list[Picture]:
    result, engaged = one.result, cell.full_engagement
    micro_step = cell.clock.period / cell.clock.micro_steps
    short = result.micro_steps <= MOST_MICRO_STEPS
    force = micro_step_forces(cell.cut(), result.tool, cell.clock.micro_steps) if short else NO_FORCES
    scored = result.time >= min(engaged, 0.5 * result.time[-1])
    passing, low, period = cell.tool.teeth / _revolution(cell), cell.low_frequency, cell.clock.period
    sampled = (force[np.repeat(scored[1:], cell.clock.micro_steps)], micro_step)
    if not short:
        sampled = (result.wrench[scored, :3], cell.clock.period)
    return [
        _picture(
            "forces", "Force on the tool", "Fig. 12",
            figures_pass.forces(result.time, result.wrench, _revolution(cell), engaged, force, micro_step),
            f"Pass '{one.name}'. Left: each value is the mean over one exchange period of {cell.clock.period * 1e3:g} "
            "ms, so the peaks within a tooth's engagement are lower here than in the zoom. Right: the last revolution "
            "at micro-steps of the spindle. Shaded: fully engaged.",
        ),
        _picture(
            "displacement", "Displacement of the tool", "Fig. 13",
            figures_pass.displacement(result.time, result.deflection, engaged),
            f"Pass '{one.name}'. The arm gives way, swings at its low frequency and settles at its static deflection. "
            "What happens before the shaded part is cut away by the teeth that follow.",
        ),
        _picture(
            "spectra", "Frequencies in force and displacement", "Figs. 12 and 13 in the frequency domain",
            figures_pass.spectra(*sampled, result.deflection[scored, 1], period, passing, low),
            f"Pass '{one.name}', fully engaged part. Force lives at the tooth passing frequency, {passing:.1f} Hz, and "
            f"its multiples; the arm follows only near its lowest lateral mode, {low:.2f} Hz.",
        ),
    ]  # fmt: skip


def _comparison(cell: Cell, passes: Sequence[ScoredPass]) -> list[Picture]:
    target = cell.target()
    pictures = []
    if len(passes) > 1:
        references = [(p.name, p.reference) for p in passes[1:]]
        pictures.append(
            _picture(
                "revised_trajectories", "Modified trajectory and its feed rate", "Fig. 14",
                figures_compare.revised_trajectories(target, references),
                "What the controller is told beyond the target, made from the displacement in earlier passes: points "
                f"every {cell.timing.controller_step * 1e3:g} ms. 'linear' joins them by straight lines, so that "
                "its rate jumps; the others join them smoothly.",
            )
        )  # fmt: skip
    series = [(p.name, p.result.time, deviation_of(p.result, target)) for p in passes]
    pictures.append(
        _picture(
            "path_deviation", "Path deviation before and after compensation", "Fig. 15",
            figures_compare.deviations(series, cell.full_engagement),
            "Tool centre minus target, across the feed. Shaded: fully engaged, the part that stays on the workpiece "
            "and is scored. Dotted: the largest deviation there.",
        )
    )  # fmt: skip
    if np.ptp(target.position[:, 1]) < 1e-9 and target.position[-1, 0] > target.position[0, 0]:
        pictures += _walls(cell, passes)
    return pictures


def _walls(cell: Cell, passes: Sequence[ScoredPass]) -> list[Picture]:
    """The machined profile, where the path runs along +x."""
    path, low, high = cell.target().position, cell.stock.min, cell.stock.max
    span = (max(path[0, 0], low[0]), min(path[-1, 0], high[0]))
    nominal = [path[0, 1] + side * cell.tool.radius for side in (1, -1)]
    left, right = (y if low[1] < y < high[1] else None for y in nominal)
    if not span[0] < span[1] or (left is None and right is None):
        return []
    found = [(p.name, slot_walls(p.result.time, p.result.actual, cell.tool)) for p in passes]
    caption = (
        "What remains on the part: each wall's distance from its nominal place, from the passages of the teeth. The "
        "fine teeth of the curves are the cusps between two passages of a tooth. Positive is to the left of the feed."
    )
    figure = figures_compare.walls(found, left, right, span)
    return [_picture("machined_profile", "Machined profile", "", figure, caption)]
