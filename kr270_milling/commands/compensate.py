"""``kr270_milling compensate``: the revised trajectory of a cell, what it is predicted to achieve, and the programs.

Exit code 1 where the check finds that the revised path must not be run; then no program is written, unless by force.
"""

from __future__ import annotations

import sys

from kr270_milling.commands.console import (
    add_cell,
    add_common,
    command_line,
    joints_text,
    print_json,
    print_table,
)  # fmt: skip
from kr270_milling.commands.plant import add_plant, read_plant
from kr270_milling.commands.progress import progress
from kr270_milling.compensation.methods import METHODS
from kr270_milling.nodes.option_types import bounded

SAMPLES, FEWEST = 32, 8  #: plants of the verdict
BUDGET = 300.0  #: [s], of a verdict that is asked for; beyond it fewer plants are run
USUAL_BUDGET = 50.0  #: [s], of one that nobody asks for; where 8 plants take longer it is left out
LONGEST_PASS = USUAL_BUDGET / 2  #: [s]; after a longer one not even a first plant is tried


def add_arguments(parser) -> None:
    add_cell(parser)
    add_plant(parser)
    parser.add_argument("--method", choices=METHODS, help="default: the cell's compensation.method")
    parser.add_argument("--out", metavar="DIR", default="out", help="where everything goes (default: out)")
    parser.add_argument(
        "--krl", choices=("LIN", "SPLINE"), action="append",
        help="motions of the robot programs; may be given twice (default: LIN for the method linear, which corrects "
        "in straight lines, else the cell's program.motion)",
    )  # fmt: skip
    verdict = parser.add_mutually_exclusive_group()
    verdict.add_argument(
        "--verdict", metavar="N", type=bounded(1, 999_999, int), nargs="?", const=SAMPLES,
        help=f"judge the compensation by N plants (default {SAMPLES}) drawn from the cell's uncertainty; by fewer, but "
        f"at least {FEWEST}, where they take more than {BUDGET:.0f} s. Without this option: as many as take "
        f"{USUAL_BUDGET:.0f} s, and none where {FEWEST} take longer",
    )  # fmt: skip
    verdict.add_argument(
        "--quick", action="store_true", help=f"a verdict of {FEWEST} plants, without a look at other methods"
    )
    verdict.add_argument("--no-verdict", action="store_true", help="no verdict: the model itself is what cuts")
    parser.add_argument(
        "--force", action="store_true",
        help="write the programs of a path that must not be run all the same, marked NOT RELEASED in name and header",
    )  # fmt: skip
    parser.add_argument(
        "--seed", metavar="N", type=bounded(1, 999_999, int), default=1, help="of the verdict's plants (default: 1)"
    )
    add_common(parser)


def run(args) -> int:
    from kr270_milling.base.files import staged
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell
    from kr270_milling.cell.jobs import compensated, compensator, joint_ranges, simulate
    from kr270_milling.decision.decision import decide

    source = find_file(args.cell)
    cell = read_cell(source, args.set)
    method = args.method or cell.compensation.method
    motions = args.krl or ["LIN" if method == "linear" else cell.program.motion]
    plant = read_plant(args, cell)
    with staged(args.out) as (draft, final):
        with progress("original") as report:
            original = simulate(cell, progress=report, plant=plant)
        by = compensator(cell, cell.target(), method)
        with progress(method, by.most_passes) as report:
            revised = compensated(cell, original, method, report, by, plant)
        passes = original, revised
        found = {"method": method, "points": len(revised.reference)}
        found |= {k: v for k, v in revised.row().items() if k != "name"}
        found["commanded_joints_deg"] = joint_ranges(cell, revised.reference)
        found["original"] = {k: v for k, v in original.row().items() if k != "name"}
        found["passes"] = [ran.row() for ran in passes]
        found |= _correction(cell, revised, by)
        parts = _parts(cell, passes)
        found["features"] = {part.name: part.table() for part in parts}
        checked = _check(cell, revised, by, motions)
        found["check"] = checked.as_dict()
        verdict = _verdict(cell, original, revised, args)
        found["verdict"] = verdict and verdict.as_dict()
        decision = decide(cell, original, revised, parts, checked, verdict)
        found["decision"] = decision.as_dict()
        found |= _write(draft, final, cell, passes, parts, motions, args, source, checked, decision)
    if args.json:
        print_json(found)
    else:
        print(_first_line(decision, original, revised))
        _print(cell, passes, found, checked, args)
    return 0 if checked.may_be_run else 1


