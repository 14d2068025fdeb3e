"""The command ``run``: the passes of a cell as ROS 2 nodes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from kr270_milling.base.column import columns_of, table_of
from kr270_milling.base.errors import ParameterError
from kr270_milling.base.files import fresh_directory
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import arm_model_of, cut_of, cut_text_of, path_of
from kr270_milling.live.ros.environment import keep_to_this_host, require_ros
from kr270_milling.physics.motion.milling_pass import CompliantArm
from kr270_milling.physics.motion.scores import Scores
from kr270_milling.show.commands.console import Answer, shown_path
from kr270_milling.show.commands.progress import steps
from kr270_milling.show.commands.simulate import plant_of


def run_graph(args) -> Answer:
    require_ros("run")
    keep_to_this_host()
    from kr270_milling.live.graph.plan import RunRow  # imports rclpy

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

    from kr270_milling.live.graph.graph import Graph  # these import rclpy
    from kr270_milling.live.graph.plan import run_plan
    from kr270_milling.live.ros.names import full_namespace

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
