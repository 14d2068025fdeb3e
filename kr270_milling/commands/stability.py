"""``kr270_milling stability``: limit depth of cut and chatter frequency over spindle speed."""

from __future__ import annotations

import argparse
import math

from kr270_milling.commands.console import add_cell, add_common, fixed, print_json, print_table
from kr270_milling.commands.progress import progress

COUNT = 60  #: speeds without --speeds
SHOWN = 24  #: rows of the printed table


def add_arguments(parser) -> None:
    add_cell(parser)
    parser.add_argument(
        "--speeds", metavar="LOW:HIGH:COUNT", type=_speeds,
        help=f"spindle speeds [rpm] (default: {COUNT} from half to one and a half times that of the cell)",
    )  # fmt: skip
    parser.add_argument("--no-arm", action="store_true", help="leave out the arm: the modes of tool.modes alone")
    parser.add_argument(
        "--along", action="store_true", help="instead of lobes: the limit depth of each feature of the path"
    )
    parser.add_argument("--out", metavar="DIR", help="write lobes.csv and the picture lobes.html here")
    parser.epilog += (
        "\nkeys: path.radial_immersion (share of the diameter) and path.mode (slot, up, down) say how the tool is "
        "engaged, tool.modes what of tool and spindle vibrates"
    )
    add_common(parser)


def _speeds(text: str) -> tuple[float, float, int]:
    try:
        low, high, count = text.split(":")
        values = float(low), float(high), int(count)
    except ValueError:
        values = (0.0, 0.0, 0)
    if not (0.0 < values[0] <= values[1] <= 2e5 and 1 <= values[2] <= 100_000):
        raise argparse.ArgumentTypeError(f"{text!r} is not LOW:HIGH:COUNT with speeds from 0 to 200000 rpm")
    return values


def run(args) -> None:
    import numpy as np

    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.studies.lobes import lobes

    cell = read_cell(find_file(args.cell), args.set)
    if args.along:
        _along(args, cell)
        return
    nominal = cell.tool.spindle_speed * 30.0 / np.pi
    low, high, count = args.speeds or (0.5 * nominal, 1.5 * nominal, COUNT)
    with progress("stability") as report:
        found = lobes(cell, (np.linspace(low, high, count) * np.pi / 30.0).tolist(), not args.no_arm, progress=report)
    rows = [lobe.as_dict() for lobe in found]
    best = max(rows, key=lambda r: r["depth_limit_mm"])
    said = f"deepest stable cut: {_depth(best['depth_limit_mm'])} mm at {best['spindle_speed_rpm']:.0f} rpm"
    files = _write(args, cell, rows, said) if args.out else []
    if args.json:
        engaged = {"radial_immersion": cell.path.radial_immersion, "mode": cell.path.mode}
        print_json({"cell": args.cell, "arm": not args.no_arm, **engaged, "lobes": rows, "files": files})
        return
    every = max(1, -(-len(rows) // SHOWN))
    shown = [[f"{r['spindle_speed_rpm']:.0f}", _depth(r["depth_limit_mm"]), fixed(r["chatter_hz"], 1)] for r in rows]
    print_table("Stability lobes", ["spindle speed [rpm]", "limit depth [mm]", "chatter [Hz]"], shown[::every])
    print(said)
    for name in files:
        print(name)


def _along(args, cell) -> None:
    from kr270_milling.studies.feature_limits import feature_limits

    rows = [one.as_dict() for one in feature_limits(cell, not args.no_arm)]
    if args.json:
        print_json({"cell": args.cell, "arm": not args.no_arm, "features": rows})
        return
    columns = ["feature", "deepest cut [mm]", "limit [mm]", "chatter [Hz]", "stable"]
    shown = [[r["feature"], fixed(r["depth_mm"], 3), _depth(r["depth_limit_mm"]), fixed(r["chatter_hz"], 1),
              "yes" if r["stable"] else "no"] for r in rows]  # fmt: skip
    print_table(f"Limit depth along the path at {rows[0]['spindle_speed_rpm']:.0f} rpm", columns, shown)


def _depth(value: float) -> str:
    return "above 100" if value == float("inf") else f"{value:.3f}"


def _write(args, cell, rows: list[dict], said: str) -> list[str]:
    """Table and picture."""
    from kr270_milling.base.files import staged
    from kr270_milling.identification.figures import points, write_page

    speeds = [row["spindle_speed_rpm"] for row in rows]
    limit, chatter = ([row[name] for row in rows] for name in ("depth_limit_mm", "chatter_hz"))
    own = [cell.tool.spindle_speed * 30.0 / math.pi], [1e3 * cell.path.depth_of_cut]
    lines = {"limit depth": (speeds, limit), **({"the cell": own} if cell.path.depth_of_cut else {})}
    figures = [
        points("Below the line the cut is stable", "spindle speed [rpm]", "depth of cut [mm]", lines, ("limit depth",)),
        points("Chatter at the limit", "spindle speed [rpm]", "frequency [Hz]", {"chatter": (speeds, chatter)}),
    ]
    figures[0].update_yaxes(rangemode="tozero")
    with staged(args.out) as (draft, final):
        table = draft / "lobes.csv"
        text = [",".join(repr(float(value)) for value in row.values()) for row in rows]
        table.write_text("\n".join([",".join(rows[0]), *text]) + "\n", encoding="utf-8")
        page = write_page(draft / "lobes.html", f"Stability lobes of {args.cell}", [said], [], figures)
        return [str(final(table)), str(final(page))]
