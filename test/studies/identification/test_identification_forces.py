"""Force coefficients from mean forces, and modes from ring-downs and impacts."""

import dataclasses
import math

import numpy as np
import pytest
from book import check
from samples.campaigns import (
    COEFFICIENTS,
    FEEDS,
    MODES,
    TOOL,
    covered_forces,
    cuts,
    find_modes,
    measured_cuts,
    ring_down,
)
from scipy.linalg import eigh

from kr270_milling.base.errors import InputError, ModelError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import arm_of, modal_model_of, path_of
from kr270_milling.physics.cutting import Cut, Cutting, FractionalLaw, LinearEdgeLaw, Stock
from kr270_milling.studies.identification.doubts import hammer_doubts
from kr270_milling.studies.identification.forces import OneFeedError, Sensor, fit_forces, law_sections, read_cuts
from kr270_milling.studies.identification.modes import (
    Mode,
    by_compliance,
    by_hammer,
    check_hammer,
    free_decay,
    tool_compliance,
)
from kr270_milling.studies.identification.signals import Signals, read_signals


def test_slot_means_are_the_closed_forms():
    """[Altintas2012]: F_x = -N a (K_rc f / 4 + K_re / pi), F_y = N a (K_tc f / 4 + K_te / pi), F_z = N a (K_ac f / pi
    + K_ae / 2), toward the part as ``cutting`` has it."""
    k_tc, k_te, k_rc, k_re, k_ac, k_ae = COEFFICIENTS
    f, na = np.array(FEEDS), 4 * 1e-3
    f_x, f_y = -k_rc * f / 4 - k_re / np.pi, k_tc * f / 4 + k_te / np.pi
    f_z = k_ac * f / np.pi + k_ae / 2
    assert measured_cuts(cuts()).force == pytest.approx(na * np.stack([f_x, f_y, -f_z], -1), rel=1e-12)


@pytest.mark.parametrize(("mode", "width"), [("up", 0.01), ("down", 0.01), ("up", 0.005), ("down", 0.015)])
@pytest.mark.parametrize("rotation", ["clockwise", "counterclockwise"])
def test_means_of_partial_immersion_are_those_of_the_cut_itself(mode, width, rotation):
    """The compiled sweep over a grid, a revolution after a run-in; 1 % as its own checks in the book."""
    tool = TOOL.replace(rotation=rotation)
    law = LinearEdgeLaw(*map(float, COEFFICIENTS))
    # with clockwise teeth the chip of up-milling begins at +y: the part lies on that side
    side = (1.0 if mode == "up" else -1.0) * -tool.sense
    low, high = sorted([side * (0.01 - width), side * 0.012])
    stock = Stock(min=np.array([0.0, low, -5e-3]), max=np.array([0.03, high, 0.0]), grid_step=10e-6)
    cut = Cut(tool, Cutting("linear_edge", linear_edge=law), stock, math.radians(1.0))
    step = 4 * 0.1e-3
    at = np.array([0.012, 0.0, -1e-3])
    cut.sweep([-0.011, 0.0, -1e-3], at, 0, 360 * 60)
    for turn in range(60, 64):
        wrench = cut.sweep(at, at + [step, 0, 0], 360 * turn, 360)
        at = at + [step, 0.0, 0.0]
    expected = law.mean_forces(cuts(mode, width, (0.1e-3,), tool))[0]
    assert wrench[:3] == pytest.approx(expected, abs=0.015 * np.abs(expected).max())


CAMPAIGNS = 400


@check(
    f"95 % intervals of force coefficients that cover the truth, {CAMPAIGNS} campaigns",
    "0.95; slots and half immersion at six feeds, Al7075-T6, noise of 2 N that is not stated (Student's interval)",
)
def test_force_coverage():
    return 0.95, covered_forces(13, CAMPAIGNS).mean(), 0.02


