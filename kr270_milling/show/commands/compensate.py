"""``kr270_milling compensate``: the revised trajectory of a cell, what it is predicted to achieve, and the programs.

Exit code 1 where the check finds that the revised path must not be run; then no program is written, unless by force.
"""

from __future__ import annotations

import dataclasses
import sys

import numpy as np

from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.jobs import joint_ranges
from kr270_milling.decide.compensation import VerdictOrder, compensate, limit_sentence
from kr270_milling.decide.part import write_part
from kr270_milling.decide.programs.files import time_law, write_programs
from kr270_milling.decide.programs.written import SOFTER, softer_pass
from kr270_milling.physics.compensation.methods import METHODS
from kr270_milling.physics.compensation.revision import chord_error
from kr270_milling.show.commands.console import (
    Answer,
    Table,
    cell_of,
    command_line,
    fixed,
    joints_text,
    now,
    plant_of,
    table_of,
    um,
)
from kr270_milling.show.commands.options import FEWEST_PLANTS, PLANTS
from kr270_milling.show.commands.progress import progress
from kr270_milling.show.report import ReportTable, decision_block, write_report

DEVIATIONS = (("pass", "name", 2), ("static", "static_deviation_mm", um), ("max", "max_deviation_mm", um))


def run(args) -> Answer:
    source, cell = find_file(args.cell), cell_of(args)
    method = args.method or cell.compensation.method
    motions = args.krl or [cell.program.motion if METHODS[method].smooth else "LIN"]
    plant = plant_of(args, cell)
    with staged(args.out) as (draft, final):
        motion = "LIN" if "LIN" in motions else motions[0]  # these are blended
        done = compensate(cell, method, plant=plant, motion=motion, verdict=_order(args), progress=progress)
        if not (done.decision.verdict or args.no_verdict):
            print(f"no verdict: {FEWEST_PLANTS} plants would take too long; --verdict runs them", file=sys.stderr)
        found = _found(cell, done)
        found |= _write(draft, final, cell, done, motions, args, source)
    return Answer(found, _shown(cell, done, found, args), code=int(not done.checked.may_be_run))


def _order(args):
    """The verdict that is wanted; None for none."""
    if args.no_verdict:
        return None
    samples = args.verdict or (FEWEST_PLANTS if args.quick else PLANTS)
    return VerdictOrder(samples, args.verdict is not None, not args.quick, args.seed, _estimate)


def _estimate(plants: int, seconds: float) -> None:
    """What is to come, where it takes a while."""
    if seconds > 5.0:
        print(f"verdict: {plants} plants, about {seconds:.0f} s", file=sys.stderr)


def _found(cell, done) -> dict:
    """What ``--json`` prints, but for the files."""
    original, revised = done.original, done.revised
    found = {"method": revised.name, "points": len(revised.reference)}
    found |= {k: v for k, v in revised.row().items() if k != "name"}
    found["commanded_joints_deg"] = joint_ranges(cell, revised.reference)
    found["planned_max_deviation_mm"] = 1e3 * done.planned.scores.max_deviation
    found["time_law"] = time_law(cell)
    found["original"] = {k: v for k, v in original.row().items() if k != "name"}
    found["passes"] = [ran.row() for ran in (original, revised)]
    found |= _correction(cell, revised, done.by)
    found["features"] = {part.name: part.table() for part in done.parts}
    found["check"] = done.checked.as_dict()
    found["verdict"] = done.decision.verdict and done.decision.verdict.as_dict()
    found["decision"] = done.decision.as_dict()
    return found


def _first_line(done) -> str:
    """The decision; ahead of it, where the method makes the part worse, that it does."""
    before, after = done.decision.as_programmed.error, done.decision.compensated.error
    if after <= before:
        return done.decision.headline
    errors = f"({1e6 * after:.3g} um against {1e6 * before:.3g})"
    return f"{done.revised.name} makes the part worse than no compensation {errors}: {done.decision.headline}"


def _correction(cell, revised, by) -> dict:
    """How large the correction is, and what of it was not let through."""
    size = np.linalg.norm(revised.reference.position - cell.target().position, axis=1)
    limited = [dataclasses.asdict(part) | {"sentence": limit_sentence(part, by)} for part in by.limited]
    found = {"largest_correction_mm": 1e3 * float(size.max()), "limited": limited}
    if by.errors[1:]:
        found["remaining_errors_mm"] = [1e3 * error for error in by.errors]
    found["identified"] = by.identified and by.identified.as_dict()
    found["note"] = by.note or None
    if not by.chosen.smooth:
        found["chord_error_mm"] = 1e3 * chord_error(cell.target())
    return found


def _write(draft, final, cell, done, motions, args, source) -> dict:
    """All files; their final paths by kind."""
    date = now()
    checked, revised = done.checked, done.revised
    with progress("files"):
        files = write_programs(
            draft, cell, done.original.reference, revised.reference, method=revised.name, date=date,
            motions=motions if checked.may_be_run or args.force else None, source=cell.programmed.sha256,
            findings=checked.lines(), released=checked.may_be_run,
        )  # fmt: skip
        placed = {"out": args.out, "trajectory": str(final(files.pop("trajectory")[0]))}
        placed["programs"] = {kind: [str(final(path)) for path in paths] for kind, paths in files.items()}
        if done.parts:
            placed |= _write_part(draft, final, cell, done, args, source, date)
    return placed