def _first_line(decision, original, revised) -> str:
    """The decision; ahead of it, where the method makes the part worse, that it does."""
    before, after = decision.as_programmed.error, decision.compensated.error
    if after <= before:
        return decision.headline
    worse = (
        f"{revised.name} makes the part worse than no compensation ({1e6 * after:.3g} um against {1e6 * before:.3g})"
    )
    return f"{worse}: {decision.headline}"


def _correction(cell, revised, by) -> dict:
    """How large the correction is, and what of it was not let through."""
    import dataclasses

    import numpy as np

    from kr270_milling.compensation.revision import chord_error

    size = np.linalg.norm(revised.reference.position - cell.target().position, axis=1)
    limited = [dataclasses.asdict(part) | {"sentence": _limit(part, by.learner)} for part in by.limited]
    found = {"largest_correction_mm": 1e3 * float(size.max()), "limited": limited}
    if by.errors[1:]:
        found["remaining_errors_mm"] = [1e3 * error for error in by.errors]
    found["identified"] = by.identified and by.identified.as_dict()
    found["note"] = by.note or None
    if by.method == "linear":
        found["chord_error_mm"] = 1e3 * chord_error(cell.target())
    return found


def _limit(part, learner) -> str:
    """What was not let through and, where most of it is for the arm's own inertia, at which feed it would be."""
    if learner is None or learner.inertia(part.time) < 0.5 * part.wanted:
        return part.sentence
    return f"{part.sentence}; in reach at about {100 * part.feed_share:.0f} % of the programmed feed there"


def _parts(cell, passes) -> tuple:
    """Assessments feature by feature, of a tool path."""
    if not cell.path.file:
        return ()
    from kr270_milling.decision.part import assess_all

    with progress("surfaces"):
        return assess_all(cell, passes)


def _check(cell, revised, by, motions):
    """What ``kr270_milling check`` finds, for LIN motions if there are any: these are blended; and what was limited."""
    from kr270_milling.decision.check import check
    from kr270_milling.decision.path_limits import Violation

    limited = [
        Violation("correction limited", p.worst, p.wanted, p.wanted - p.missing, "warning", _limit(p, by.learner))
        for p in by.limited
    ]
    return check(cell, revised.reference, "LIN" if "LIN" in motions else motions[0], ran=revised, more=limited)


def _verdict(cell, original, revised, args):
    """What plants drawn from the uncertainties say; None where nobody wants it or it would take too long."""
    import numpy as np

    from kr270_milling.decision.verdict import alternatives, monte_carlo

    if args.no_verdict:
        return None
    found = None
    if args.verdict or original.result.wall_time < LONGEST_PASS:
        others = {} if args.quick else alternatives(cell, original, revised.name)
        with progress("verdict") as report:
            found = monte_carlo(
                cell, cell.target(), revised.reference, np.random.default_rng(args.seed),
                args.verdict or (FEWEST if args.quick else SAMPLES), budget=BUDGET if args.verdict else USUAL_BUDGET,
                give_up=not args.verdict, seed=args.seed, progress=report, estimate=_estimate, method=revised.name,
                others=others,
            )  # fmt: skip
    if found is None:
        print(f"no verdict: {FEWEST} plants take more than {USUAL_BUDGET:.0f} s; --verdict runs them", file=sys.stderr)
    return found


def _estimate(plants: int, seconds: float) -> None:
    """What is to come, where it takes a while."""
    if seconds > 5.0:
        print(f"verdict: {plants} plants, about {seconds:.0f} s", file=sys.stderr)


def _write(draft, final, cell, passes, parts, motions, args, source, checked, decision) -> dict:
    """All files; their final paths by kind."""
    import datetime

    from kr270_milling.programs.files import source_hash, write_programs

    date = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    original, revised = passes
    with progress("files"):
        files = write_programs(
            draft, cell, original.reference, revised.reference, method=revised.name, date=date,
            motions=motions if checked.may_be_run or args.force else None, source=source_hash(cell),
            findings=checked.lines(), released=checked.may_be_run,
        )  # fmt: skip
        placed = {"out": args.out, "trajectory": str(final(files.pop("trajectory")[0]))}
        placed["programs"] = {kind: [str(final(path)) for path in paths] for kind, paths in files.items()}
        if parts:
            placed |= _write_part(draft, final, cell, passes, parts, args, source, date, checked, decision)
    return placed


