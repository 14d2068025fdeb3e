"""``kr270_milling identify forces``: force coefficients from mean forces of cuts."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_common, numbers, print_json, print_table
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
    from kr270_milling.identification.force_result import as_dict, sentences
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
    result, said = as_dict(found, bent), sentences(found, bent)
    if args.out:
        result["files"] = [str(path) for path in _write(args, found, bent, said)]
    if args.json:
        print_json(result)
        return
    columns, rows = _rows(result)
    print_table(f"Linear-edge law from {len(cuts)} cuts, residual {found.residual_rms:.3g} N RMS", columns, rows)
    if bent is not None:
        own = result["fractional"]
        rows = [[key, f"{own[key]:.5g}", f"{width:.3g}"] for key, width in own["ci95"].items()]
        print_table(f"Fractional law, residual {bent.residual_rms:.3g} N RMS", columns, rows)
    for line in (*said, *result.get("files", [])):
        print(line)


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


def _rows(result: dict) -> tuple[list[str], list[list[str]]]:
    import numpy as np

    rows = []
    for key, width in result["ci95"].items():
        value = result[key]
        shown = [f"{value:.5g}", f"{width:.3g}"] if np.isfinite(value) else ["-", "-"]
        rows.append([key, *shown])
    return ["coefficient", "value", "95 % +-"], rows


def _write(args, found, bent, said: list[str]) -> list[Path]:
    from kr270_milling import __version__
    from kr270_milling.base.files import staged
    from kr270_milling.base.include import write_include
    from kr270_milling.identification.figures import write_page
    from kr270_milling.identification.force_result import as_dict, figures, fractional_sections, linear_edge_sections

    title = f"Force coefficients from {Path(args.cuts).name}"
    notes = [f"{title}, identified by kr270_milling {__version__} from {len(found.cuts)} cuts", *said,
             "name this file in `includes`, and take `cutting` out of the cell"]  # fmt: skip
    if args.law == "fractional":
        sections = fractional_sections(bent)
    else:
        sections = linear_edge_sections(found.values, found.half_widths, found.axial)
    table = ("Linear-edge law", *_rows(as_dict(found)))
    with staged(args.out) as (draft, final):
        files = [
            write_include(draft / "forces.yaml", sections, notes),
            write_page(draft / "forces.html", title, said, [table], figures(found, bent)),
        ]
        return [final(path) for path in files]
