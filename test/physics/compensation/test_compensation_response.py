"""The response of the arm to a correction and to a wrench, against scipy's simulation of the transfer functions."""

from __future__ import annotations

import numpy as np
import pytest
from arms import KNOTS, OMEGA, SEGMENTS, ZETA, one_mode
from scipy.signal import lsim
from splines import spline

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import arm_response, simulate
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.response import ArmResponse, Segments, cubic_coefficients


def correction(smooth: bool) -> Trajectory:
    values = np.random.default_rng(2).normal(0.0, 50e-6, (KNOTS.size, 3))
    return spline(KNOTS, values) if smooth else Trajectory(KNOTS, values, (0.0, 0.0, 0.0, 1.0))


def fine(step_ns: int = 50_000) -> np.ndarray:
    return np.arange(0, KNOTS[-1] + 1, step_ns)


@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("damping", [0.04, 0.182])
def test_the_tool_follows_a_correction_through_the_filter_of_its_mode(smooth, damping):
    """z / r = (2 zeta omega s + omega^2) / (s^2 + 2 zeta omega s + omega^2), by scipy.signal.lsim from rest."""
    run, time = correction(smooth), fine()
    shift = run.sample(time)[:, 1]
    top, bottom = [2 * damping * OMEGA, OMEGA**2], [1.0, 2 * damping * OMEGA, OMEGA**2]
    expected = lsim((top, bottom), shift - shift[0], time * 1e-9)[1] + shift[0]
    found = one_mode(damping=damping).follow(SEGMENTS, cubic_coefficients(KNOTS, run.position, run.velocity))
    middle = np.interp(SEGMENTS.middle_ns.ravel(), time, expected)
    assert found[..., 1].ravel() == pytest.approx(middle, abs=1e-9)  # 50 us steps of lsim: 2e-5 of 50 um
    assert found[..., 0] == pytest.approx(run.sample(SEGMENTS.middle_ns)[..., 0], abs=1e-18)  # rigid there


def test_a_steady_correction_moves_the_tool_by_itself():
    cubic = np.zeros((len(SEGMENTS), 4, 3))
    cubic[:, 0] = [1e-5, -2e-5, 3e-5]
    assert one_mode().follow(SEGMENTS, cubic) == pytest.approx(np.broadcast_to(cubic[0, 0], (12, 16, 3)), abs=1e-18)


def test_a_corner_of_the_correction_rings_with_the_change_of_speed_over_omega():
    """facts: a change of speed dv rings with dv / omega; undamped, 0.4 mm/s at 6.7 Hz gives 9.5 um."""
    omega, change = 2 * np.pi * 6.7, 0.4e-3
    time = np.arange(13) * 50_000_000
    segments = Segments(time, 16)
    cubic = np.zeros((12, 4, 3))
    cubic[6:, 1, 1] = change
    cubic[6:, 0, 1] = change * 0.05 * np.arange(6)
    arm = ArmResponse(*(a if i > 1 else np.full((12, 1), (omega, 1e-6)[i]) for i, a in enumerate(
        (0, 0, one_mode().inward, one_mode().outward, one_mode().push, one_mode().carry))))  # fmt: skip
    swing = arm.swing(segments, cubic, np.zeros(3))[..., 1]
    assert np.abs(swing[:6]).max() < 1e-18 and np.abs(swing).max() == pytest.approx(change / omega, rel=0.01)
    assert change / omega == pytest.approx(9.5e-6, rel=0.01)


def test_under_a_wrench_the_tool_gives_way_by_the_filter_of_its_mode_and_at_last_by_its_compliance():
    force = 80.0
    wrench = np.zeros((len(SEGMENTS), 16, 6))
    wrench[4:, :, 1] = force
    time = fine()
    step = np.where(time >= KNOTS[4], force, 0.0)
    expected = lsim(([1.0], [1.0, 2 * ZETA * OMEGA, OMEGA**2]), step, time * 1e-9)[1]
    found = one_mode().deflect(SEGMENTS, wrench)[..., 1].ravel()
    middle = np.interp(SEGMENTS.middle_ns.ravel(), time, expected)
    assert found == pytest.approx(middle, abs=1e-3 * force / OMEGA**2)  # a cubic over parts of up to 5 ms
    stiff = one_mode(damping=0.9).scaled(2.0, 1.0, softness=1.5).deflect(SEGMENTS, wrench)[-1, -1, 1]
    assert stiff == pytest.approx(1.5 * force / OMEGA**2, rel=1e-3)  # softness alone changes it, not the frequency


def test_two_postures_hand_the_displacement_over_whatever_their_modes_are_called():
    """A posture whose mode has the other sign is the same arm."""
    arm, run = one_mode(), correction(True)
    cubic = cubic_coefficients(KNOTS, run.position, run.velocity)
    sign = np.where(np.arange(12) % 3 == 0, -1.0, 1.0)[:, None, None]
    turned = ArmResponse(
        arm.frequency, arm.damping, sign * arm.inward, sign * arm.outward, sign * arm.push,
        np.concatenate([sign[1:] * sign[:-1], [[[1.0]]]]),
    )  # fmt: skip
    assert turned.follow(SEGMENTS, cubic) == pytest.approx(arm.follow(SEGMENTS, cubic), abs=1e-16)


MEASURED = (
    "dynamics.modes=[{frequency_hz: 7.1, damping_ratio: 0.037, shape: [0.0, 0.05, 0.0, 0.0, 0.0, 0.0]}, "
    "{frequency_hz: 10.3, damping_ratio: 0.022, shape: [0.02, 0.01, 0.03, 0.0, 0.0, 0.0]}]"
)


@pytest.mark.parametrize("sets", [("dynamics.mass_model=lumped",), ("dynamics.mass_model=rigid",), (MEASURED,)])
def test_the_lifted_model_of_a_cell_is_the_arm_that_its_pass_runs(sets):
    """In the air the pass knows nothing but the inertia of the arm: correction and path against the lifted model."""
    short = ("path.length_mm=12", "stock.min_mm=[50,-1,-1]", "stock.max_mm=[51,1,0]", "timing.controller_step_ms=20")
    cell = read_cell(find_file("paper.yaml"), [*sets, *short, "dynamics.reference_inertia=true"])
    target = cell.target()
    shift = np.random.default_rng(1).normal(0.0, 50e-6, (len(target), 3))
    smooth = spline(target.time_ns, target.position + shift, target.quaternion)
    ran = simulate(cell, smooth).result
    assert not ran.wrench.any()
    segments = Segments.of(target.time_ns)
    straight = cubic_coefficients(target.time_ns, target.position, target.velocity)
    cubic = cubic_coefficients(target.time_ns, smooth.position, smooth.velocity) - straight
    found = arm_response(cell, target).follow(segments, cubic)
    deviation = np.stack([np.interp(segments.middle_ns, ran.time_ns, d) for d in (ran.actual - ran.target).T], axis=-1)
    assert found == pytest.approx(deviation, abs=2e-3 * np.abs(deviation).max())  # linear between samples of 0.5 ms


def test_eq_1_as_printed_moves_the_tool_with_the_reference():
    cell = read_cell(find_file("paper.yaml"), ["path.length_mm=12"])
    arm = arm_response(cell, cell.target())
    run = correction(True)
    segments = Segments.of(cell.target().time_ns)
    cubic = cubic_coefficients(KNOTS, run.position, run.velocity)[: len(segments)]
    assert arm.follow(segments, cubic) == pytest.approx(segments.powers @ cubic, abs=1e-18)
