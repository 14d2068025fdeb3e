"""Checks against measurements of others: forces of slots, springs, compensator and modes of heavy arms (test/measured).

The rows run the commands and the interface that a user runs.
"""

import contextlib
import functools
import io
import json
from pathlib import Path

import numpy as np
from arm_oracle import PAPER
from book import check
from samples.cuttings import PAPER_LAW

from kr270_milling import read_cell
from kr270_milling.api import simulate
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.table import read_table
from kr270_milling.cli import main
from kr270_milling.physics.cutting.laws import find_material
from kr270_milling.physics.robot import BARE, cartesian_mass, compliance, equilibrium, mode_frequencies
from kr270_milling.physics.robot.analysis import read_arm

MEASURED = Path(__file__).resolve().parents[1] / "measured"
DYNAMOMETER = "dynamometer: github.com/leekunhwee/ForceCalculation, test/measured/slot_forces.csv"
KR300 = "KUKA KR 300 R2500 [Weigand2021]"
RUNOUT = 27.0  #: [um]: gives the component of F_y that comes once a revolution, mean of the five slots
FEEDS = (0.025, 0.05, 0.075, 0.1, 0.125)


def measured(name: str, *columns: str) -> np.ndarray:
    """Columns of a table of test/measured, (n, columns); NaN: empty."""
    known = [line for line in (MEASURED / name).read_text().splitlines() if line[:1] != "#"][0].split(",")
    return read_table(MEASURED / name, known).numbers(columns, np.nan)


@functools.cache
def identified() -> dict:
    words = ("identify", "forces", str(MEASURED / "slot_forces.csv"), "--teeth", "2", "--diameter-mm", "25", "--json")
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert main([*words]) == 0
    return json.loads(printed.getvalue())


@functools.cache
def revolution(feed: float, *assignments: str) -> np.ndarray:
    """Forces of the last revolution of a simulated slot, mean of ten revolutions [N], (100, 3)."""
    cell = read_cell(MEASURED / "slot.yaml", f"path.feed_rate_m_per_min={12 * feed}", *assignments)
    return simulate(cell).result.wrench[-1000:, :3].reshape(10, 100, 3).mean(0)


@check(
    "slots on a dynamometer: identify forces, {key}", DYNAMOMETER + ", linear regression of others; 0.5 % are allowed",
    "N/mm^2, N/mm", cases=("key expected", [
        ("tangential_cutting_n_per_mm2", 958.8), ("tangential_edge_n_per_mm", 15.75),
        ("radial_cutting_n_per_mm2", 251.1), ("radial_edge_n_per_mm", 19.42)]),
)  # fmt: skip
def test_coefficients(key, expected):
    return expected, identified()[key], 5e-3 * expected


@check("slots on a dynamometer: misfit of the linear-edge law / of the fractional law", DYNAMOMETER, at_most=True)
def test_preferred_law():
    """The command recommends the linear-edge law unless another law leaves less than 0.9 of its residual."""
    forces = measured("slot_forces.csv", "fx_n", "fy_n")
    edge, other = np.array(identified()["residuals_n"])[:, :2], identified()["fractional"]["residual_rms_n"]
    assert forces.shape == edge.shape
    return 0.9, np.sqrt(np.mean(edge**2)) / other, 0.0


@check("slot at f_z = {feed} mm: mean F_y", DYNAMOMETER + "; 6 % are allowed", "N",
       cases=("feed", [(feed,) for feed in FEEDS]))  # fmt: skip
def test_mean_across(feed):
    expected = measured("slot_forces.csv", "fy_n")[FEEDS.index(feed), 0]
    return expected, revolution(feed)[:, 1].mean(), 0.06 * expected


@check("slot at f_z = {feed} mm: mean F_x", DYNAMOMETER + "; 12 % are allowed", "N",
       cases=("feed", [(feed,) for feed in FEEDS[1:]]))  # fmt: skip
def test_mean_along(feed):
    expected = measured("slot_forces.csv", "fx_n")[FEEDS.index(feed), 0]
    return expected, revolution(feed)[:, 0].mean(), 0.12 * abs(expected)


@check(
    "slot at f_z = 0.025 mm: mean F_x of the law; -39.78 N were measured, outside of 12 %",
    "-N a (K_rc f_z / 4 + K_re / pi): the straight line through five feeds misses the smallest one by 17 %", "N",
)  # fmt: skip
def test_mean_along_at_the_smallest_feed():
    expected = -2 * 3 * (251.1 * 0.025 / 4 + 19.42 / np.pi)
    return expected, revolution(0.025)[:, 0].mean(), 0.01 * abs(expected)


