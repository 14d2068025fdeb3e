"""Identified force coefficients as sentences, JSON, tables, figures and parameter file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kr270_milling.base.column import TextTable, as_dict
from kr270_milling.physics.cutting import LAWS
from kr270_milling.physics.cutting.laws import NAMES, SCALE, Material, spread
from kr270_milling.show.report.identification import Outcome
from kr270_milling.show.report.study_page import COLOURS, points
from kr270_milling.studies.identification.doubts import force_doubts
from kr270_milling.studies.identification.forces import TOWARD_PART, LawFit, law_sections


def force_outcome(fits: list[LawFit], law: str, source: str, left_out: Sequence[int] = ()) -> Outcome:
    """Return the result of ``identify forces``; fits: the linear-edge law first, then the others.

    law: of the parameter file; source: name of the file with the cuts; left_out: numbers of cuts that are not fitted.
    """
    doubts = force_doubts(fits, law)
    edge, *others = fits
    result = as_dict(edge) | {
        "axial_force": "toward the part" if edge.axial == TOWARD_PART else "into the holder",
        "residual_rms_n": edge.residual_rms,
        "residuals_n": edge.residuals.tolist(),
        "cuts": len(edge.cuts),
        "left_out": list(left_out),
        "doubts": [doubt.text for doubt in doubts],
        "usable": not any(doubt.forbids for doubt in doubts),
    }
    result |= {fit.law: {**as_dict(fit), "residual_rms_n": fit.residual_rms} for fit in others}
    chosen = {fit.law: fit for fit in fits}[law]
    sections = law_sections(chosen.law, chosen.values, chosen.half_widths, chosen.axial)
    title = f"Force coefficients from {len(edge.cuts)} cuts, {source}"
    use = "name this file in `includes`, and take `cutting` out of the cell"
    tables = [_table(fit) for fit in fits]
    texts = [doubt.text for doubt in doubts] + _sentences(*fits)
    if left_out:
        texts.insert(0, "cuts that contradict the others are left out: " + ", ".join(map(str, left_out)))
    refused = not result["usable"]
    return Outcome("forces", title, result, tables, texts, lambda: _figures(fits), sections, use, refused)


def material_outcome(rows: list[Material], name: str | None, row: Material | None) -> Outcome:
    """Return published coefficients; name: of the one material that was asked for; row: of the parameter file."""
    title = "Linear-edge law [N/mm2, N/mm]"
    entries = [
        {"material": m.name, "cutter": m.cutter, "lubrication": m.lubrication, "source": m.source}
        | dict(zip(NAMES, (m.values / SCALE).tolist(), strict=True))
        for m in rows
    ]
    sections = None if row is None else law_sections("linear_edge", row.values, np.full(6, np.nan))
    if sections is not None and (scatter := spread(name or "")):
        reason = f"K_tc of the published rows of {name} scatters by {100 * scatter:.0f} %"
        sections["uncertainty"] = {"force_coefficient": (round(scatter, 3), reason)}
    columns = ["material", "cutter", *(key.split("_n_")[0] for key in NAMES)]
    texts = [[m.name, m.cutter, *("-" if np.isnan(v) else f"{v:g}" for v in m.values / SCALE)] for m in rows]
    sources = [f"{m.name}, {m.cutter}, {m.lubrication} [source: {m.source}]" for m in rows] if name else []
    stem = (name or "").lower().replace(".", "_")
    table = TextTable(title, columns, texts)
    return Outcome(stem, title, {"materials": entries}, [table], sources, sections=sections)


def _table(fit: LawFit) -> TextTable:
    values = as_dict(fit)
    rows = [
        [key, *("-" if np.isnan(v) else f"{v:.{d}g}" for v, d in ((values[key], 5), (width, 3)))]
        for key, width in values["ci95"].items()
    ]
    title = f"{fit.law.replace('_', '-').capitalize()} law, residual {fit.residual_rms:.3g} N RMS"
    return TextTable(title, ["coefficient", "value", "95 % +-"], rows)


def _sentences(edge: LawFit, *others: LawFit) -> list[str]:
    """Notes that explain the numbers."""
    sentences = []
    if np.isnan(edge.values[4]):
        sentences.append("K_ac and K_ae: fz_n was not measured")
    elif edge.axial != TOWARD_PART:
        sentences.append("the axial force pushes the tool into its holder: its sign in the YAML file is minus")
    for key, value, width in zip(NAMES, edge.values / SCALE, edge.half_widths / SCALE, strict=True):
        name = key.split("_n_")[0] + (" of the linear-edge law" if others else "")
        if width > abs(value):
            sentences.append(f"{name}: the interval includes zero, cut at more feeds or deeper")
        elif value < 0.0:
            sentences.append(f"{name} is negative: look at the signs and at the sense of rotation")
    if others:
        best = min(others, key=lambda other: other.lateral_rms)
        # share of the residual of the linear-edge law below which another law is recommended
        better = best if best.lateral_rms < 0.9 * edge.lateral_rms else edge
        residuals = ", ".join(f"{fit.lateral_rms:.3g} N ({fit.law.replace('_', ' ')})" for fit in (edge, *others))
        sentences.append(f"residual of F_x and F_y {residuals}: use the {better.law.replace('_', '-')} law")
    return sentences


def _figures(fits: list[LawFit]) -> list:
    """Forces and models over the feed, residuals; a colour for each component, a symbol for each law."""
    cuts = fits[0].cuts
    feed, per_depth = 1e3 * cuts.feed_per_tooth, 1e-3 / cuts.depth[:, None]
    names = [fit.law.replace("_", " ") for fit in fits]
    forces = {"measured": cuts.force} | {law: fit.modelled for law, fit in zip(names, fits, strict=True)}

    def by_component(rows_of_laws: dict) -> dict:
        return {
            f"F_{axis} {law}": (feed, column)
            for law, rows in rows_of_laws.items()
            for axis, column in zip("xyz", rows.T, strict=True)
        }

    mean = by_component({law: rows * per_depth for law, rows in forces.items()})
    residuals = by_component({law: fit.residuals for law, fit in zip(names, fits, strict=True)})
    symbols = {"measured": "circle-open"} | {law: LAWS[fit.law].symbol for law, fit in zip(names, fits, strict=True)}
    style = {
        f"F_{axis} {law}": (colour, symbols[law])
        for law in forces
        for axis, colour in {"x": COLOURS[1], "y": COLOURS[2], "z": COLOURS[3]}.items()
    }
    return [
        points("Mean forces over the feed", "feed per tooth [mm]", "mean per mm of depth [N]", mean, (), style),
        points("Residuals", "feed per tooth [mm]", "measured less modelled [N]", residuals, (), style),
    ]
