"""``run``: the passes of a cell as ROS 2 nodes, each scored from its recording; ``demo``: the case of the paper."""

from __future__ import annotations

import dataclasses
import importlib.util
import itertools
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kr270_milling.base.column import TextTable, as_dict, column, columns_of, computed, table_of
from kr270_milling.base.errors import ParameterError
from kr270_milling.base.files import fresh_directory, staged
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import ScoredPass, compensated, compensator, simulate
from kr270_milling.cell.models import arm_model_of, arm_of, cut_of, cut_text_of, path_of
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.live.ros.environment import keep_to_this_host, require_ros
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.physics.motion.milling_pass import CompliantArm
from kr270_milling.physics.motion.scores import Scores
from kr270_milling.show.commands.console import Answer, command_line, now, say_replaced, shown_path, steps
from kr270_milling.show.commands.simulate import plant_of
from kr270_milling.show.report import write_report
from kr270_milling.show.report.series import write_series
from kr270_milling.show.report.tables import TABLE_2

if TYPE_CHECKING:
    from kr270_milling.live.graph import Graph


@dataclasses.dataclass(frozen=True, eq=False)
class RunRow:
    """A row of the table of a run."""

    scored: ScoredPass
    recording: Path
    errors: tuple[float, ...]  #: remaining error of every pass of this method so far [m], by the compensator
    finished: bool  #: the compensator has reached its limit
    messages_lost: int = column("messages_lost", digits=0, short="lost")
    wall: float = column("wall_s", unit="s", digits=2, short="wall")  #: from the first exchange to the last [s]
    learning: tuple[RunRow, ...] = ()  #: every pass of a method that repeats; the row itself is the best of them

    @computed("duration_s")
    def duration(self) -> float:
        """Time of the pass [s]."""
        return float(self.scored.result.time[-1])

    @computed("real_time_factor", digits=2, short="x real time")
    def real_time_factor(self) -> float:
        return self.duration / self.wall

    def row(self) -> dict:
        """Return the row with the keys that the command prints."""
        row = {**self.scored.row(), "recording": str(self.recording), **as_dict(self)}
        return {**row, "learning": [scored_pass.row() for scored_pass in self.learning]} if self.learning else row


