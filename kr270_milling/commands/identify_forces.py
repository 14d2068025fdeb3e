"""``kr270_milling identify forces``: force coefficients from mean forces of cuts."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import option
from kr270_milling.nodes.option_types import bounded, numbers, stretch


def add_arguments(parser) -> None:
    option(parser, "cuts CUTS.csv", "one cut a row, with its forces or a recording of them")
    option(parser, "--cell CELL.yaml", "its tool made the cuts")
    option(parser, "--teeth", "of the tool, instead of the cell's", int)
    option(parser, "--diameter-mm", "of the tool, instead of the cell's", bounded(0, 1000))
    option(parser, "--rotation", "instead of the cell's", choices=("clockwise", "counterclockwise"))
    option(parser, "--law", "for the YAML file", default="linear_edge", choices=("linear_edge", "fractional"))
    recorded = parser.add_argument_group("recordings of a sensor")
    option(recorded, "--topic", "of type geometry_msgs/WrenchStamped", default="wrench")
    option(recorded, "--spindle-speed-rpm", "instead of the cell's", bounded(0, 1e6))
    option(recorded, "--tare START:STOP", "seconds of an idle stretch", stretch(0, 1e6))
    option(recorded, "--sensor-abc A,B,C", "sensor in the workpiece [deg]", numbers(3, most=720.0))
    option(recorded, "--sensor-on", "a plate under the part: part", default="tool", choices=("tool", "part"))
    option(recorded, "--sensor-mass-kg", "that hangs on it, where there is no tare", bounded(0, 5000), 0.0)
    option(parser, "--out DIR", "write YAML to include and report")


def run(args) -> Answer:
    from kr270_milling.base.record import find_file
    from kr270_milling.commands.identify import identified
    from kr270_milling.identification.cuts import Sensor, read_cuts, turn_of
    from kr270_milling.identification.forces import OneFeedError, fit_fractional, fit_linear_edge, force_outcome

    tool, down = _tool(args)
    turn = turn_of(args.sensor_abc)
    sensor = Sensor(args.topic, turn, args.sensor_on == "part", args.tare, args.sensor_mass_kg, down)
    cuts = read_cuts(find_file(args.cuts), tool, sensor)
    fits = [fit_linear_edge(cuts)]
    try:
        fits.append(fit_fractional(cuts))
    except OneFeedError:
        if args.law == "fractional":
            raise
    return identified(args, force_outcome(fits, args.law, Path(args.cuts).name))


def _tool(args):
    """The tool, and where down is in workpiece axes."""
    import numpy as np

    from kr270_milling.base.errors import InputError
    from kr270_milling.base.record import build, find_file, read_tree
    from kr270_milling.cell.sections import Workpiece
    from kr270_milling.cutting.tool import Tool

    tree: dict = {}
    down = np.array([0.0, 0.0, -1.0])
    if args.cell:
        file = find_file(args.cell)
        whole = read_tree(file)
        tree = whole.get("tool", {})
        down = build(Workpiece, whole.get("workpiece", {}), file, "workpiece.").pose.rotation.T @ down
    given = {"teeth": args.teeth, "diameter_mm": args.diameter_mm, "rotation": args.rotation,
             "spindle_speed_rpm": args.spindle_speed_rpm}  # fmt: skip
    tree = tree | {key: value for key, value in given.items() if value is not None}
    if not {"teeth", "diameter_mm"} <= set(tree):
        raise InputError("identify forces", "needs the tool: name --cell CELL.yaml, or --teeth and --diameter-mm")
    if "spindle_speed_rpm" not in tree:
        tree["spindle_speed_rpm"] = 1000.0  # only recordings need it, and those come with a cell
    return build(Tool, tree, args.cell or "command line", "tool."), down