def _write_part(draft, final, cell, passes, parts, args, source, date: str, checked, decision) -> dict:
    """Report with the error maps, and the part as it is predicted."""
    from kr270_milling.decision.part import machined, write_stl
    from kr270_milling.report import decision_block, write_report

    title = f"{cell.path.file.rsplit('/', 1)[-1]}: before and after compensation ({passes[1].name})"
    report = write_report(
        draft, cell, passes, title=title, source=str(source), command=command_line(args), date=date,
        parts=parts, decision=decision_block(decision, checked),
    )  # fmt: skip
    stl = draft / f"part_{passes[1].name}.stl"
    write_stl(stl, machined(cell, passes[1].result.actual))
    return {"report": str(final(report)), "part": str(final(stl))}


def _print(cell, passes, found: dict, checked, args) -> None:
    if cell.path.file:
        _print_features(found["features"], found["method"])
    else:
        rows = [
            [p.name, f"{p.scores.static_deviation * 1e6:.2f}", f"{p.scores.max_deviation * 1e6:.2f}"] for p in passes
        ]
        print_table("Predicted path deviation [um]", ["pass", "static", "max"], rows)
    if found["note"]:
        print(found["note"])
    if found["identified"]:
        print(_identified(found["identified"]))
    print(joints_text(found["commanded_joints_deg"]))
    print(f"largest correction {found['largest_correction_mm']:.4f} mm")
    if "chord_error_mm" in found:
        print(f"LIN chords stand off the programmed path by up to {found['chord_error_mm'] * 1e3:.2f} um")
    print("\n".join(checked.lines()))
    if found["verdict"]:
        _print_verdict(found["verdict"])
    print(f"{found['points']} reference points: {found['trajectory']}")
    if not checked.may_be_run:
        print("programs marked NOT RELEASED" if args.force else "no robot program is written (--force writes one)")
    for kind, paths in found["programs"].items():
        print(f"{kind}: {', '.join(paths[:2])}{f' and {len(paths) - 2} more files' if len(paths) > 2 else ''}")
    for kind in ("report", "part"):
        if kind in found:
            print(f"{kind}: {found[kind]}")


def _identified(found: dict) -> str:
    """What the passes told of the arm, in one line."""
    modes = ", ".join(f"{m['frequency_hz']:.2f} Hz ({100 * m['damping_ratio']:.1f} %)" for m in found["modes"])
    gain, compliance = found["gain"], found["compliance_factor"]
    return f"arm as the passes show it: modes {modes}; gain {gain:.3f}, compliance {compliance:.3f} x the model's"


def _print_features(features: dict, method: str) -> None:
    """Before and after, side by side."""
    before, after = ({row["feature"]: row for row in features[name]} for name in ("original", method))
    keys = ("max_normal_um", "mean_normal_um", "max_wall_error_um", "max_floor_error_um")
    rows = []
    for name, row in before.items():
        pairs = [(row[key], after.get(name, {}).get(key, float("nan"))) for key in keys]
        rows.append([name] + [f"{v:.1f}".replace("nan", "-") for pair in pairs for v in pair])
    columns = ["feature", "max", "after", "mean", "after", "wall", "after", "floor", "after"]
    print_table(
        f"Before and after ({method}) [um]: deviation to the side while cutting, errors that remain", columns, rows
    )


def _print_verdict(verdict: dict) -> None:
    rows = []
    for which in ("original", "compensated"):
        for name in ("max", "static"):
            band = verdict[which][f"{name}_deviation_mm"]
            rows.append([f"{which}, {name}"] + [f"{1e3 * v:.1f}" for v in band])
    title = f"{verdict['samples']} plants, seed {verdict['seed']}: deviation [um]"
    print_table(title, ["", "5 %", "50 %", "95 %"], rows)
    print(f"verdict: compensation {verdict['verdict']}: {verdict['reason']}")
    print(f"recommended method: {verdict['recommended_method']} (95 % of the plants: {_levels(verdict)})")


def _levels(verdict: dict) -> str:
    return ", ".join(f"{name} {1e3 * band[2]:.1f} um" for name, band in verdict["methods"].items())