def test_axial_forces_may_be_missing_or_point_into_the_holder():
    some = measured_cuts(cuts())
    some.force[:, 2] *= -1.0
    result = fit_forces("linear_edge", some)
    assert result.values == pytest.approx(COEFFICIENTS) and result.axial == 1.0
    noise = np.random.default_rng(4).normal(size=some.force.shape)
    result = fit_forces("linear_edge", dataclasses.replace(some, force=some.force + noise))
    sections = law_sections("linear_edge", result.values, result.half_widths, result.axial)
    axial = sections["cutting"]["linear_edge"]["axial_cutting_n_per_mm2"][0]
    assert axial == pytest.approx(-1e-6 * result.values[4]) == pytest.approx(-222.0, rel=0.2)
    spreads = sections["uncertainty"]["force_coefficients"][0]  # the verdict scatters the axial ones by what is known
    assert spreads == pytest.approx(np.clip(result.half_widths / 1.96 / result.values, 1e-4, 1.0))
    some.force[:, 2] = np.nan
    result = fit_forces("linear_edge", some)
    assert np.isnan(result.values[4:]).all() and result.values[:4] == pytest.approx(COEFFICIENTS[:4])


def test_one_feed_is_refused():
    with pytest.raises(OneFeedError, match="at least 2 feeds"):
        fit_forces("linear_edge", measured_cuts(cuts(feeds=(0.1e-3,) * 5)))
    with pytest.raises(OneFeedError, match="2 feeds per tooth"):
        fit_forces("fractional", measured_cuts(cuts(feeds=(0.1e-3, 0.2e-3))))


def test_fractional_means_are_those_of_the_facts():
    """Rigid slot, f = 0.125 mm, 1 mm deep: -44.39 and 147.98 N; half immersion by quadrature elsewhere [derived]."""
    paper = (5e6, 18e-6, 0.1, 0.3)
    for mode, width, expected in (
        ("slot", 0.02, (-44.39, 147.98)), ("up", 0.01, (-78.268, 57.168)), ("down", 0.01, (33.874, 90.811)),
    ):  # fmt: skip
        got = FractionalLaw(*paper).mean_forces(cuts(mode, width, (0.125e-3,)))[0, :2]
        assert got == pytest.approx(expected, abs=5e-3)


def test_the_fractional_law_is_identified_and_differs_from_the_other_law():
    paper = np.array([5e6, 18e-6, 0.1, 0.3, 0.2])
    some = cuts(feeds=np.linspace(0.01e-3, 0.25e-3, 12))
    rng = np.random.default_rng(1)
    force = FractionalLaw(*paper).mean_forces(some) + 0.3 * rng.normal(size=(12, 3))
    some = dataclasses.replace(some, force=force)
    result = fit_forces("fractional", some)
    assert np.all(np.abs(result.values - paper) < 1.5 * result.half_widths)
    assert np.all(result.half_widths < 0.2 * paper)
    assert result.lateral_rms < 0.5 * fit_forces("linear_edge", some).lateral_rms


@pytest.mark.parametrize(("row", "text"), [
    ("0.1,1,20,sideways,1,2,3", "one of slot, up, down"),
    ("0.1,1,25,up,1,2,3", "at most the tool's diameter"),
    ("0.1,1,10,slot,1,2,3", "the tool's diameter in a slot"),
    ("0.1,-1,10,up,1,2,3", "must be above 0"),
    ("0.1,1,10,up,,2,3", "neither fx_n and fy_n nor a recording"),
    ("0.1,1,10,up,1,x,3", "is no number"),
    ("0.1,1,10,up,1,2", "6 values where the header has 7"),
])  # fmt: skip
def test_unusable_rows_are_refused_with_their_line(tmp_path, row, text):
    file = tmp_path / "cuts.csv"
    file.write_text(f"feed_per_tooth_mm,depth_mm,width_mm,mode,fx_n,fy_n,fz_n\n0.1,1,10,up,1,2,3\n{row}\n")
    with pytest.raises(InputError, match="line 3") as refused:
        read_cuts(file, TOOL, Sensor())
    assert text in str(refused.value)


