"""The front door for scripts and notebooks: the functions and the results that they return."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kr270_milling.base.column import TextTable, as_dict, columns_of, fixed, table_of
from kr270_milling.base.extensions import require_extra
from kr270_milling.base.files import write_files
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell import cell_file, jobs
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.decide import check as checks
from kr270_milling.decide import compensation
from kr270_milling.decide import decision as decisions
from kr270_milling.decide import verdict as verdicts
from kr270_milling.decide.part import assessment
from kr270_milling.decide.stability import modes_of
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.method import Method
from kr270_milling.physics.motion.scores import Scores
from kr270_milling.physics.motion.stability import Lobe
from kr270_milling.show.commands.console import now, steps
from kr270_milling.show.commands.options import make_parser
from kr270_milling.show.commands.options import run as run_command
from kr270_milling.show.report import report_text
from kr270_milling.show.report.series import series_columns, series_lines
from kr270_milling.show.report.study_page import figure_of, fragment, points, write_page
from kr270_milling.show.report.tables import TABLE_2
from kr270_milling.studies.maps.lobes import lobes
from kr270_milling.studies.maps.placements import Placements, grid_axes, path_places
from kr270_milling.studies.maps.sweep import Axis, Sweep

if TYPE_CHECKING:
    import pandas
    import plotly.graph_objects

__all__ = [
    "Compensation",
    "Lobes",
    "Pass",
    "Verdict",
    "check",
    "compare",
    "compensate",
    "identify",
    "placements",
    "read_cell",
    "read_recording",
    "simulate",
    "stability",
    "stiffness",
    "sweep",
    "verdict",
]


class Shown:
    """A result as a notebook shows it; each class gives sentences, tables and a figure."""

    def sentences(self) -> list[str]:
        return [repr(self)[1:-1]]

    def tables(self) -> list[TextTable]:
        return []

    def plot(self) -> plotly.graph_objects.Figure:
        raise NotImplementedError

    def _repr_html_(self) -> str:
        return fragment(self.sentences(), self.tables())

    def report(self, path) -> Path:
        """Write one HTML page with sentences, tables and figure; returns the path."""
        title, *sentences = self.sentences()
        return write_page(Path(path), title, sentences, self.tables(), [self.plot()], self_contained=True)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Pass(Shown, jobs.ScoredPass):
    """Pass of a cell, simulated or recorded: name, reference, result (series) and scores."""

    cell: Cell

    @classmethod
    def of(cls, cell: Cell, scored: jobs.ScoredPass) -> Pass:
        return cls(**vars(scored), cell=cell)

    def __repr__(self) -> str:
        shown = "" if np.isnan(self.static_deviation_um) else f"static {self.static_deviation_um:.2f} um, "
        return f"<Pass {self.name}: {shown}max {self.max_deviation_um:.2f} um>"

    @property
    def static_deviation_um(self) -> float:
        """Mean deviation [um] over the last quarter; NaN where the path has no single feed direction."""
        return 1e6 * self.scores.static_deviation

    @property
    def max_deviation_um(self) -> float:
        """Largest deviation [um] across the feed, once the tool is fully engaged."""
        return 1e6 * self.scores.max_deviation

    @property
    def tolerance(self) -> assessment.Judgement:
        """Remaining error of the part against ``part.tolerance_um``."""
        return assessment.judge(self.cell, self)

    def tables(self) -> list[TextTable]:
        return [_scores_table([self])]

    def to_frame(self) -> pandas.DataFrame:
        """Return every series as a pandas frame, units in the column names; raises MillingError without pandas."""
        return _pandas().DataFrame(series_columns(self.result, path_of(self.cell).target))

    def to_csv(self, path) -> Path:
        """Write every series as CSV; returns the path."""
        write_files({Path(path): series_lines(self.result, path_of(self.cell).target)})
        return Path(path)

    def plot(self) -> plotly.graph_objects.Figure:
        """Path deviation [um] and force [N] over time, as an interactive figure."""
        return _series_figure([self])

    def report(self, path) -> Path:
        """Write the report of the pass as one HTML page; returns the path."""
        return _write_report(path, self.cell, (self,), f"{self.cell.path.file_name or 'straight cut'}: {self.name}")


@dataclass(frozen=True, eq=False, repr=False)
class Compensation(Shown):
    """Passes as programmed and compensated, the check and the decision.

    The program has rounded points that the controller joins, so its pass ``written`` differs from the plan. The paper's
    Table 2 is that of the plan.
    """

    original: Pass
    planned: Pass
    written: Pass
    checked: checks.Checked
    decision: decisions.Decision

    def __repr__(self) -> str:
        return f"<Compensation {self.compensated.name}: {self.decision.headline}>"

    @property
    def compensated(self) -> Pass:
        """The pass of the written program."""
        return self.written

    def sentences(self) -> list[str]:
        return [f"Compensation {self.compensated.name}", *self.decision.lines(), self.checked.counts]

    def tables(self) -> list[TextTable]:
        named = {f"{run.name}, {kind}": run for kind, run in (("planned", self.planned), ("written", self.written))}
        return [_scores_table([self.original, *named.values()], [self.original.name, *named])]

    def to_frame(self) -> pandas.DataFrame:
        """Return the series of both passes, their names in the column ``pass``; raises MillingError without pandas."""
        frames = {run.name: run.to_frame() for run in (self.original, self.compensated)}
        return _pandas().concat(frames, names=["pass"]).reset_index(level=0)

    def plot(self) -> plotly.graph_objects.Figure:
        """Path deviation [um] and force [N] of both passes over time."""
        return _series_figure([self.original, self.compensated])

    def report(self, path) -> Path:
        """Write the report of both passes as one HTML page, the decision first; returns the path."""
        passes, cell = (self.original, self.compensated), self.original.cell
        title = f"{cell.path.file_name or 'straight cut'}: before and after compensation ({self.compensated.name})"
        return _write_report(path, cell, passes, title, decision=self.decision, checked=self.checked)


@dataclass(frozen=True, eq=False, repr=False)
class Verdict(Shown, verdicts.Verdict):
    """Errors of simulated robots: ``original_um`` as programmed, ``compensated_um`` with the correction."""

    @property
    def original_um(self) -> np.ndarray:
        """Errors [um] on the path as programmed, (n,); NaN where a robot fails."""
        return 1e6 * self.original

    @property
    def compensated_um(self) -> np.ndarray:
        """Errors [um] on the corrected trajectory, (n,); NaN where a robot fails."""
        return 1e6 * self.compensated

    def sentences(self) -> list[str]:
        return [repr(self)[1:-1], self.reason]

    def to_frame(self) -> pandas.DataFrame:
        """Return the errors of each simulated robot [um], as programmed and compensated; NaN where a robot fails."""
        return _pandas().DataFrame({"original_um": self.original_um, "compensated_um": self.compensated_um})

    def tables(self) -> list[TextTable]:
        rows = [
            (which, *(fixed(1e6 * value, 1) for value in self.band(which))) for which in ("original", "compensated")
        ]
        return [TextTable(f"{self.quantity} [um]", ("", "5 %", "50 %", "95 %"), rows)]

    def plot(self) -> plotly.graph_objects.Figure:
        """Return a figure of the errors [um] before and after."""
        figure = figure_of(self.word, "", f"{self.quantity} [um]")
        for which in ("original", "compensated"):
            figure.add_box(y=1e6 * getattr(self, which), name=which, boxpoints="all")
        return figure


@dataclass(frozen=True, repr=False)
class Lobes(Shown):
    """Limit depth of cut and chatter frequency over spindle speed."""

    rows: tuple[Lobe, ...]

    def __repr__(self) -> str:
        best = max(self.rows, key=lambda row: row.depth_limit)
        if best.depth_limit == np.inf:
            return "<Lobes: no chatter up to 100 mm at one speed or more>"
        depth, speed = 1e3 * best.depth_limit, best.spindle_speed * 30.0 / np.pi
        return f"<Lobes: deepest stable cut {depth:.3g} mm at {speed:.0f} rpm>"

    def tables(self) -> list[TextTable]:
        return [table_of("Stability lobes", columns_of(Lobe), map(as_dict, self.rows))]

    def to_frame(self) -> pandas.DataFrame:
        """Return one row a spindle speed: ``spindle_speed_rpm``, ``depth_limit_mm``, ``chatter_hz``."""
        return _pandas().DataFrame(map(as_dict, self.rows))

    def plot(self) -> plotly.graph_objects.Figure:
        """Limit depth [mm] over spindle speed [rpm]."""
        rows = list(map(as_dict, self.rows))
        across, up = ([row[name] for row in rows] for name in ("spindle_speed_rpm", "depth_limit_mm"))
        lines = {"limit depth": (across, up)}
        title = "Below the line the cut is stable"
        return points(title, "spindle speed [rpm]", "depth of cut [mm]", lines, ("limit depth",))


def read_cell(path, *assignments: str) -> Cell:
    """Return the cell of a parameter file.

    Parameters
    ----------
    path : str or Path
        Parameter file, also a shipped one by its name.
    *assignments : str
        ``key=value`` in the unit of the key, as behind ``--set``; ``kr270_milling keys`` lists the keys.

    Raises
    ------
    ConfigError
        A key, a value or a file that is not allowed.

    Examples
    --------
    >>> cell = read_cell("paper.yaml", "path.length_mm=30", "tool.teeth=2")
    """
    return cell_file.read_cell(find_file(str(path)), assignments)


def simulate(cell: Cell, reference: Trajectory | None = None) -> Pass:
    """Simulate one pass on a fresh workpiece.

    Parameters
    ----------
    cell : Cell
        Arm, tool, material and path.
    reference : Trajectory, optional
        Commanded trajectory, positions [m], (n, 3); default: the programmed path.

    Returns
    -------
    Pass
        Series and scores of the pass.

    Examples
    --------
    >>> simulate(read_cell("paper.yaml"))
    <Pass original: static 58.10 um, max 62.79 um>
    """
    return Pass.of(cell, jobs.simulate(cell, reference, "original" if reference is None else "reference"))


def compensate(cell: Cell, method: str | Method | None = None, progress: bool = False) -> Compensation:
    """Revise the trajectory, simulate the revision, check it and decide.

    Parameters
    ----------
    cell : Cell
        Arm, tool, material and path.
    method : str or Method, optional
        Name of a method, or an object of a separate class, see the extension guide; default: that of the cell.
    progress : bool
        Print step, share and time left on standard error every 5 s.

    Returns
    -------
    Compensation
        The passes ``original``, ``planned`` and ``written``, the check and the decision.

    Raises
    ------
    ParameterError
        An unknown method.
    PassError
        A pass that cannot be simulated.

    Examples
    --------
    >>> compensate(read_cell("paper.yaml"), "spline").plot().show()
    """
    with steps() if progress else nullcontext() as whole:
        result = compensation.compensate(cell, method, progress=whole or (lambda *_: nullcontext()))
    original, planned, written = (Pass.of(cell, each) for each in (result.original, result.planned, result.revised))
    return Compensation(original, planned, written, result.checked, result.decision)


def check(cell: Cell, reference: Trajectory | None = None) -> checks.Checked:
    """Check whether the path of the cell, or a corrected path, may be run.

    Parameters
    ----------
    cell : Cell
        Arm, tool, material and path.
    reference : Trajectory, optional
        Corrected trajectory, positions [m], (n, 3); default: the programmed path.

    Returns
    -------
    Checked
        Findings, stability, reach and limits.

    Examples
    --------
    >>> check(read_cell("test_piece.yaml")).may_be_run
    True
    """
    return checks.check(cell, reference)


def verdict(cell: Cell, reference: Trajectory, samples: int = verdicts.SAMPLES, seed: int = 1) -> Verdict:
    """Judge a corrected trajectory by robots as uncertain as the cell states.

    Parameters
    ----------
    cell : Cell
        Arm, tool, material and path; its section ``uncertainty`` states the spread of the robots.
    reference : Trajectory
        Corrected trajectory, positions [m], (n, 3).
    samples : int
        Number of simulated robots.
    seed : int
        Seed of the random robots.

    Returns
    -------
    Verdict
        Errors of each robot without and with the correction.

    Examples
    --------
    >>> verdict(cell, compensate(cell).compensated.reference, samples=16)
    <Verdict: helps (16 plants: 12.3 um, 5 to 95 % 4.1 to 25.6)>
    """
    return Verdict(**vars(verdicts.monte_carlo(cell, reference, samples, seed)))


def stability(cell: Cell, speeds_rpm: Sequence[float], arm: bool = True) -> Lobes:
    """Return the limit depth of cut at each spindle speed.

    Parameters
    ----------
    cell : Cell
        Arm, tool with ``tool.modes``, material and path.
    speeds_rpm : sequence of float
        Spindle speeds [rpm], (n,).
    arm : bool
        Include the modes of the arm.

    Returns
    -------
    Lobes
        Limit depth and chatter frequency, one row a speed.

    Examples
    --------
    >>> stability(cell, range(6000, 10001, 500)).plot()
    """
    speeds = [float(speed) * np.pi / 30.0 for speed in speeds_rpm]
    return Lobes(tuple(lobes(path_of(cell), cell.cutting, modes_of(cell, arm), speeds)))


def sweep(path, *assignments: str, vary: Mapping[str, Sequence[float | str]]) -> pandas.DataFrame:
    """Simulate full passes with every combination of values of any keys.

    Parameters
    ----------
    path : str or Path
        Parameter file, as of ``read_cell``.
    *assignments : str
        ``key=value``, as of ``read_cell``.
    vary : mapping of str to sequence
        Values by key, in the unit of the key.

    Returns
    -------
    pandas.DataFrame
        One row a pass, columns as of the command ``sweep``; ``error`` states why a row failed.

    Raises
    ------
    ConfigError, ParameterError
        A key or a value that is not allowed.
    MillingError
        pandas is not installed.

    Examples
    --------
    >>> sweep("paper.yaml", vary={"path.depth_of_cut_mm": [0.2, 0.5, 1.0]})["max_deviation_um"].tolist()
    """
    frames = _pandas()
    read_cell(path, *assignments)  # refuse a wrong cell before the passes
    axes = [Axis(key, tuple(v if isinstance(v, str) else float(v) for v in values)) for key, values in vary.items()]
    rows = Sweep(str(find_file(str(path)).resolve()), assignments, tuple(axes))
    with ThreadPoolExecutor(verdicts.cores()) as pool:
        return frames.DataFrame(list(pool.map(rows.row, range(len(rows)))))


def placements(cell: Cell, *, x_mm=None, y_mm=None, z_mm=None, turn_deg=None, tool_turn_deg=None) -> pandas.DataFrame:
    """Return reach, limits and predicted error of the workpiece at other places.

    Parameters
    ----------
    cell : Cell
        Arm, tool, material and path.
    x_mm, y_mm, z_mm : sequence of float, optional
        Origin of the workpiece on base_link [mm]; default: the present value.
    turn_deg : sequence of float, optional
        Turn of the workpiece about z of base_link [deg].
    tool_turn_deg : sequence of float, optional
        Turn of the tool about its axis [deg].

    Returns
    -------
    pandas.DataFrame
        Rows of the command ``map``: 8 for each placement, one for each branch of the arm.

    Raises
    ------
    ParameterError
        No placement, or too many.
    MillingError
        pandas is not installed.

    Examples
    --------
    >>> placements(cell, x_mm=range(1200, 1801, 100)).query("feasible").nsmallest(5, "error_max_um")
    """
    frames = _pandas()
    axes = grid_axes(cell.workpiece, (x_mm, y_mm, z_mm, turn_deg, tool_turn_deg))
    places = path_places(path_of(cell), jobs.simulate(cell).result)
    grid = Placements(arm_of(cell), cell.uncertainty.left, places, axes)
    return frames.DataFrame(grid.columns(0, len(grid)))


def read_recording(path, namespace: str | None = None) -> Pass:
    """Return the pass of a recording.

    Parameters
    ----------
    path : str or Path
        File ``.mcap``, or its directory.
    namespace : str, optional
        Namespace of the robot, if the recording has several.

    Returns
    -------
    Pass
        Series and scores of the recorded pass.

    Raises
    ------
    RecordingError
        A file that cannot be read, or that has no pass.

    Examples
    --------
    >>> read_recording("out/linear.mcap").to_frame()
    """
    place = Path(path)
    files: Sequence[Path] = sorted(place.glob("*.mcap")) if place.is_dir() else [place]
    scored, recorded = pass_from_recording(files[0] if files else place, place.stem, namespace)
    return Pass.of(recorded.cell, scored)


def stiffness(arm, **options) -> dict:
    """Return stiffness and natural frequencies of an arm at one posture.

    Parameters
    ----------
    arm : str or Path
        File of a cell or an arm, also a shipped one by its name.
    **options
        Options of the command ``stiffness``, with ``_`` for ``-``.

    Returns
    -------
    dict
        Keys of ``stiffness --json``, see guide/contributing/json.md.

    Examples
    --------
    >>> stiffness("kr270_2.yaml", joints_deg=[90, -50, 120, 180, 25, 180])["pose"]
    """
    return _values("stiffness", arm, **options)


def identify(what: str, *files, **options) -> dict:
    """Identify compliance, forces, damping or a material from measurements.

    Parameters
    ----------
    what : str
        ``compliance``, ``forces``, ``damping`` or ``material``.
    *files : str or Path
        Files of the measurements.
    **options
        Options of the command ``identify``, with ``_`` for ``-``.

    Returns
    -------
    dict
        Keys of ``identify --json``, see guide/contributing/json.md.

    Examples
    --------
    >>> identify("compliance", "load_tests.csv", arm="kr270_2.yaml", cell="test_piece.yaml")["arm"]
    """
    return _values("identify", what, *files, **options)


def compare(recording, cell, **options) -> dict:
    """Compare a measured pass with the simulated one.

    Parameters
    ----------
    recording : str or Path
        Recording, or table of a measured wall.
    cell : str or Path
        Parameter file of the cell.
    **options
        Options of the command ``compare``, with ``_`` for ``-``.

    Returns
    -------
    dict
        Keys of ``compare --json``, see guide/contributing/json.md.

    Examples
    --------
    >>> compare("graph/original", "paper.yaml")["advice"]
    """
    return _values("compare", recording, cell, **options)


def _values(*words, **options) -> dict:
    """Return what a command prints with ``--json``; an option that is True has no value, a sequence is a list."""
    for name, value in options.items():
        words += (f"--{name.replace('_', '-')}",)
        if value is not True:
            text = ",".join(map(str, value)) if isinstance(value, (list, tuple, np.ndarray)) else str(value)
            words = (*words[:-1], f"{words[-1]}={text}")
    argv = [str(word) for word in words]
    args = make_parser(argv).parse_args(argv)
    args.argv = argv
    return dict(run_command(args).result)


def _pandas():
    require_extra("a frame", "studies", "pandas")
    import pandas

    return pandas


def _scores_table(passes: Sequence[Pass], names: Sequence[str] = ()) -> TextTable:
    """Return the scores of passes, with the largest deviation of Table 2 where the cell is that of the paper."""
    rows = [run.row() | ({"name": name} if name else {}) for run, name in zip_longest(passes, names)]
    columns = [("pass", "name", 2), *columns_of(Scores, unit="um")]
    if passes[0].cell == read_cell("paper.yaml"):
        columns.append(("max, paper", "paper", 2))
        for run, row in zip(passes, rows, strict=True):
            paper = None if str(row["name"]).endswith(", written") else TABLE_2.get(run.name)
            row["paper"] = 1e6 * paper.max_deviation if paper else math.nan
    return table_of("Path deviation [um]", columns, rows)


def _series_figure(passes: Sequence[Pass]) -> plotly.graph_objects.Figure:
    title = ", ".join(f"{run.name}: max {run.max_deviation_um:.2f} um" for run in passes)
    figure = figure_of(title, "", "").set_subplots(rows=2, cols=1, shared_xaxes=True)
    for run in passes:
        which = f" {run.name}" if len(passes) > 1 else ""
        series = series_columns(run.result, path_of(run.cell).target)
        deviation = series["path_deviation_um"]
        figure.add_scatter(x=run.result.time, y=deviation, name=f"deviation{which}", row=1, col=1)
        for axis in "xyz":
            force = series[f"force_{axis}_n"]
            figure.add_scatter(x=run.result.time, y=force, name=f"force {axis}{which}", row=2, col=1)
    figure.update_yaxes(title="deviation [um]", row=1, col=1)
    figure.update_yaxes(title="force [N]", row=2, col=1)
    figure.update_xaxes(title="time [s]", row=2, col=1)
    return figure.update_layout(height=450)


def _write_report(path, cell: Cell, passes: Sequence[Pass], title: str, **more) -> Path:
    text = report_text(cell, passes, title=title, source=cell.path.file_name, command="Python", date=now(), **more)
    write_files({Path(path): (text,)})
    return Path(path)