@check(
    "slots: component of F_y that comes once a revolution, mean of five", "identified: a run-out of 27 um is fitted to "
    "test/measured/slot_revolution.csv", "N",
)  # fmt: skip
def test_runout():
    expected = measured("slot_revolution.csv", "once_fy_n").mean()
    spectra = [np.fft.rfft(revolution(feed, f"tool.runout_um=[{RUNOUT},0]")[:, 1]) for feed in FEEDS]
    return expected, np.mean([np.abs(lines[1]) / 50 for lines in spectra]), 0.05 * expected


@check("slot at f_z = {feed} mm: peak F_y with the run-out of 27 um", DYNAMOMETER + "; 10 % are allowed", "N",
       cases=("feed", [(feed,) for feed in FEEDS]))  # fmt: skip
def test_peak(feed):
    expected = measured("slot_revolution.csv", "peak_fy_n")[FEEDS.index(feed), 0]
    return expected, revolution(feed, f"tool.runout_um=[{RUNOUT},0]")[:, 1].max(), 0.10 * expected


@check("one tooth at h = 0.125 mm, 1 mm deep: the reading of (26) against a measured tooth",
       "K_tc h + K_te of " + DYNAMOMETER + "; 5 % are allowed, the coefficients have 12 %", "N")  # fmt: skip
def test_one_tooth():
    expected = identified()["tangential_cutting_n_per_mm2"] * 0.125 + identified()["tangential_edge_n_per_mm"]
    return expected, PAPER_LAW.force_per_depth(0.125e-3)[0] * 1e-3, 0.05 * expected


@check("slot at f_z = 0.125 mm: measured F_y / F_y by the Al7075-T6 of another laboratory",
       "1.4: coefficients of one alloy from another laboratory are no forecast")  # fmt: skip
def test_other_laboratory():
    k = find_material("Al7075-T6")[0].values  # K_tc, K_te, K_rc, K_re, ...
    rows = [f"cutting.linear_edge.{name}={value * 1e-6:g}" for name, value in zip(
        ("tangential_cutting_n_per_mm2", "radial_cutting_n_per_mm2"), k[[0, 2]], strict=True)]  # fmt: skip
    rows += [f"cutting.linear_edge.{name}={value * 1e-3:g}" for name, value in zip(
        ("tangential_edge_n_per_mm", "radial_edge_n_per_mm"), k[[1, 3]], strict=True)]  # fmt: skip
    return 1.4, 210.73 / revolution(0.125, *rows)[:, 1].mean(), 0.05


@check(
    "gear compliance of A{axis} of a KR 300 R2500 / joint compliance of Table 1", "between 1/2 and 1: gear of " + KR300
    + ", joint of the paper's KR 270; a joint has a gear, bearings and a housing",
    cases=("axis", [(1,), (2,), (3,)]),
)  # fmt: skip
def test_joint_springs(axis):
    stiffness = measured("joint_springs.csv", "gear_stiffness_n_m_per_rad")[axis - 1, 0]
    return 0.75, 1 / stiffness / read_arm(find_file("kr270_2.yaml"))[0].joint_compliance[axis - 1], 0.25


@check("gravity compensator of a KR 300 R2500: pull at A2 = {angle} deg", "measured pressure times area of the ring, "
       + KR300 + "; 1 % is allowed", "N", cases=("angle row", [(-120 + 10 * k, k) for k in range(9)]))  # fmt: skip
def test_compensator(angle, row):
    expected = 1e5 * measured("compensator.csv", "pressure_bar")[row, 0] * np.pi / 4 * (0.055**2 - 0.030**2)
    spring, q = read_arm(find_file("compensator_kr300_r2500.yaml"))[0].compensator, np.radians(angle)
    pull = spring.stiffness * (spring.length(np.cos(q), np.sin(q)) - spring.free_length)
    return expected, pull, 0.01 * expected


@check(
    "first mode of the rigid model with the 925 kg of a KR 300 R2500, at the paper's posture", "13.5 Hz of the paper's "
    "790.4 kg times the root of the masses; 7.1 and 9.8 Hz were measured: base and links are missing [derived]", "Hz",
)  # fmt: skip
def test_first_mode():
    arm = read_arm(find_file("kr270_2.yaml"))[0]
    heavy = arm.replace(link_mass=arm.link_mass * 925.0 / arm.link_mass.sum())
    solved = equilibrium(heavy, BARE, PAPER)
    modes = mode_frequencies(compliance(solved, heavy), cartesian_mass(heavy, BARE, solved.posture, "rigid"))
    return 13.5 * np.sqrt(790.4 / 925.0), modes[0], 0.07
