"""The front door for scripts and notebooks: five functions and the records that they return."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from kr270_milling.base.extras import require_extra
from kr270_milling.base.files import write_files
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell import cell as cells
from kr270_milling.cell import jobs
from kr270_milling.cell.cell import Cell
from kr270_milling.decide import check as checks
from kr270_milling.decide import compensation, tolerance, verdict
from kr270_milling.decide import decision as decisions
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.method import Method
from kr270_milling.show.report.series import COLUMNS, series_lines, series_rows

if TYPE_CHECKING:
    import pandas
    import plotly.graph_objects

__all__ = ["Compensation", "Pass", "check", "compensate", "read_cell", "read_recording", "simulate", "verdict_of"]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Pass(jobs.ScoredPass):
    """One pass of a cell, simulated or recorded: its name, reference, result (series) and scores."""

    cell: Cell

    @classmethod
    def of(cls, cell: Cell, scored: jobs.ScoredPass) -> Pass:
        return cls(**vars(scored), cell=cell)

    def __repr__(self) -> str:
        static, most = 1e6 * self.scores.static_deviation, 1e6 * self.scores.max_deviation
        shown = "" if np.isnan(static) else f"static {static:.2f} um, "
        return f"<Pass {self.name}: {shown}max {most:.2f} um>"

    @property
    def tolerance(self) -> tolerance.Judgement:
        """What the pass leaves on the part against ``part.tolerance_um``."""
        return tolerance.judge(self.cell, self)

    def to_frame(self) -> pandas.DataFrame:
        """Every series as a pandas frame, units in the column names; raises MissingExtra without pandas."""
        require_extra("to_frame", "studies", "pandas")
        import pandas

        rows = series_rows(self.result, self.cell.target())
        return pandas.DataFrame(np.column_stack([self.result.time, rows]), columns=list(COLUMNS))

    def to_csv(self, path) -> Path:
        """Write every series as CSV; returns the path."""
        write_files({Path(path): series_lines(self.result, self.cell.target())})
        return Path(path)

    def plot(self) -> plotly.graph_objects.Figure:
        """Deviation across the feed and force over time, as an interactive figure."""
        from plotly.subplots import make_subplots

        series = dict(zip(COLUMNS[1:], series_rows(self.result, self.cell.target()).T, strict=True))
        figure = make_subplots(rows=2, cols=1, shared_xaxes=True)
        figure.add_scatter(x=self.result.time, y=1e3 * series["path_deviation_mm"], name="deviation", row=1, col=1)
        for axis in "xyz":
            figure.add_scatter(x=self.result.time, y=series[f"force_{axis}_n"], name=f"force {axis}", row=2, col=1)
        figure.update_yaxes(title="deviation [um]", row=1, col=1)
        figure.update_yaxes(title="force [N]", row=2, col=1)
        figure.update_xaxes(title="time [s]", row=2, col=1)
        return figure.update_layout(title=repr(self)[1:-1])


@dataclass(frozen=True, eq=False)
class Compensation:
    """A pass as programmed, the compensated one, what the check says of it, and the decision."""

    original: Pass
    compensated: Pass
    checked: checks.Checked
    decision: decisions.Decision

    def __repr__(self) -> str:
        return f"<Compensation {self.compensated.name}: {self.decision.headline}>"


def read_cell(path, *assignments: str) -> Cell:
    """The cell of a parameter file, also a shipped one by its name; raises ConfigError.

    assignments: texts ``"tool.teeth=2"``, as behind ``--set``.
    """
    return cells.read_cell(find_file(str(path)), assignments)


def simulate(cell: Cell, reference: Trajectory | None = None) -> Pass:
    """One pass on a fresh workpiece, along the programmed path or along a reference."""
    return Pass.of(cell, jobs.simulate(cell, reference, "original" if reference is None else "reference"))


def compensate(cell: Cell, method: str | Method | None = None) -> Compensation:
    """Revise the trajectory by a method (default: that of the cell) and judge it."""
    done = compensation.compensate(cell, method)
    return Compensation(Pass.of(cell, done.original), Pass.of(cell, done.revised), done.checked, done.decision)


def check(cell: Cell, reference: Trajectory | None = None) -> checks.Checked:
    """Whether the path of the cell, or a corrected one, may be run."""
    return checks.check(cell, reference)


def verdict_of(cell: Cell, reference: Trajectory, samples: int = verdict.SAMPLES, seed: int = 1) -> verdict.Verdict:
    """Whether a corrected trajectory helps when the models are as uncertain as the cell says."""
    result = verdict.monte_carlo(cell, reference, samples, seed)
    return cast(verdict.Verdict, result)  # None only with a limit of time


def read_recording(path, namespace: str | None = None) -> Pass:
    """The pass of a recording (.mcap or its directory); raises RecordingError."""
    from kr270_milling.exchange.replay.recorded import pass_from_recording

    place = Path(path)
    files: Sequence[Path] = sorted(place.glob("*.mcap")) if place.is_dir() else [place]
    recorded = pass_from_recording(files[0] if files else place, place.stem, namespace)
    return Pass.of(recorded.cell, recorded.scored)