# --- Modes from ring-downs and impacts of machines that are known ---
#: two degrees of freedom with masses at x and y [kg, N/m]
MASS, STIFFNESS = np.diag([500.0, 300.0]), np.array([[2.2e6, -0.4e6], [-0.4e6, 1.6e6]])


@pytest.mark.parametrize(("noise", "rel"), [(0.0, 5e-4), (0.01, 5e-3), (0.05, 0.03)])
def test_a_ring_down_gives_frequencies_damping_and_shapes(noise, rel):
    result = find_modes(ring_down(noise=noise), 2.0, 50.0)
    assert [m.frequency for m in result] == pytest.approx([f for f, _, _ in MODES], rel=rel / 10 + 1e-5)
    assert [m.damping_ratio for m in result] == pytest.approx([z for _, z, _ in MODES], rel=rel)
    for mode, (_, _, shape) in zip(result, MODES, strict=True):
        assert mode.shape == pytest.approx(shape, abs=rel + 1e-3)


def test_tables_are_read_and_refused_with_a_sentence_and_a_creep_does_not_ring(tmp_path):
    file = tmp_path / "ring.csv"
    ring = ring_down(n=400, step=5e-3)
    rows = [f"{i * ring.step},{x},{y},{z}" for i, (x, y, z) in enumerate(ring.values.tolist())]
    file.write_text("time_s,x,y,z\n" + "\n".join(rows) + "\n")
    assert read_signals(file).values == pytest.approx(ring.values, abs=1e-12)
    with pytest.raises(InputError, match="holds 5 samples"):
        read_signals(file).window(0.0, 0.025)
    file.write_text("time_s,x\n" + "\n".join(f"{t},0" for t in [*range(20), 500]) + "\n")
    with pytest.raises(InputError, match="has a gap"):
        read_signals(file)
    file.write_text("time_s,force_n\n0,1\n")
    with pytest.raises(InputError, match="none of the columns"):
        read_signals(file)
    for stamps, reason in (
        (lambda i: f"{i / 5120:.3f}", "321 of 400 samples have the stamp of the sample before them"),
        (lambda i: f"{(i % 390) * 5e-3}", "line 392.*the time goes back from 1.945 to 0 s"),
    ):
        file.write_text("time_s,x\n" + "\n".join(f"{stamps(i)},{x}" for i, x in enumerate(ring.values[:, 0])) + "\n")
        with pytest.raises(InputError, match=reason):
            read_signals(file)
    creep = Signals(1e-3, np.linspace(1.0, 0.0, 500)[:, None] ** 2, ("x",))
    with pytest.raises(ModelError, match="nothing rings"):
        find_modes(creep, 5.0, 50.0)


def uff_file(folder, *changes):
    """One history of the ring-down for each change."""
    pyuff = pytest.importorskip("pyuff")
    file, ring = folder / "ring.uff", ring_down(n=400, step=5e-3)
    common = {"type": 58, "func_type": 1, "rsp_node": 1, "ref_node": 1, "ref_dir": 1, "abscissa_spacing": 1}
    common |= {"x": np.arange(400) * ring.step, "orddenom_spec_data_type": 0}
    for i, change in enumerate(changes):
        history = {**common, "rsp_dir": 1, "data": ring.values[:, i], **change}
        pyuff.UFF(str(file)).write_sets(history, "add")
    return file


def test_a_uff_file_is_read(tmp_path):
    ring = ring_down(n=400, step=5e-3)
    read = read_signals(uff_file(tmp_path, *({"rsp_dir": i + 1} for i in range(3))))
    assert read.names == ("x", "y", "z") and read.values == pytest.approx(ring.values, abs=1e-9)


def test_stamps_that_are_rounded_are_taken_as_even(tmp_path):
    """900 Hz at 5120 samples a second; four decimals shift each stamp by up to a quarter of a step."""
    file, ring = tmp_path / "ring.csv", ring_down([(900.0, 0.02, [1.0, 0.5, 0.0])], n=1024, step=1 / 5120)
    rows = [f"{i / 5120:.4f},{x}" for i, x in enumerate(ring.values[:, 0].tolist())]
    file.write_text("time_s,x\n" + "\n".join(rows) + "\n")
    read = read_signals(file)
    assert "the stamps are rounded to 0.0001 s" in read.notes[0]
    assert find_modes(read, 100.0, 2000.0)[0].frequency == pytest.approx(900.0, rel=3e-4)  # 0.05 ms of 0.2 s