def run_plan(
    graph: Graph,
    methods: Sequence[str],
    passes: int | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> list[RunRow]:
    """Run the original pass, then those of each method.

    passes: number of passes with the original (default: as needed)
    say: called with a sentence at the start of each pass.
    """
    numbers = itertools.count(1)
    most = _most_passes(graph.cell.compensation, path_of(graph.cell).target, methods, passes)

    def run(name: str) -> RunRow:
        say(f"{name}, pass {next(numbers)} of at most {most}")
        recording, wall, errors, finished = graph.run_pass(name)
        scored_pass, recorded = pass_from_recording(recording, name, graph.driver.namespace)
        return RunRow(scored_pass, recording, errors, finished, recorded.lost_to_end, wall)

    original = run("original")
    rows = [original]
    for method in methods:
        if passes is not None and passes < 2:
            break
        graph.choose(method)
        if graph.repeats:
            rows.append(_repeated(method, run, original, passes and passes - 1))
            continue
        for number in range(1, passes or 2):
            rows.append(run(method if number == 1 else f"{method}_{number}"))
    return rows


def _most_passes(settings: CompensationSettings, target: Trajectory, methods: Sequence[str], passes: int | None) -> int:
    """Return the largest possible number of passes."""
    if passes is not None:
        return 1 + len(methods) * (passes - 1)
    limits = (Compensator(settings, target, method).most_passes for method in methods)
    return 1 + sum(1 if most is None else most for most in limits)


def _repeated(method: str, run: Callable[[str], RunRow], original: RunRow, most: int | None) -> RunRow:
    """Run passes until the compensator is finished, at most ``most``; return the pass along the best reference."""
    tried: list[RunRow] = []
    while not (tried and tried[-1].finished) and (most is None or len(tried) < most):
        tried.append(run(f"{method}_{len(tried) + 1}"))
    errors = tried[-1].errors  # the first error is that of the original pass
    best = [original, *tried][min(range(len(errors)), key=errors.__getitem__)]
    named = dataclasses.replace(best.scored, name=method)
    return dataclasses.replace(best, scored=named, learning=tuple(tried))


def run_graph(args) -> Answer:
    require_ros("run")
    keep_to_this_host()
    cell = read_cell(find_file(args.cell), args.set)
    if cell.stage:
        if cell.stage.earlier:
            print(f"warning: {cell.stage}: the nodes begin with an uncut stock", file=sys.stderr)
        cell = cell.replace(stage=None)
    methods = list(dict.fromkeys(args.method or [cell.compensation.planned_method]))  # each once, in the order given
    options = args.passes, args.namespace, not args.processes, plant_of(args, cell)
    with steps() as whole:
        outcome = run_passes(cell, methods, args.out, *options, say=whole.say)
    up = f"graph up in {outcome['graph_up_s']:.2f} s; cell, logs and recordings in {shown_path(outcome['out'])}"
    result = summary(outcome)
    columns = (("pass", "name", 2), *columns_of(Scores), *columns_of(RunRow), ("recording", "recording", shown_path))
    table = table_of("Path deviation, four nodes and a recorder", columns, result["passes"])
    missing = missing_text(outcome)
    return Answer(result, [table, cut_text_of(cell), up, *missing], code=int(bool(missing)))


def missing_text(outcome: dict) -> list[str]:
    """Return a sentence where messages are missing in the recordings of ``run_passes``."""
    lost = sum(run.messages_lost for row in outcome["passes"] for run in (row, *row.learning))
    return [f"{lost} messages are missing in the recordings"] if lost else []


def run_passes(cell, methods, out, passes=None, namespace: str = "", composed: bool = True, plant=None, *, say) -> dict:
    """Run a cell's passes as nodes, with the arm and the material of ``plant`` if there is one.

    say: called with a sentence at the start of each step. Returns graph_up_s, out (the directory used) and passes, a
    list of RunRow.
    """

    from kr270_milling.live.graph import Graph  # these import rclpy
    from kr270_milling.live.ros.topics import full_namespace

    namespace = full_namespace(namespace, "--namespace") if namespace else ""
    cuts = None if plant is None else plant.cell
    planned, driven = path_of(cell).clock, path_of(cuts or cell).clock
    if planned != driven:
        allowed = f"{1e3 * planned.period:g} in {planned.micro_steps} micro-steps, as the cell that plans has it"
        raise ParameterError("plant: exchange.period_ms", 1e3 * driven.period, allowed)
    directory = fresh_directory(out)
    if directory != Path(out):
        print(f"{out} holds recordings already; this run writes to {directory}", file=sys.stderr)
    say("models of arm and cut")
    _compile(cell)
    say("starting the nodes")
    with Graph(cell, directory, namespace, composed, cuts) as graph:
        rows = run_plan(graph, methods, passes, say)
    return {"graph_up_s": graph.up_s, "out": directory, "passes": rows}


def _compile(cell) -> None:
    """Compile once what the nodes run, so that no node of the graph waits; the disk keeps the compiled code."""
    above = np.array([0.0, 0.0, float(cell.stock.max[2]) + 1.0])
    cut_of(cell).sweep(above, above, 0, 1)
    CompliantArm(arm_model_of(cell, path_of(cell).target)).predict()


def summary(outcome: dict) -> dict:
    """Return the result for JSON."""
    return {**outcome, "out": str(outcome["out"]), "passes": [row.row() for row in outcome["passes"]]}


METHODS = ("linear", "spline", "mirror", "learned")
WITH_INERTIA = "Path deviation [um], with the inertia of the moving arm"
NEEDS = "learned and inverse need a tracker or the model: the encoders of the joints do not see the deflection"


def run_demo(args) -> Answer:

    inertia_methods = (*METHODS, "inverse")
    source = find_file("paper.yaml")
    cell = read_cell(source)
    moving = read_cell(source, ["dynamics.reference_inertia=true"])
    other = args.plant is not None or args.noise_um is not None
    if args.plain or other or importlib.util.find_spec("rclpy") is None:
        say_replaced(args.out)
        loop = "plain loop in one process" + ("" if args.plain or other else ", since rclpy is not installed")
        with staged(args.out) as (draft, final), steps() as whole:
            passes = _plain(whole, cell, METHODS, plant_of(args, cell))
            second = _plain(whole, moving, inertia_methods, plant_of(args, moving), ", with inertia")
            whole.say("report")
            report = final(_write(draft, cell, passes, second, source, args))
        return _answer(passes, second, {"report": str(report), "out": args.out, "ran_as": loop})
    with steps() as whole:
        result = run_passes(cell, METHODS, args.out, say=whole.say)
        passes = [row.scored for row in result["passes"]]
        second = _plain(whole, moving, inertia_methods, None, ", with inertia")
        whole.say("report")
        report = _write(result["out"], cell, passes, second, source, args)
    loop = f"four ROS 2 nodes and a recorder, graph up in {result['graph_up_s']:.2f} s"
    return _answer(passes, second, {**summary(result), "report": str(report), "ran_as": loop}, missing_text(result))


def _plain(whole, cell, methods, plant, suffix: str = "") -> list:

    with whole(f"original{suffix}") as report:
        passes = [simulate(cell, progress=report, plant=plant)]
    for method in methods:
        by = compensator(cell, path_of(cell).target, method)
        with whole(f"{method}{suffix}", by.most_passes) as report:
            passes.append(compensated(cell, passes[0], method, report, by, plant))
    return passes


def _write(directory, cell, passes, second, source, args):
    """Report and series; returns the path of the report."""
    rows = tuple((name, static, largest) for name, static, _, largest, *_ in map(_row, second))
    table = TextTable(WITH_INERTIA, ("pass", "static", "max"), rows, NEEDS)
    report = write_report(
        directory,
        cell,
        passes,
        title="The milling pass of Klimchik et al. (2014)",
        source=str(source),
        command=command_line(args),
        date=now(),
        paper=True,
        tables=(table,),
    )
    write_series(directory, arm_of(cell), path_of(cell).target, passes)
    return report


def _answer(passes, second, result: dict, missing: Sequence[str] = ()) -> Answer:
    both = {"passes": [p.row() for p in passes], "passes_reference_inertia": [p.row() for p in second]}
    columns = ["pass", "static", "paper", "max", "paper", "low frequency, model [Hz]"]
    rows = [[name, static, largest, low] for name, static, _, largest, _, low in map(_row, second)]
    return Answer(
        {**result, **both},
        [
            TextTable("Path deviation [um], eq. (1) as printed, Table 2", columns, [_row(p) for p in passes]),
            TextTable(WITH_INERTIA, ["pass", "static", "max", "low frequency, model [Hz]"], rows),
            NEEDS,
            f"ran as: {result['ran_as']}",
            f"report: {result['report']}",
            *missing,
        ],
        code=int(bool(missing)),
    )


def _row(p) -> list[str]:

    ours, paper = p.scores, TABLE_2.get(p.name)
    deviations = [
        f"{1e6 * getattr(scores, name):.2f}" if scores else ""
        for name in ("static_deviation", "max_deviation")
        for scores in (ours, paper)
    ]
    return [p.name, *deviations, f"{ours.low_frequency:.2f}"]
