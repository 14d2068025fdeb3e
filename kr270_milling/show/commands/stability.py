"""``kr270_milling stability``: limit depth of cut and chatter frequency over spindle speed."""

from __future__ import annotations

import math
from pathlib import Path

from kr270_milling.base.arguments import grid
from kr270_milling.base.column import as_dict, columns_of, table_of
from kr270_milling.base.files import staged
from kr270_milling.show.commands.command import CELL, SELF_CONTAINED, command, option
from kr270_milling.show.commands.console import Answer, cell_of
from kr270_milling.show.commands.progress import progress

LOBE_SPEEDS = 60
SHOWN = 24  #: rows of the printed table
OTHERS = (
    "the path itself: check and --along take the engagement, feed direction and posture of each feature, so that their "
    "limits differ from the lobes"
)


def _rigid(cell) -> str:
    """What a limit without ``tool.modes`` leaves out."""
    return "" if cell.tool.modes.frequency.size else ", with tool and spindle taken as rigid (no tool.modes)"


COMMANDS = {
    "stability": command(
        "stability.run_stability", "stability config/paper.yaml --speeds 4000:12000/100",
        *CELL,
        option(
            "--speeds LOW:HIGH/COUNT",
            f"spindle speeds [rpm] (default: {LOBE_SPEEDS} from half to one and a half times that of the cell)",
            grid(1.0, 2e5, 100_000),
        ),
        option("--no-arm", "leave out the arm: the modes of tool.modes alone", bool),
        option("--along", "instead of lobes: the limit depth of each feature of the path", bool),
        option("--out DIR", "write lobes.csv and the picture lobes.html here"),
        SELF_CONTAINED,
        note="keys: path.radial_immersion (share of the diameter) and path.mode (slot, up, down) state the engagement, "
        "tool.modes the vibration of tool and spindle",
    ),
}  # fmt: skip


def run_stability(args) -> Answer:
    import numpy as np

    from kr270_milling.decide.stability import FeatureLimit, feature_limits
    from kr270_milling.physics.motion.stability import Lobe
    from kr270_milling.studies.maps.lobes import engagement_text, lobes

    cell = cell_of(args)
    about = {"cell": args.cell, "arm": not args.no_arm}
    if args.along:
        rows = list(map(as_dict, feature_limits(cell, not args.no_arm)))
        rpm = cell.tool.spindle_speed * 30.0 / math.pi
        title = f"Limit depth along the path, as in check, at {rpm:.0f} rpm{_rigid(cell)}"
        *engagement, stable = columns_of(FeatureLimit)
        columns = *engagement, *columns_of(Lobe)[1:], stable
        return Answer(about | {"features": rows}, [table_of(title, columns, rows)])
    nominal = cell.tool.spindle_speed * 30.0 / math.pi
    low, high, count = args.speeds or (0.5 * nominal, 1.5 * nominal, LOBE_SPEEDS)
    with progress("stability") as report:
        results = lobes(cell, (np.linspace(low, high, count) * np.pi / 30.0).tolist(), not args.no_arm, progress=report)
    rows = list(map(as_dict, results))
    (_, speed, speed_text), (_, depth, depth_text), _ = shown = columns_of(Lobe)
    best = max(rows, key=lambda row: row[depth])
    summary = f"deepest stable cut: {depth_text(best[depth])} mm at {speed_text(best[speed])} rpm{_rigid(cell)}"
    files = _write(args, cell, rows, summary) if args.out else []
    about |= {"radial_immersion": cell.path.radial_immersion, "mode": cell.path.mode, "lobes": rows, "files": files}
    title = f"Stability lobes of {engagement_text(cell)} (path.radial_immersion, path.mode) at the start of the path"
    table = table_of(title, shown, rows[:: max(1, -(-len(rows) // SHOWN))])
    return Answer(about, [table, summary, OTHERS, *files])


def _write(args, cell, rows: list[dict], summary: str) -> list[str]:
    """Table and page."""
    from kr270_milling.show.report.lobes_page import write_lobes

    with staged(args.out) as (draft, final):
        table = draft / "lobes.csv"
        text = [",".join(repr(float(value)) for value in row.values()) for row in rows]
        table.write_text("\n".join([",".join(rows[0]), *text]) + "\n", encoding="utf-8")
        page = write_lobes(draft, cell, Path(args.cell).name, rows, summary, arm=not args.no_arm,
                           self_contained=args.self_contained)  # fmt: skip
        return [str(final(table)), str(final(page))]
