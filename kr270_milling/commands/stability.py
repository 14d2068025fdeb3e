"""``kr270_milling stability``: limit depth of cut and chatter frequency over spindle speed."""

from __future__ import annotations

import math

from kr270_milling.commands.console import Answer, Table, fixed
from kr270_milling.commands.options import add_cell, cell_of, option
from kr270_milling.commands.progress import progress
from kr270_milling.nodes.option_types import grid

COUNT = 60  #: speeds without --speeds
SHOWN = 24  #: rows of the printed table


def add_arguments(parser) -> None:
    add_cell(parser)
    speeds = f"spindle speeds [rpm] (default: {COUNT} from half to one and a half times that of the cell)"
    option(parser, "--speeds LOW:HIGH:COUNT", speeds, grid(1.0, 2e5, 100_000))
    option(parser, "--no-arm", "leave out the arm: the modes of tool.modes alone", bool)
    option(parser, "--along", "instead of lobes: the limit depth of each feature of the path", bool)
    option(parser, "--out DIR", "write lobes.csv and the picture lobes.html here")
    parser.epilog += (
        "\nkeys: path.radial_immersion (share of the diameter) and path.mode (slot, up, down) say how the tool is "
        "engaged, tool.modes what of tool and spindle vibrates"
    )


def run(args) -> Answer:
    import numpy as np

    from kr270_milling.studies.lobes import lobes

    cell = cell_of(args)
    if args.along:
        return _along(args, cell)
    nominal = cell.tool.spindle_speed * 30.0 / np.pi
    low, high, count = args.speeds or (0.5 * nominal, 1.5 * nominal, COUNT)
    with progress("stability") as report:
        found = lobes(cell, (np.linspace(low, high, count) * np.pi / 30.0).tolist(), not args.no_arm, progress=report)
    rows = [lobe.as_dict() for lobe in found]
    best = max(rows, key=lambda r: r["depth_limit_mm"])
    said = f"deepest stable cut: {_depth(best['depth_limit_mm'])} mm at {best['spindle_speed_rpm']:.0f} rpm"
    files = _write(args, cell, rows, said) if args.out else []
    shown = [[f"{r['spindle_speed_rpm']:.0f}", _depth(r["depth_limit_mm"]), fixed(r["chatter_hz"], 1)]
             for r in rows[:: max(1, -(-len(rows) // SHOWN))]]  # fmt: skip
    table = Table("Stability lobes", ["spindle speed [rpm]", "limit depth [mm]", "chatter [Hz]"], shown)
    engaged = {"radial_immersion": cell.path.radial_immersion, "mode": cell.path.mode}
    about = {"cell": args.cell, "arm": not args.no_arm, **engaged, "lobes": rows, "files": files}
    return Answer(about, [table, said, *files])


def _along(args, cell) -> Answer:
    from kr270_milling.studies.lobes import feature_limits

    rows = [one.as_dict() for one in feature_limits(cell, not args.no_arm)]
    columns = ["feature", "deepest cut [mm]", "limit [mm]", "chatter [Hz]", "stable"]
    shown = [[r["feature"], fixed(r["depth_mm"], 3), _depth(r["depth_limit_mm"]), fixed(r["chatter_hz"], 1),
              "yes" if r["stable"] else "no"] for r in rows]  # fmt: skip
    title = f"Limit depth along the path at {rows[0]['spindle_speed_rpm']:.0f} rpm"
    about = {"cell": args.cell, "arm": not args.no_arm, "features": rows}
    return Answer(about, [Table(title, columns, shown)])


def _depth(value: float) -> str:
    return "above 100" if value == float("inf") else f"{value:.3f}"


def _write(args, cell, rows: list[dict], said: str) -> list[str]:
    """Table and picture."""
    from kr270_milling.base.files import staged
    from kr270_milling.identification.outcome import points, write_page

    speeds = [row["spindle_speed_rpm"] for row in rows]
    limit, chatter = ([row[name] for row in rows] for name in ("depth_limit_mm", "chatter_hz"))
    own = [cell.tool.spindle_speed * 30.0 / math.pi], [1e3 * cell.path.depth_of_cut]
    lines = {"limit depth": (speeds, limit), **({"the cell": own} if cell.path.depth_of_cut else {})}
    figures = [
        points("Below the line the cut is stable", "spindle speed [rpm]", "depth of cut [mm]", lines, ("limit depth",)),
        points("Chatter at the limit", "spindle speed [rpm]", "frequency [Hz]", {"chatter": (speeds, chatter)}),
    ]
    figures[0].update_yaxes(rangemode="tozero")
    figures = figures[: 1 + any(map(math.isfinite, chatter))]  # none chatters: there is no frequency to show
    for figure in figures:  # one above the other
        figure.update_xaxes(range=[min(*speeds, *own[0]), max(*speeds, *own[0])])
    with staged(args.out) as (draft, final):
        table = draft / "lobes.csv"
        text = [",".join(repr(float(value)) for value in row.values()) for row in rows]
        table.write_text("\n".join([",".join(rows[0]), *text]) + "\n", encoding="utf-8")
        page = write_page(draft / "lobes.html", f"Stability lobes of {args.cell}", [said], [], figures)
        return [str(final(table)), str(final(page))]
