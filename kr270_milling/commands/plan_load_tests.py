"""The part of ``identify compliance`` that plans load tests: table, program, and what the plan is worth."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import Answer, Table

__all__ = ["plan_load_tests"]


def plan_load_tests(args, arm, mount, pose) -> Answer:
    import numpy as np

    from kr270_milling.base.errors import InputError
    from kr270_milling.identification.plan import CRITERIA, Bench, Planner, candidates

    if pose is None:
        raise InputError(
            "--plan", "needs the posture where the arm is to mill: name --cell CELL.yaml or --at A1,...,A6"
        )
    point = mount.xyz if args.point is None else 1e-3 * np.array(args.point)
    bench = Bench(point, args.mass_kg, args.pull_n, 1e-6 * args.noise_um)
    choice = candidates(arm, mount, bench, args.postures, args.seed)
    if args.plan > len(choice.tests):
        raise InputError("--plan", f"asks for {args.plan} load tests, but only {len(choice.tests)} are possible here")
    planner = Planner(arm, mount, choice, pose, not args.no_gravity)
    names = ("planned for the test pose", "A-optimal", "D-optimal")
    designs = {name: planner.best(args.plan, c) for name, c in zip(names, CRITERIA, strict=True)}
    rng = np.random.default_rng(args.seed)
    blind = sorted((planner.random(args.plan, rng) for _ in range(201)), key=lambda d: d.pose_error)
    designs["random (median of 201)"] = blind[100]
    return _answer(args, choice, designs)


def _answer(args, choice, designs: dict) -> Answer:
    import numpy as np

    from kr270_milling.identification.plan import blind_spots, in_order, load_text

    best = next(iter(designs.values()))
    plan = in_order(choice.take(best.rows))
    blind = blind_spots(best.relative)
    result: dict = {
        "blind_spots": blind,
        "designs": [{"name": name, "error_um": 1e6 * d.pose_error, "relative": d.relative.tolist(),
                     "determinant": d.determinant} for name, d in designs.items()],
        "tests": [{"joints_deg": np.degrees(q).tolist(), "wrench": w.tolist(), "load": load_text(plan, i)}
                  for i, (q, w) in enumerate(zip(plan.tests.q, plan.tests.wrench, strict=True))],
    }  # fmt: skip
    if args.out:
        result["files"] = [str(path) for path in _write_plan(args, plan, best)]
    rows = [[name, f"{1e6 * d.pose_error:.3f}", f"{100 * d.relative.max():.1f}", f"{100 * d.determinant:.2f}"]
            for name, d in designs.items()]  # fmt: skip
    title = f"{args.plan} load tests: what 100 N at the cell's posture are known to (1 sigma)"
    tests = [[t["load"], " ".join(f"{a:7.2f}" for a in t["joints_deg"])] for t in result["tests"]]
    return Answer(result, [
        Table(title, ["choice", "error there [um]", "worst compliance [%]", "mean [%]"], rows),
        Table("The tests, in the order of the program", ["load", "A1 to A6 [deg]"], tests),
        *blind,
        *result.get("files", ()),
    ])  # fmt: skip


def _write_plan(args, plan, best) -> list[Path]:
    from kr270_milling import __version__
    from kr270_milling.base.files import staged
    from kr270_milling.identification.plan import blind_spots, write_plan

    error = f"expected error {1e6 * best.pose_error:.3f} um per 100 N"
    notes = [f"load tests planned by kr270_milling {__version__}, {error}", *blind_spots(best.relative),
             "measure the reflector without the load, then with it; dx, dy, dz: difference, base axes"]  # fmt: skip
    with staged(args.out) as (draft, final):
        return [final(path) for path in write_plan(draft, plan, notes)]
