"""``kr270_milling identify forces``: force coefficients from mean forces of cuts."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_common, numbers
from kr270_milling.commands.identified import Outcome, Table, report
from kr270_milling.nodes.option_types import bounded, stretch


def add_arguments(parser) -> None:
    parser.add_argument("cuts", metavar="CUTS.csv", help="one cut a row, with its forces or a recording of them")
    parser.add_argument("--cell", metavar="CELL.yaml", help="its tool made the cuts")
    parser.add_argument("--teeth", type=int, help="of the tool, instead of the cell's")
    parser.add_argument("--diameter-mm", type=bounded(0, 1000), help="of the tool, instead of the cell's")
    parser.add_argument("--rotation", choices=("clockwise", "counterclockwise"), help="instead of the cell's")
    parser.add_argument("--law", choices=("linear_edge", "fractional"), default="linear_edge", help="for the YAML file")
    recorded = parser.add_argument_group("recordings of a sensor")
    recorded.add_argument("--topic", default="wrench", help="of type geometry_msgs/WrenchStamped (default: wrench)")
    recorded.add_argument("--spindle-speed-rpm", type=bounded(0, 1e6), help="instead of the cell's")
    recorded.add_argument("--tare", type=stretch(0, 1e6), metavar="START:STOP", help="seconds of an idle stretch")
    recorded.add_argument(
        "--sensor-abc", type=numbers(3, most=720.0), metavar="A,B,C", help="sensor in the workpiece [deg]"
    )
    recorded.add_argument("--sensor-on", choices=("tool", "part"), default="tool", help="a plate under the part: part")
    recorded.add_argument(
        "--sensor-mass-kg", type=bounded(0, 5000), default=0.0, help="that hangs on it, where there is no tare"
    )
    parser.add_argument("--out", metavar="DIR", help="write YAML to include and report")
    add_common(parser)


def run(args) -> None:
    from kr270_milling.base.record import find_file
    from kr270_milling.identification.cuts import read_cuts
    from kr270_milling.identification.force_result import (
        as_dict,
        figures,
        fractional_sections,
        linear_edge_sections,
        sentences,
    )
    from kr270_milling.identification.forces import OneFeedError, fit_linear_edge
    from kr270_milling.identification.fractional import fit_fractional

    tool, down = _tool(args)
    cuts = read_cuts(find_file(args.cuts), tool, _sensor(args, down))
    found = fit_linear_edge(cuts)
    try:
        bent = fit_fractional(cuts)
    except OneFeedError:
        if args.law == "fractional":
            raise
        bent = None
    result = as_dict(found, bent)
    sections = linear_edge_sections(found.values, found.half_widths, found.axial)
    if args.law == "fractional" and bent is not None:
        sections = fractional_sections(bent)
    tables = [_table(f"Linear-edge law, residual {found.residual_rms:.3g} N RMS", result)]
    if bent is not None:
        tables.append(_table(f"Fractional law, residual {bent.residual_rms:.3g} N RMS", result["fractional"]))
    title = f"Force coefficients from {len(cuts)} cuts, {Path(args.cuts).name}"
    outcome = Outcome("forces", title, result, tables, sentences(found, bent))
    use = "name this file in `includes`, and take `cutting` out of the cell"
    report(args, outcome, lambda: figures(found, bent), sections, use=use)


def _tool(args):
    """The tool, and where down is in workpiece axes."""
    import numpy as np

    from kr270_milling.base.errors import InputError
    from kr270_milling.base.record import build, find_file, read_tree
    from kr270_milling.cell.records import Workpiece
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


def _sensor(args, down):
    import numpy as np

    from kr270_milling.base.frames import rotation_from_abc
    from kr270_milling.identification.sensor import Sensor

    turn = np.eye(3) if args.sensor_abc is None else rotation_from_abc(np.radians(args.sensor_abc))
    return Sensor(args.topic, turn, args.sensor_on == "part", args.tare, args.sensor_mass_kg, down)


def _table(title: str, result: dict) -> Table:
    rows = [[key, *("-" if v != v else f"{v:.{d}g}" for v, d in ((result[key], 5), (width, 3)))]
            for key, width in result["ci95"].items()]  # fmt: skip
    return Table(title, ["coefficient", "value", "95 % +-"], rows)
