"""``kr270_milling identify material``: published force coefficients, as a table or as a file to include."""

from __future__ import annotations

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import option

TITLE = "Linear-edge law [N/mm2, N/mm]"


def add_arguments(parser) -> None:
    option(parser, "name NAME", "of a material; without it all are listed", nargs="?")
    option(parser, "--row", "which, where a material has several", int, 1)
    option(parser, "--out DIR", "write YAML to include")


def run(args) -> Answer:
    import numpy as np

    from kr270_milling.base.errors import InputError
    from kr270_milling.commands.identify import identified
    from kr270_milling.identification.forces import NAMES, SCALE, find_material, law_sections, materials
    from kr270_milling.identification.outcome import Outcome

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
        sections = law_sections("linear_edge", rows[args.row - 1].values, np.full(6, np.nan))
    columns = ["material", "cutter", *(name.split("_n_")[0] for name in NAMES)]
    shown = [[m.name, m.cutter, *("-" if np.isnan(v) else f"{v:g}" for v in m.values / SCALE)] for m in rows]
    sources = [f"{m.name}, {m.cutter}, {m.lubrication} [source: {m.source}]" for m in rows] if args.name else []
    name = (args.name or "").lower().replace(".", "_")
    found = {"materials": entries}
    return identified(args, Outcome(name, TITLE, found, [(TITLE, columns, shown)], sources, sections=sections))