def _write_part(draft, final, cell, done, args, source, date: str) -> dict:
    """Report with the error maps, and the part as it is predicted."""
    revised = done.revised
    title = f"{cell.programmed.file_name}: before and after compensation ({revised.name})"
    report = write_report(
        draft, cell, (done.original, revised), title=title, source=str(source), command=command_line(args), date=date,
        parts=done.parts, decision=decision_block(done.decision, done.checked),
        tables=[_joints_table(cell, revised), _time_law_table(cell, done)],
    )  # fmt: skip
    stl = draft / f"part_{revised.name}.stl"
    write_part(stl, cell, revised.result)
    return {"report": str(final(report)), "part": str(final(stl))}


def _joints_table(cell, revised):
    """The posture that is commanded, for the report."""
    columns = [
        *joint_ranges(cell, revised.reference).values(),
        *np.degrees([cell.arm.joint_lower, cell.arm.joint_upper]),
    ]
    rows = [(f"A{k}", *(fixed(value) for value in row)) for k, row in enumerate(np.transpose(columns), 1)]
    head = ("axis", "start", "end", "least", "largest", "lower limit", "upper limit")
    return ReportTable("Commanded joints [deg]", head, tuple(rows), f"of the pass '{revised.name}', signs as KUKA's")


def _time_law_table(cell, done) -> ReportTable:
    """Largest deviation of the plan, of the written program, and of its points with a lower acceleration."""
    with progress(f"{SOFTER:g} times the acceleration") as report:
        softer = softer_pass(cell, done.revised.reference, progress=report)
    rows = [("plan", done.planned), ("written program", done.revised)]
    rows += [(f"written program, {SOFTER:g} times the acceleration", softer)] if softer else []
    texts = tuple((name, f"{1e6 * ran.scores.max_deviation:.2f}") for name, ran in rows)
    return ReportTable("Plan and program: largest deviation [um]", ("pass", "max"), texts, time_law(cell))


def _shown(cell, done, found: dict, args):
    """What people read, the decision first."""
    checked = done.checked
    yield _first_line(done)
    if done.parts:
        yield _features(found["features"], found["method"])
    else:
        yield table_of("Predicted path deviation [um]", DEVIATIONS, found["passes"])
    yield (
        f"largest deviation of the written program {1e3 * found['max_deviation_mm']:.3g} um, of the plan "
        f"{1e3 * found['planned_max_deviation_mm']:.3g} um; {found['time_law']}"
    )
    if found["note"]:
        yield found["note"]
    if found["identified"]:
        yield _identified(found["identified"])
    yield joints_text(found["commanded_joints_deg"])
    yield f"largest correction {found['largest_correction_mm']:.4f} mm"
    if "chord_error_mm" in found:
        yield f"LIN chords stand off the programmed path by up to {found['chord_error_mm'] * 1e3:.2f} um"
    yield from checked.lines()
    if found["verdict"]:
        yield from _verdict(found["verdict"])
    yield f"{found['points']} reference points: {found['trajectory']}"
    if not checked.may_be_run:
        yield "programs marked NOT RELEASED" if args.force else "no robot program is written (--force writes one)"
    for kind, paths in found["programs"].items():
        yield f"{kind}: {', '.join(paths[:2])}{f' and {len(paths) - 2} more files' if len(paths) > 2 else ''}"
    yield from (f"{kind}: {found[kind]}" for kind in ("report", "part") if kind in found)


def _identified(found: dict) -> str:
    """What the passes told of the arm, in one line."""
    modes = ", ".join(f"{m['frequency_hz']:.2f} Hz ({100 * m['damping_ratio']:.1f} %)" for m in found["modes"])
    gain, compliance = found["gain"], found["compliance_factor"]
    return f"arm as the passes show it: modes {modes}; gain {gain:.3f}, compliance {compliance:.3f} x the model's"


def _features(features: dict, method: str) -> Table:
    """Before and after, side by side."""
    before, after = ({row["feature"]: row for row in features[name]} for name in ("original", method))
    keys = ("max_normal_um", "mean_normal_um", "max_wall_error_um", "max_floor_error_um")
    rows = []
    for name, row in before.items():
        pairs = [(row[key], after.get(name, {}).get(key, float("nan"))) for key in keys]
        rows.append([name] + [fixed(v, 1) for pair in pairs for v in pair])
    columns = ["feature", "max", "after", "mean", "after", "wall", "after", "floor", "after"]
    title = f"Before and after ({method}) [um]: deviation to the side while cutting, errors that remain"
    return Table(title, columns, rows)


def _verdict(verdict: dict):
    rows = []
    for which in ("original", "compensated"):
        for name in ("max", "static"):
            band = verdict[which][f"{name}_deviation_mm"]
            rows.append([f"{which}, {name}"] + [f"{1e3 * v:.1f}" for v in band])
    title = f"{verdict['samples']} plants, seed {verdict['seed']}: deviation [um]"
    levels = ", ".join(f"{name} {1e3 * band[2]:.1f} um" for name, band in verdict["methods"].items())
    yield Table(title, ["", "5 %", "50 %", "95 %"], rows)
    yield f"verdict: compensation {verdict['verdict']}: {verdict['reason']}"
    yield f"recommended method: {verdict['recommended_method']} (95 % of the plants: {levels})"
