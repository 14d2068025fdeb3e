"""A tool that bends: the closed form of a cantilever, a spring in series with the arm in a pass and in the methods."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import ConfigError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensated, mirrored, simulate
from kr270_milling.physics.motion.milling_pass import CompliantArm, follow
from kr270_milling.physics.robot import compliance, equilibrium, rotate_matrix

SHORT = ("path.length_mm=24", "stock.grid_step_um=40", "stock.max_mm=[24,12,0]")
SOFT = "tool.stiffness_n_per_um=2"


def cell(*settings):
    return read_cell(find_file("paper.yaml"), (*SHORT, *settings))


@pytest.mark.parametrize(
    "settings, expected",
    [
        # F L^3 / (3 E I), I = pi r^4 / 4: r 10 mm, L 80 mm, 210 GPa
        (["tool.stick_out_mm=80", "tool.modulus_gpa=210", "tool.flute_section=1"],
         0.08**3 / (630e9 * np.pi * 0.01**4 / 4)),
        # of carbide, d = 10 mm, L = 40 mm, flutes as 8 mm: 64e-6 / (1.8e12 pi 8e-3^4 / 64)
        (["tool.diameter_mm=10", "tool.stick_out_mm=40"], 64e-6 / (1.8e12 * np.pi * 0.008**4 / 64)),
        # the flutes end at 30 of 50 mm; unit load method: integral of x^2 / (E I) over both parts
        (["tool.stick_out_mm=50", "tool.flute_length_mm=30", "tool.shank_diameter_mm=18"],
         (0.05**3 - 0.03**3) / (1.8e12 * np.pi * 0.018**4 / 64) + 0.03**3 / (1.8e12 * np.pi * 0.016**4 / 64)),
        ([SOFT], 0.5e-6),
        ([], 0.0),
    ],
)  # fmt: skip
def test_the_compliance_is_that_of_a_stepped_cantilever(settings, expected):
    assert cell(*settings).tool.lateral_compliance == pytest.approx(expected, rel=1e-12)


def test_stiffness_and_stick_out_are_not_both_given():
    with pytest.raises(ConfigError, match=r"tool\.stiffness_n_per_um.*stick_out_mm"):
        cell(SOFT, "tool.stick_out_mm=40")


@pytest.mark.parametrize("settings", [[], ["dynamics.mass_model=rigid", "dynamics.follow_pose=true"]])
def test_a_constant_force_moves_the_tool_by_the_sum_of_both_springs(settings):
    """Static end of the equation of motion: C_arm F + C_tool (F - (F . z) z), rotations without the tool's."""
    tried = cell(SOFT, "dynamics.damping_ratio=0.5", *settings)
    model = tried.arm_model(tried.target())
    still, wrench = np.zeros((0, model.order)), np.tile([100.0, -80.0, 60.0, 2.0, 1.0, 3.0], (4000, 1))
    moved = follow(model, still, wrench)[-1]
    at = tried.joints(tried.target())[-1 if settings else 0]
    soft = compliance(equilibrium(tried.arm, tried.mount, at), tried.arm)
    arm = rotate_matrix(soft, tried.workpiece.pose.rotation.T) @ wrench[0]
    assert moved == pytest.approx(arm + [50e-6, -40e-6, 0.0, 0.0, 0.0, 0.0], rel=2e-3, abs=1e-9)


def test_the_tool_follows_the_mean_force_of_a_revolution():
    """A step of the force: 1 - exp(-t / T) of the displacement at the time t, T the revolution, whatever H is."""
    for period in (0.25, 0.5):
        soft, rigid = (cell(f"exchange.period_ms={period}", *more) for more in ((SOFT,), ()))
        both = [CompliantArm(one.arm_model(one.target())) for one in (soft, rigid)]
        steps = round(7.5 / period)  # [ms], a revolution at 8000 rpm
        for _ in range(steps):
            bent, plain = (arm.correct(np.array([0.0, 100.0, 0.0, 0.0, 0.0, 0.0])) for arm in both)
        assert (bent - plain)[1] == pytest.approx(50e-6 * (1 - np.exp(-1)), rel=1e-6)


@pytest.fixture(scope="module")
def passes():
    return {name: (one := cell(*more), simulate(one)) for name, more in (("rigid", ()), ("soft", (SOFT,)))}


def test_a_pass_deviates_by_the_mean_force_times_the_compliance_more(passes):
    (_, rigid), (_, soft) = passes["rigid"], passes["soft"]
    force = soft.result.wrench[-400:, 1].mean()
    more = soft.scores.static_deviation - rigid.scores.static_deviation
    assert more == pytest.approx(0.5e-6 * force, rel=0.03)


@pytest.mark.parametrize("method", ["linear", "mirror", "inverse"])
def test_the_methods_remove_the_displacement_of_the_tool_as_well(passes, method):
    """Without the tool in its model ``mirror`` would leave 0.5 um/N x 81 N = 40 um."""
    tried, original = passes["soft"]
    left = compensated(tried, original, method).scores.static_deviation
    assert abs(left) < 0.08 * original.scores.static_deviation


def test_the_mirror_moves_the_target_by_the_compliance_in_the_plane_across_the_tool():
    wrench = np.tile([100.0, -80.0, 60.0, 0.0, 0.0, 0.0], (len(cell().target()), 1))
    bent, rigid = (mirrored(one, one.target(), wrench).position for one in (cell(SOFT), cell()))
    assert bent - rigid == pytest.approx(np.tile([-50e-6, 40e-6, 0.0], (len(bent), 1)), abs=1e-7)
