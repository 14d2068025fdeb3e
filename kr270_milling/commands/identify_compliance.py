"""``kr270_milling identify compliance``: from load tests to compliances, or from a cell to a plan of load tests."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import option
from kr270_milling.nodes.option_types import bounded, numbers


def add_arguments(parser) -> None:
    option(parser, "measurements MEASUREMENTS.csv", "one load test a row, see identification/README.md", nargs="?")
    option(parser, "--arm ARM.yaml", "arm or cell file to start from", required=True)
    option(parser, "--cell CELL.yaml", "where the arm is to mill (default: --arm, if it is a cell file)")
    option(parser, "--at A1,...,A6", "posture there [deg]", numbers(6, most=720.0))
    option(parser, "--no-gravity", "leave the link weights out", bool)
    option(parser, "--robust", "take the weight from tests that contradict the others", bool)
    option(parser, "--compensator NAMES", "also fit these of arm.compensator, as stiffness,preload", default="")
    plan = parser.add_argument_group("plan")
    option(plan, "--plan N", "choose the N load tests that tell most about the cell", bounded(1, 1000, int))
    option(plan, "--point X,Y,Z", "of load and reflector, flange frame [mm]", numbers(3, most=5e3))
    option(plan, "--mass-kg", "to hang; 0: none", bounded(0, 5000), 100.0)
    option(plan, "--pull-n", "of a horizontal rope; 0: none", bounded(0, 50_000), 800.0)
    option(plan, "--noise-um", "of a measured coordinate, 1 sigma", bounded(0.001, 1e5), 20.0)
    option(plan, "--postures", "candidates to choose from", bounded(1, 50_000, int), 2000)
    option(plan, "--seed", "of the candidates", bounded(0, 2**31, int), 1)
    option(parser, "--out DIR", "write YAML to include and report, or table and KRL of the plan")


def run(args) -> Answer:
    import numpy as np

    from kr270_milling.base.errors import InputError
    from kr270_milling.base.record import find_file
    from kr270_milling.commands.identify import identified
    from kr270_milling.commands.plan_load_tests import plan_load_tests
    from kr270_milling.identification.compliance import compliance_outcome, fit
    from kr270_milling.identification.measurements import read_measurements
    from kr270_milling.identification.plan import at_posture, read_test_pose
    from kr270_milling.identification.problem import Problem
    from kr270_milling.robot.analysis import read_arm

    arm, mount = read_arm(find_file(args.arm))
    if args.cell:
        mount = read_arm(find_file(args.cell))[1]
    where = find_file(args.cell or args.arm)
    pose = at_posture(mount, np.radians(args.at)) if args.at else read_test_pose(where, mount)
    if args.plan is not None:
        return plan_load_tests(args, arm, mount, pose)
    if args.measurements is None:
        raise InputError("identify compliance", "needs a table of load tests, or --plan N to make one")
    measured = read_measurements(find_file(args.measurements), arm, mount)
    sought = tuple(name.strip() for name in args.compensator.split(",") if name.strip())
    found = fit(Problem(arm, mount, measured, not args.no_gravity, sought), args.robust)
    return identified(args, compliance_outcome(found, pose, Path(args.measurements).name))
