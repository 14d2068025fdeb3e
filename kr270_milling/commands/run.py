"""``kr270_milling run``: the passes of a cell as ROS 2 nodes, each recorded to MCAP."""

from __future__ import annotations

import sys
from pathlib import Path

from kr270_milling.commands.console import Answer, Table, fixed, shown_path
from kr270_milling.commands.options import add_cell, add_plant, cell_of, option, plant_of
from kr270_milling.commands.progress import progress
from kr270_milling.compensation.methods import METHODS
from kr270_milling.nodes.option_types import bounded

COLUMNS = ("pass", "static [um]", "max [um]", "wall [s]", "x real time", "lost", "recording")


def add_arguments(parser) -> None:
    add_cell(parser)
    add_plant(parser)
    passes = "passes in all, with the original one (default: as many as needed)"
    option(parser, "--passes N", passes, bounded(1, 1000, int))
    option(parser, "--method", "how to compensate; may be given several times", choices=METHODS, action="append")
    option(parser, "--out DIR", "for recordings, logs, cell.yaml", default="out")
    option(parser, "--processes", "one process a node; else two nodes share one, which is quicker", bool)
    option(parser, "--namespace NAME", "ROS namespace of the four nodes", default="")


def run(args) -> Answer:
    from kr270_milling.ros.environment import require_ros

    require_ros()
    cell = cell_of(args)
    methods = list(dict.fromkeys(args.method or [cell.compensation.method]))  # each once, in the order given
    found = run_cell(cell, methods, args.out, args.passes, args.namespace, not args.processes, plant_of(args, cell))
    rows = [_row(ran.row()) for ran in found["passes"]]
    up = f"graph up in {found['graph_up_s']:.2f} s; cell, logs and recordings in {shown_path(found['out'])}"
    return Answer(summary(found), [Table("Path deviation, four nodes and a recorder", COLUMNS, rows), up])


def run_cell(cell, methods, out, passes=None, namespace: str = "", composed: bool = True, plant=None) -> dict:
    """Run a cell's passes, with the arm and the material of ``plant`` if there is one.

    Returns graph_up_s, out (the directory used) and passes, a list of RanPass.
    """
    from kr270_milling.base.errors import ParameterError
    from kr270_milling.graph.graph import Graph
    from kr270_milling.graph.plan import fresh_directory, run_plan
    from kr270_milling.ros.names import full_namespace

    namespace = full_namespace(namespace, "--namespace") if namespace else ""
    cuts = None if plant is None else plant.cell
    if cuts is not None and cuts.clock != cell.clock:
        allowed = f"{1e3 * cell.clock.period:g} in {cell.clock.micro_steps} micro-steps, as the cell that plans has it"
        raise ParameterError("plant: exchange.period_ms", 1e3 * cuts.clock.period, allowed)
    directory = fresh_directory(out)
    if directory != Path(out):
        print(f"{out} holds recordings already; this run writes to {directory}", file=sys.stderr)
    with progress("compiling") as report:
        _compile(cell)
        report.say("starting the nodes")
        with Graph(cell, directory, namespace, composed=composed, plant=cuts) as graph:
            ran = run_plan(graph, methods, passes, report.say)
            report.say("stopping the nodes")
        return {"graph_up_s": graph.up_s, "out": directory, "passes": ran}


def _compile(cell) -> None:
    """What the nodes run compiled is made once and kept on disk: here, so that no node of the graph waits for it."""
    import numpy as np

    from kr270_milling.simulation.milling_pass import CompliantArm

    above = np.array([0.0, 0.0, float(cell.stock.max[2]) + 1.0])
    cell.cut().sweep(above, above, 0, 1)
    CompliantArm(cell.arm_model(cell.target())).predict()


def summary(found: dict) -> dict:
    """What ``--json`` prints."""
    return {**found, "out": str(found["out"]), "passes": [ran.row() for ran in found["passes"]]}


def _row(row: dict) -> list[str]:
    numbers = [row["static_deviation_mm"] * 1e3, row["max_deviation_mm"] * 1e3, row["wall_s"], row["real_time_factor"]]
    return [row["name"], *map(fixed, numbers), str(row["messages_lost"]), shown_path(row["recording"])]