@pytest.mark.parametrize("lead", [0.0, 1.0], ids=["quiet", "pulled away"])
def test_what_was_recorded_before_a_ring_down_is_left_out(lead):
    """One mode stays one mode; without the cut five appear."""
    ring = ring_down([(12.0, 0.03, [1.0, 0.5, 0.0])], n=2000)
    before = np.tile(lead * ring.values[:1], (700, 1))
    whole = free_decay(Signals(ring.step, np.concatenate([before, ring.values]), ring.names), 5.0, 60.0)
    (mode,) = find_modes(whole, 5.0, 60.0)
    assert (mode.frequency, mode.damping_ratio) == pytest.approx((12.0, 0.03), rel=1e-3)
    assert "(pre-trigger)" in whole.notes[0] and free_decay(ring, 5.0, 60.0) is ring


@pytest.mark.parametrize(("change", "reason"), [
    ({"rsp_node": 2}, "holds nodes 1, 2: modes need one file for each"),
    ({"x": np.arange(400) * 1e-3}, "holds sampling rates"),
    ({"rsp_dir": 1}, "holds several histories of x"),
])  # fmt: skip
def test_a_uff_file_of_several_points_or_rates_is_refused(tmp_path, change, reason):
    with pytest.raises(InputError, match=reason):
        read_signals(uff_file(tmp_path, {}, {"rsp_dir": 2} | change))


def test_the_force_of_a_uff_file_is_no_motion(tmp_path):
    """Specific data type 13 is the excitation force."""
    force = {"ordinate_spec_data_type": 13, "ordinate_axis_units_lab": "lbf", "rsp_node": 2}
    read = read_signals(uff_file(tmp_path, force, {"ordinate_spec_data_type": 12}))
    assert read.names == ("x",) and read.force is not None
    assert (read.quantity, read.drive) == ("acceleration", "node 2, not node 1")
    assert "states force_n in lbf" in read.notes[0]


def test_a_hammer_scales_the_shapes_by_the_masses():
    """Shapes of M and K by eigh, phi^T M phi = 1; an impact of 4 ms, with displacements and with accelerations."""
    phi = eigh(STIFFNESS, MASS)[1]
    signals = impact()
    step, response, hammer = signals.step, signals.values, signals.force
    modes = find_modes(signals, 2.0, 60.0)
    shapes = by_hammer(modes, signals, "x")[:, :2]
    assert shapes * np.sign(shapes[:, :1]) == pytest.approx((phi * np.sign(phi[0])).T, rel=0.02)
    accelerations = Signals(step, np.gradient(np.gradient(response, step, axis=0), step, axis=0), ("x", "y"), hammer)
    again = by_hammer(find_modes(accelerations, 2.0, 60.0), accelerations, "x", "acceleration")
    assert np.abs(again[:, :2]) == pytest.approx(np.abs(phi.T), rel=0.05)


@pytest.mark.parametrize(("shift", "factor", "quantity", "reason"), [
    (0.0, 1.0, "displacement", ""),
    (16e-3, 1.0, "displacement", "force_n is 16 ms late"),
    (-16e-3, 1.0, "displacement", "force_n is 16 ms early"),
    (0.0, -1.0, "displacement", "the signs are wrong or --quantity is acceleration"),
    (0.0, 1.0, "velocity", "--quantity is displacement"),
    (0.0, 1e-3, "displacement", "has a blow of 2 N, allowed: 5 to 50000 N"),
])  # fmt: skip
def test_a_force_that_does_not_belong_to_the_motion_is_refused_with_its_cause(shift, factor, quantity, reason):
    """The phase of the drive point, which is 0 for a force and a motion of one time, grows by omega times the delay."""
    whole = impact(start=0.02)
    hammer = factor * np.roll(whole.force, round(shift / whole.step))
    signals = Signals(whole.step, whole.values, whole.names, hammer)
    modes = find_modes(signals, 2.0, 60.0)
    if not reason:
        assert check_hammer(modes, signals, "x", quantity) == ""
        return
    with pytest.raises(InputError, match=reason):
        by_hammer(modes, signals, "x", quantity)


