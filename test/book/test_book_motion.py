"""Checks of eq. (1) in discrete time and of the exchange between robot and cut."""

from __future__ import annotations

import functools

import numpy as np
from book import check
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.signal import lsim, lti

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.exchange.cut import CutProtocol
from kr270_milling.exchange.robot import RobotProtocol
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.physics.motion.arm_model import arm_model
from kr270_milling.physics.motion.dynamics import advance, discretise, modes
from kr270_milling.physics.motion.exchange import Clock
from kr270_milling.physics.motion.milling_pass import CompliantArm

STIFFNESS, MASS, ZETA = 1.395e6, 790.4, 0.18  # [N/m], [kg]: the paper's arm across the feed
OMEGA = np.sqrt(STIFFNESS / MASS)
SHORT = "path.length_mm=14.4"
STILL = np.zeros(0)  # a reference that does not move


def _one_degree():
    """Only y moves."""
    return modes(np.diag([1e-9, 1 / STIFFNESS] + [1e-9] * 4), np.diag([0, MASS, 0, 0, 0, 0.0]))


def _run(model, zeta, period, steps, state, wrench):
    """States (steps + 1, 2r) and the last deflection (6,) with the wrench held."""
    arrays = arm_model([model], zeta, period).arrays
    states, deflection = np.zeros((steps + 1, state.size)), np.zeros(6)
    states[0] = state
    for n in range(steps):
        advance(n, states[n], wrench, STILL, arrays, states[n + 1], deflection)
    return states, deflection


@check("free vibration of one degree of freedom over 0.5 s", "closed form, relative to the start")
def test_free_vibration():
    states, _ = _run(_one_degree(), ZETA, 1e-3, 500, np.array([1e-4, 2e-3]), np.zeros(6))
    t, damped = np.arange(501) * 1e-3, OMEGA * np.sqrt(1 - ZETA**2)
    sine = (2e-3 + ZETA * OMEGA * 1e-4) / damped
    expected = np.exp(-ZETA * OMEGA * t) * (1e-4 * np.cos(damped * t) + sine * np.sin(damped * t))
    return 0.0, np.abs(states[:, 0] - expected).max() / 1e-4, 1e-11


@check("step of 81 N on one degree of freedom", "closed form, relative to F / k")
def test_step_response():
    states, _ = _run(_one_degree(), ZETA, 5e-4, 1000, np.zeros(2), np.array([0, 81.0, 0, 0, 0, 0]))
    t, damped = np.arange(1001) * 5e-4, OMEGA * np.sqrt(1 - ZETA**2)
    rest = np.exp(-ZETA * OMEGA * t) * (np.cos(damped * t) + ZETA * OMEGA / damped * np.sin(damped * t))
    return 0.0, np.abs(states[:, 0] * STIFFNESS / 81.0 - (1 - rest)).max(), 1e-11


@functools.cache
def _paper():
    cell = read_cell(find_file("paper.yaml"))
    return cell, cell.modal_model


@check("one period of (1) for the paper's arm", "matrix exponential of (1), relative")
def test_exponential():
    cell, model = _paper()
    r, to_mass = model.frequency.size, model.mass @ model.shape
    stiff, damping = (to_mass @ np.diag(d) @ to_mass.T for d in (model.frequency**2, 2 * ZETA * model.frequency))
    inverse = np.linalg.inv(model.mass)
    system = np.block([[np.zeros((r, r)), np.eye(r)], [-inverse @ stiff, -inverse @ damping]])
    exact = expm(system * cell.exchange.period)
    return 0.0, np.abs(discretise(model, ZETA, cell.exchange.period)[0] - exact).max() / np.abs(exact).max(), 1e-12


@check("energy of an undamped vibration after 10,000 periods / at the start", "conservation of energy")
def test_energy():
    _, model = _paper()
    to_mass, r = model.mass @ model.shape, model.frequency.size
    stiff = to_mass @ np.diag(model.frequency**2) @ to_mass.T
    states, _ = _run(model, 0.0, 5e-4, 10_000, np.linspace(1e-5, 1e-4, 2 * r), np.zeros(6))
    total = [x[:r] @ stiff @ x[:r] + x[r:] @ model.mass @ x[r:] for x in states[[0, -1]]]
    return 1.0, total[1] / total[0], 1e-10


