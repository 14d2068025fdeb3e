"""``kr270_milling identify material``: published force coefficients, as a table or as a file to include."""

from __future__ import annotations

from kr270_milling.commands.console import add_common
from kr270_milling.commands.identified import Outcome, Table, report


def add_arguments(parser) -> None:
    parser.add_argument("name", metavar="NAME", nargs="?", help="of a material; without it all are listed")
    parser.add_argument("--row", type=int, default=1, help="which, where a material has several (default: 1)")
    parser.add_argument("--out", metavar="DIR", help="write YAML to include")
    add_common(parser)


def run(args) -> None:
    import numpy as np

    from kr270_milling.base.errors import InputError
    from kr270_milling.identification.force_result import linear_edge_sections
    from kr270_milling.identification.forces import NAMES, SCALE
    from kr270_milling.identification.materials import find_material, materials

    rows = find_material(args.name) if args.name else materials()
    entries = [
        {"material": m.name, "cutter": m.cutter, "lubrication": m.lubrication, "source": m.source}
        | dict(zip(NAMES, (m.values / SCALE).tolist(), strict=True))
        for m in rows
    ]
    sections = None
    if args.out:
        if not args.name or not 1 <= args.row <= len(rows):
            raise InputError("--out", f"needs one material, and a --row from 1 to {len(rows)}")
        sections = linear_edge_sections(rows[args.row - 1].values, np.full(6, np.nan))
    columns = ["material", "cutter", *(name.split("_n_")[0] for name in NAMES)]
    shown = [[m.name, m.cutter, *("-" if np.isnan(v) else f"{v:g}" for v in m.values / SCALE)] for m in rows]
    sources = [f"{m.name}, {m.cutter}, {m.lubrication} [source: {m.source}]" for m in rows] if args.name else []
    name = (args.name or "").lower().replace(".", "_")
    outcome = Outcome(name, "Linear-edge law [N/mm2, N/mm]", {"materials": entries},
                      [Table("Linear-edge law [N/mm2, N/mm]", columns, shown)], sources)  # fmt: skip
    report(args, outcome, sections=sections)