def test_a_hammer_in_another_unit_does_not_fit_the_compliance_of_the_cell():
    """A mode with all of the compliance along x, phi = sqrt(C) omega; accelerations in g give phi / sqrt(9.80665)."""
    cell = read_cell(find_file("test_piece.yaml"))
    static, omega = tool_compliance(arm_of(cell), path_of(cell).target), float(modal_model_of(cell).frequency[0])
    soft = static[0, 0]
    mode = Mode(complex(-0.03 * omega, omega), np.ones(1), 100.0, 1.0, 0.03)
    for factor, sentence in ((1.0, ""), (9.80665**-0.5, "accelerations in g"), (1e3**0.5, "forces in kN")):
        shapes = np.array([[factor * omega * np.sqrt(soft), 0, 0, 0, 0, 0]])
        doubts = hammer_doubts([mode], shapes, "x", static, omega)
        assert [doubt.forbids for doubt in doubts] == [True] * bool(sentence)
        assert all(sentence in doubt.text for doubt in doubts)
    (stated,) = hammer_doubts([mode], shapes, "x")
    assert not stated.forbids and "if the columns are in SI units" in stated.text


def impact(start: float = 0.0) -> Signals:
    """A blow of 2000 N and 4 ms along x at the machine of MASS and STIFFNESS."""
    squared, phi = eigh(STIFFNESS, MASS)
    n, step = 8000, 2.5e-4
    t = np.arange(n) * step
    hammer = np.where(np.abs(t - start - 0.002) < 0.002, 2000 * np.sin(np.pi * (t - start) / 0.004), 0.0)
    response = np.zeros((n, 2))
    for omega, shape in zip(np.sqrt(squared), phi.T, strict=True):
        damped = omega * np.sqrt(1 - 0.03**2)
        impulse = shape[0] * np.exp(-0.03 * omega * t) * np.sin(damped * t) / damped
        response += np.outer(np.convolve(hammer, impulse)[:n] * step, shape)
    return Signals(step, response, ("x", "y"), hammer)


def test_the_static_compliance_scales_the_shapes_where_there_was_no_hammer():
    """C = sum phi phi^T / omega^2 is the inverse of K."""
    squared, phi = eigh(STIFFNESS, MASS)
    rings = [(w / (2 * np.pi), 0.03, [*(5.0 * v), 0.0]) for w, v in zip(np.sqrt(squared), phi.T, strict=True)]
    signals = ring_down(rings)
    soft = np.zeros((6, 6))
    soft[:2, :2] = np.linalg.inv(STIFFNESS)
    shapes = by_compliance(find_modes(signals, 2.0, 50.0), signals, soft)
    assert np.abs(shapes[:, :2]) == pytest.approx(np.abs(phi.T), rel=5e-3)


@check(
    "damping ratio of a mode at {frequency} Hz between two others, ring-down with 1 % of noise",
    "a milling robot as measured: 7.07 Hz (3.7 %), 10.3 Hz (2.2 %), 16.0 Hz (2.3 %); closed form",
    cases=("frequency ratio", [(frequency, ratio) for frequency, ratio, _ in MODES]),
)
def test_damping(frequency, ratio):
    """The decrement confirms the rational fit."""
    (mode,) = [m for m in find_modes(ring_down(noise=0.01), 2.0, 50.0) if abs(m.frequency - frequency) < 0.5]
    assert mode.decrement == pytest.approx(mode.damping_ratio, rel=0.1)
    return ratio, mode.damping_ratio, 0.02 * ratio