@check("long held wrench: deflection of all six components", "compliance times wrench (condensed, not sliced)")
def test_static_limit():
    soft = np.diag([4e-4] * 6) @ (np.arange(36).reshape(6, 6) % 7 + np.arange(36).reshape(6, 6).T % 7) / 30
    soft = soft @ soft + np.diag([1e-6] * 6)
    model = modes(soft, np.diag([MASS] * 3 + [0.0] * 3))
    wrench = np.array([100.0, -50.0, 30.0, 4.0, -7.0, 5.0])
    _, found = _run(model, 0.3, 0.05, 400, np.zeros(6), wrench)
    return 0.0, np.abs(found - soft @ wrench).max() / np.abs(soft @ wrench).max(), 1e-9


def _following(reference: Trajectory, zeta: float, period: float, steps: int):
    """Stamps (steps + 1,) [ns], deflection along y and its rate of one degree of freedom that follows a reference."""
    stamps = Clock(period, 1).stamp(np.arange(steps + 1))
    arm = arm_model([_one_degree()], zeta, period, reference_inertia=True)
    side, states = CompliantArm(arm, arm.push(reference, stamps)), np.zeros((steps + 1, 2))
    for n in range(steps):
        side.correct(np.zeros(6))
        states[n + 1] = side.state
    return stamps, states


def _polygon() -> Trajectory:
    """Straight lines along y with a corner every 20 ms."""
    positions = np.outer(1e-4 * np.random.default_rng(3).normal(size=21), [0.0, 1.0, 0.0])
    return Trajectory(np.arange(21) * 20_000_000, positions, TOOL_DOWN)


@check("M delta'' + C delta' + K delta = -M r'', straight lines with corners", "scipy.signal.lsim of (C s + K) / "
       "(M s^2 + C s + K), relative")  # fmt: skip
def test_moving_reference():
    reference = _polygon()
    stamps, states = _following(reference, 0.04, 1e-3, 400)
    y, steady = reference.sample(stamps)[:, 1], reference.sample_velocity(0)[1] * stamps * 1e-9
    filtered = lti([0.08 * OMEGA, OMEGA**2], [1, 0.08 * OMEGA, OMEGA**2])
    expected = lsim(filtered, y - y[0] - steady, stamps * 1e-9)[1] + y[0] + steady
    return 0.0, np.abs(y + states[:, 0] - expected).max() / np.abs(y).max(), 1e-11


@check("corner of 0.4 mm/s in the reference, undamped: amplitude at 6.7 Hz", "dv / omega [derived]", "m")
def test_corner():
    positions = np.outer([0.0, 0.0, 0.4e-3 * 0.35], [0.0, 1.0, 0.0])
    reference = Trajectory(np.array([0, 50_000_000, 400_000_000]), positions, TOOL_DOWN)
    return 0.4e-3 / OMEGA, np.abs(_following(reference, 0.0, 1e-4, 4000)[1][:, 0]).max(), 1e-9


@check("energy of the undamped arm / work of its motors, r' (M z'') over straight lines", "conservation of energy")
def test_work_of_the_motors():
    reference = _polygon()
    stamps, states = _following(reference, 0.0, 1e-3, 400)
    rate = reference.sample_velocity(stamps, "left")[:, 1]
    absolute = states[:, 1] + rate
    energy = 0.5 * MASS * absolute**2 + 0.5 * STIFFNESS * states[:, 0] ** 2
    work = MASS * np.cumsum(rate[1:] * np.diff(absolute))
    return 1.0, (energy[-1] - energy[0]) / work[-1], 1e-9


@check(
    "compensated by (1) as printed, milled with -M r'': {method}, largest deviation",
    "two other calculations [derived], to the digits given", "m",
    cases=("method expected", [("linear", 20e-6), ("mirror", 5.5e-6)]),
)  # fmt: skip
def test_compensation_without_the_reference(method, expected):
    moving, reference = _compensated_as_printed(method)
    return expected, simulate(moving, reference).scores.max_deviation, 0.5e-6


