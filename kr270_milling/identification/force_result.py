"""What ``identify forces`` says: numbers for JSON, sentences, a parameter file to include, pictures."""

from __future__ import annotations

import numpy as np

from kr270_milling.base.record import specs
from kr270_milling.cutting.laws import FractionalLaw, LinearEdgeLaw
from kr270_milling.decision.samples import AXIAL, SCATTERED
from kr270_milling.identification.forces import (
    NAMES,
    SCALE,
    TOWARD_PART,
    Coefficients,
    FractionalFit,
    fractional_mean_forces,
    mean_forces,
)
from kr270_milling.identification.outcome import Outcome, points

__all__ = ["force_outcome", "linear_edge_sections"]

#: names of the record in the order of NAMES; the axial ones where the law has them
FIELDS = ("tangential_cutting", "tangential_edge", "radial_cutting", "radial_edge", "axial_cutting", "axial_edge")
COLOURS = {"x": "#1f77b4", "y": "#d62728", "z": "#2ca02c"}
SYMBOLS = {"measured": "circle-open", "linear edge": "line-ew-open", "fractional": "x-thin-open"}


def force_outcome(found: Coefficients, bent: FractionalFit | None, law: str, source: str) -> Outcome:
    """Everything that ``identify forces`` says; law: of the parameter file; source: name of the file with the cuts."""
    result = _as_dict(found, bent)
    tables = [_table(f"Linear-edge law, residual {found.residual_rms:.3g} N RMS", result)]
    sections = linear_edge_sections(found.values, found.half_widths, found.axial)
    if bent is not None:
        tables.append(_table(f"Fractional law, residual {bent.residual_rms:.3g} N RMS", result["fractional"]))
        if law == "fractional":
            sections = _fractional_sections(bent)
    title = f"Force coefficients from {len(found.cuts)} cuts, {source}"
    use = "name this file in `includes`, and take `cutting` out of the cell"
    said = _sentences(found, bent)
    return Outcome("forces", title, result, tables, said, lambda: _figures(found, bent), sections, use)


def _table(title: str, result: dict) -> tuple[str, list[str], list[list[str]]]:
    rows = [[key, *("-" if np.isnan(v) else f"{v:.{d}g}" for v, d in ((result[key], 5), (width, 3)))]
            for key, width in result["ci95"].items()]  # fmt: skip
    return title, ["coefficient", "value", "95 % +-"], rows


def _as_dict(found: Coefficients, bent: FractionalFit | None) -> dict:
    """For JSON; what was not measured becomes null there."""
    report: dict = dict(zip(NAMES, (found.values / SCALE).tolist(), strict=True))
    report["ci95"] = dict(zip(NAMES, (found.half_widths / SCALE).tolist(), strict=True))
    report["axial_force"] = "toward the part" if found.axial == TOWARD_PART else "into the holder"
    report |= {"residual_rms_n": found.residual_rms, "residuals_n": found.residuals.tolist(), "cuts": len(found.cuts)}
    if bent is not None:
        report["fractional"] = {**bent.as_dict(), "residual_rms_n": bent.residual_rms}
    return report


def _sentences(found: Coefficients, bent: FractionalFit | None) -> list[str]:
    """What the numbers mean."""
    said = []
    if np.isnan(found.values[4]):
        said.append("K_ac and K_ae: fz_n was not measured")
    elif found.axial != TOWARD_PART:
        said.append("the axial force pushes the tool into its holder: the YAML file has it with a minus")
    for name, value, width in zip(NAMES, found.values / SCALE, found.half_widths / SCALE, strict=True):
        if width > abs(value):
            said.append(f"{name.split('_n_')[0]}: the interval reaches beyond zero, cut at more feeds or deeper")
        elif value < 0.0:
            said.append(f"{name.split('_n_')[0]} is negative: look at the signs and at the sense of rotation")
    if bent is not None:
        lateral = float(np.sqrt(np.nanmean(found.residuals[:, :2] ** 2)))
        better = "the fractional law" if bent.residual_rms < 0.9 * lateral else "the linear-edge law"
        said.append(f"residual {lateral:.3g} N (linear edge), {bent.residual_rms:.3g} N (fractional): use {better}")
    return said


def linear_edge_sections(values, half_widths, axial: float = TOWARD_PART) -> dict:
    """The groups of a parameter file: the law with its coefficients, and how well they are known for the verdict."""
    by_name = {spec.name: spec for spec in specs(LinearEdgeLaw)}
    given = [(field, k) for k, field in enumerate(FIELDS) if field in by_name and np.isfinite(values[k])]
    law: dict = {}
    for field, k in given:
        known = f"95 % +- {half_widths[k] / by_name[field].scale:.3g}" if np.isfinite(half_widths[k]) else ""
        value = max(values[k], 0.0) if k < 4 else values[k] * axial / TOWARD_PART
        law[by_name[field].key] = (float(value / by_name[field].scale), known)
    sections: dict = {"cutting": {"law": "linear_edge", "linear_edge": law}}
    relative = {field: half_widths[k] / 1.96 / max(abs(values[k]), 1e-300) for field, k in given}
    return sections | _spread("linear_edge", relative)


def _fractional_sections(found: FractionalFit) -> dict:
    """The same of the fractional law."""
    rows = zip(specs(FractionalLaw), found.values, found.half_widths, strict=True)
    each = [(s, v, w) for s, v, w in rows if np.isfinite(v)]
    law = {s.key: (float(v / s.scale), f"95 % +- {w / s.scale:.3g}") for s, v, w in each}
    relative = {s.name: w / 1.96 / v for s, v, w in each}
    return {"cutting": {"law": "fractional", "fractional": law}} | _spread("fractional", relative)


def _spread(law: str, relative: dict[str, float]) -> dict:
    """``uncertainty.force_coefficients`` from the relative deviations by name, if all that the verdict draws are known.

    Those of the axial force follow where they were measured.
    """
    names = [*SCATTERED[law], *(AXIAL[law] if set(AXIAL[law]) <= set(relative) else ())]
    known = np.array([relative.get(name, np.nan) for name in names])
    if not np.isfinite(known).all():
        return {}
    shown = np.clip(known, 1e-4, 1.0).tolist()
    return {"uncertainty": {"force_coefficients": (shown, "standard deviations from the same fit")}}


def _figures(found: Coefficients, bent: FractionalFit | None) -> list:
    """Forces and models over the feed, residuals; a colour a component, a symbol a law."""
    cuts = found.cuts
    feed, per_depth = 1e3 * cuts.feed_per_tooth, 1e-3 / cuts.depth
    sources = {"measured": cuts.force, "linear edge": mean_forces(cuts, found.values, found.axial)}
    left = {"linear edge": found.residuals}
    if bent is not None:
        sources["fractional"] = fractional_mean_forces(cuts, bent.values)
        left["fractional"] = bent.residuals
    shown, residuals, style = {}, {}, {}
    for law, rows in sources.items():
        for axis, column in zip("xyz", rows.T, strict=False):
            shown[f"F_{axis} {law}"] = (feed, column * per_depth)
            style[f"F_{axis} {law}"] = (COLOURS[axis], SYMBOLS[law])
    for law, rows in left.items():
        for axis, column in zip("xyz", rows.T, strict=False):
            residuals[f"F_{axis} {law}"] = (feed, column)
    return [
        points("Mean forces over the feed", "feed per tooth [mm]", "mean per mm of depth [N]", shown, (), style),
        points("Residuals", "feed per tooth [mm]", "measured less modelled [N]", residuals, (), style),
    ]
