"""``kr270_milling stability``: limit depth of cut and chatter frequency over spindle speed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from kr270_milling.base.column import as_dict, columns_of, table_of
from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import path_of
from kr270_milling.decide.stability import FeatureLimit, feature_limits, modes_of
from kr270_milling.physics.motion.stability import Lobe
from kr270_milling.show.commands.console import Answer
from kr270_milling.show.commands.progress import progress
from kr270_milling.show.report.lobes_page import write_lobes
from kr270_milling.studies.maps.lobes import engagement_text, lobes

SHOWN = 24  #: rows of the printed table
OTHERS = (
    "the path itself: check and --along take the engagement, feed direction and posture of each feature, so that their "
    "limits differ from the lobes"
)


def _rigid(cell) -> str:
    """Return the words about a limit without ``tool.modes``."""
    return "" if cell.tool.modes.frequency.size else ", with tool and spindle taken as rigid (no tool.modes)"


def run_stability(args) -> Answer:

    cell = read_cell(find_file(args.cell), args.set)
    about = {"cell": args.cell, "arm": not args.no_arm}
    if args.along:
        rows = list(map(as_dict, feature_limits(cell, not args.no_arm)))
        rpm = cell.tool.spindle_speed * 30.0 / math.pi
        title = f"Limit depth along the path, as in check, at {rpm:.0f} rpm{_rigid(cell)}"
        *engagement, stable = columns_of(FeatureLimit)
        columns = *engagement, *columns_of(Lobe)[1:], stable
        return Answer(about | {"features": rows}, [table_of(title, columns, rows)])
    nominal = cell.tool.spindle_speed * 30.0 / math.pi
    low, high, count = args.speeds or (0.5 * nominal, 1.5 * nominal, 60)
    with progress("stability") as report:
        speeds = (np.linspace(low, high, count) * np.pi / 30.0).tolist()
        results = lobes(path_of(cell), cell.cutting, modes_of(cell, not args.no_arm), speeds, report)
    rows = list(map(as_dict, results))
    (_, speed, speed_text), (_, depth, depth_text), _ = shown = columns_of(Lobe)
    best = max(rows, key=lambda row: row[depth])
    summary = f"deepest stable cut: {depth_text(best[depth])} mm at {speed_text(best[speed])} rpm{_rigid(cell)}"
    files = _write(args, cell, rows, summary) if args.out else []
    about |= {"radial_immersion": cell.path.radial_immersion, "mode": cell.path.mode, "lobes": rows, "files": files}
    cut = engagement_text(cell.path)
    title = f"Stability lobes of {cut} (path.radial_immersion, path.mode) at the start of the path"
    table = table_of(title, shown, rows[:: max(1, -(-len(rows) // SHOWN))])
    return Answer(about, [table, summary, OTHERS, *files])


def _write(args, cell, rows: list[dict], summary: str) -> list[str]:
    """Write table and page; return their paths."""
    with staged(args.out) as (draft, final):
        table = draft / "lobes.csv"
        text = [",".join(repr(float(value)) for value in row.values()) for row in rows]
        table.write_text("\n".join([",".join(rows[0]), *text]) + "\n", encoding="utf-8")
        page = write_lobes(
            draft, cell, Path(args.cell).name, rows, summary, arm=not args.no_arm, self_contained=args.self_contained
        )
        return [str(final(table)), str(final(page))]
