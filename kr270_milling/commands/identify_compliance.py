"""``kr270_milling identify compliance``: from load tests to compliances, or from a cell to a plan of load tests."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_common, numbers
from kr270_milling.commands.identified import Outcome, Table, report
from kr270_milling.nodes.option_types import bounded


def add_arguments(parser) -> None:
    parser.add_argument(
        "measurements", metavar="MEASUREMENTS.csv", nargs="?", help="one load test a row, see identification/README.md"
    )
    parser.add_argument("--arm", metavar="ARM.yaml", required=True, help="arm or cell file to start from")
    parser.add_argument(
        "--cell", metavar="CELL.yaml", help="where the arm is to mill (default: --arm, if it is a cell file)"
    )
    parser.add_argument("--at", type=numbers(6, most=720.0), metavar="A1,...,A6", help="posture there [deg]")
    parser.add_argument("--no-gravity", action="store_true", help="leave the link weights out")
    parser.add_argument("--robust", action="store_true", help="take the weight from tests that contradict the others")
    parser.add_argument(
        "--compensator", metavar="NAMES", default="", help="also fit these of arm.compensator, as stiffness,preload"
    )
    plan = parser.add_argument_group("plan")
    plan.add_argument(
        "--plan", type=bounded(1, 1000, int), metavar="N", help="choose the N load tests that tell most about the cell"
    )
    plan.add_argument(
        "--point", type=numbers(3, most=5e3), metavar="X,Y,Z", help="of load and reflector, flange frame [mm]"
    )
    plan.add_argument("--mass-kg", type=bounded(0, 5000), default=100.0, help="to hang; 0: none (default: 100)")
    plan.add_argument(
        "--pull-n", type=bounded(0, 50_000), default=800.0, help="of a horizontal rope; 0: none (default: 800)"
    )
    plan.add_argument(
        "--noise-um", type=bounded(0.001, 1e5), default=20.0, help="of a measured coordinate, 1 sigma (default: 20)"
    )
    plan.add_argument(
        "--postures", type=bounded(1, 50_000, int), default=2000, help="candidates to choose from (default: 2000)"
    )
    plan.add_argument("--seed", type=bounded(0, 2**31, int), default=1, help="of the candidates (default: 1)")
    parser.add_argument("--out", metavar="DIR", help="write YAML to include and report, or table and KRL of the plan")
    add_common(parser)


def run(args) -> None:
    from kr270_milling.base.errors import InputError
    from kr270_milling.base.record import find_file
    from kr270_milling.commands.plan_load_tests import plan_load_tests
    from kr270_milling.robot.analysis import read_arm

    arm, mount = read_arm(find_file(args.arm))
    if args.cell:
        mount = read_arm(find_file(args.cell))[1]
    pose = _pose(args, mount)
    if args.plan is not None:
        plan_load_tests(args, arm, mount, pose)
    elif args.measurements is None:
        raise InputError("identify compliance", "needs a table of load tests, or --plan N to make one")
    else:
        _identify(args, arm, mount, pose)


def _pose(args, mount):
    import numpy as np

    from kr270_milling.base.record import find_file
    from kr270_milling.identification.prediction import at_posture, read_test_pose

    if args.at:
        return at_posture(mount, np.radians(args.at))
    return read_test_pose(find_file(args.cell or args.arm), mount)


def _identify(args, arm, mount, pose) -> None:
    from kr270_milling.base.record import find_file
    from kr270_milling.identification.compliance import fit
    from kr270_milling.identification.figures import compliance_figures
    from kr270_milling.identification.measurements import read_measurements
    from kr270_milling.identification.problem import Problem
    from kr270_milling.identification.result import as_dict, include_sections, sentences

    measured = read_measurements(find_file(args.measurements), arm, mount)
    sought = tuple(name.strip() for name in args.compensator.split(",") if name.strip())
    found = fit(Problem(arm, mount, measured, not args.no_gravity, sought), args.robust)
    result = as_dict(found, pose)
    title = f"Joint compliances of {arm.name} from {len(measured)} load tests"
    residual = f"residual {result['residual_rms_um']:.2f} um RMS, normal with p = {result['normality_p']:.2g}"
    outcome = Outcome("compliance", title, result, [_table(title, found)], [residual, *sentences(found, pose)])
    report(args, outcome, lambda: compliance_figures(found), include_sections(found),
           f" from {Path(args.measurements).name}", "name this file in `includes` behind that of the arm")  # fmt: skip


def _table(title: str, found) -> Table:
    rows = []
    for name, value, width, start, free in zip(
        found.problem.names, found.values, found.half_widths, found.problem.scale, found.free, strict=True
    ):
        unit = 1e6 if name.startswith("joint") else 1.0
        numbers_ = ["-" if number == float("inf") else f"{unit * number:.4g}" for number in (start, value, width)]
        rows.append([name, *numbers_, "yes" if free else "no"])
    return Table(title, ["number", "arm file", "identified", "95 % +-", "told by the data"], rows)