def _compensated_as_printed(method):
    printed, moving = (
        read_cell(find_file("paper.yaml"), (f"dynamics.reference_inertia={on}",)) for on in ("false", "true")
    )
    return moving, compensated(printed, simulate(printed), method).reference


@check(
    "compensated by (1) as printed, milled with -M r'': spline, largest deviation",
    "transfer function (2 z w s + w^2) / (s^2 + 2 z w s + w^2) of one mode, spline by scipy, lsim", "m",
)  # fmt: skip
def test_a_spline_compensation_without_the_reference_by_a_transfer_function():
    """The mode follows the correction, and answers the change of the force; both are added to the original pass.

    All links are at the tool, so one mode of 790.4 kg moves the tool across the feed.
    """
    moving, reference = _compensated_as_printed("spline")
    before, after = simulate(moving), simulate(moving, reference)
    ran, time = before.result, before.result.time
    offset = (reference.position - moving.target().position)[:, 1]
    correction = CubicSpline(reference.time, offset, bc_type=((1, 0.0), (1, 0.0)))(time)
    w, z = 2 * np.pi * moving.low_frequency, moving.dynamics.damping_ratio
    mode = [1.0, 2 * z * w, w**2]
    _, followed, _ = lsim(([2 * z * w, w**2], mode), correction, time)
    change = (after.result.wrench - ran.wrench)[:, 1] / moving.arm.link_mass.sum()
    _, pushed, _ = lsim(([1.0], mode), change, time)
    scored = time >= moving.full_engagement - 1e-9
    deviation = (ran.deflection[:, 1] + followed + pushed)[scored]
    return np.abs(deviation).max(), after.scores.max_deviation, 0.5e-6


@functools.cache
def _pass(micro_steps: int, *assignments: str):
    period = f"exchange.period_ms={micro_steps / 48!r}"  # 1 deg at 8000 rpm is 1/48 ms
    return simulate(read_cell(find_file("paper.yaml"), (period, *assignments))).result


def _gap(result, reference, every: int) -> float:
    """Largest difference of the deflection at common instants, as a share of the largest deflection."""
    there = reference.deflection[::every, :3][: len(result.deflection)]
    return np.abs(result.deflection[: len(there), :3] - there).max() / np.abs(reference.deflection[:, :3]).max()


@check(
    "H = 0.5 ms against an exchange at every micro-step",
    "self-consistent: the finer pass, share of its deflection",
    at_most=True,
)
def test_default_period():
    return 0.0, _gap(_pass(24), _pass(1), 24), 0.002


@check("order of convergence in the exchange period H", "2: force held at its mean over H")
def test_period_order():
    steps = (6, 12, 24, 48)
    errors = [_gap(_pass(m, SHORT), _pass(1, SHORT), m) for m in steps]
    return 2.0, np.polyfit(np.log(steps), np.log(errors), 1)[0], 0.6


@check("correction of the predicted pose, H = 0.5 ms", "some nanometres: dF H^2 / 2 M [derived]", "m", at_most=True)
def test_correction():
    return 2e-8, _pass(24).correction.max(), 0.0


@check("two sides of the exchange against the compiled pass", "self-consistent: bit for bit", "m, N")
def test_sides():
    cell = read_cell(find_file("paper.yaml"), (SHORT,))
    compiled, robot, cut, worst = simulate(cell).result, RobotProtocol(cell, 1), CutProtocol(cell), 0.0
    robot.reference = cell.target()
    cut.configure()
    ((_, pose),) = robot.start()
    for n in range(robot.steps + 1):
        ((_, answer),) = cut.pose(pose)
        outputs = dict(robot.wrench(answer))
        gaps = (
            pose.position - compiled.tool[n],
            answer.wrench - compiled.wrench[n],
            outputs["deflection"].twist - compiled.deflection[n],
        )
        worst = max(worst, *(np.abs(gap).max() for gap in gaps))
        pose = outputs.get("tool_pose")
    return 0.0, worst, 0.0
