"""Tables of load tests in and out."""

from __future__ import annotations

import json

import numpy as np
import pytest
from campaigns import ARM, MOUNT
from examples import CONFIG, load_tests
from examples_cuts import cuts

from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cli import main
from kr270_milling.show.report.identification.comparison import advice
from kr270_milling.studies.identification.comparison import (
    ComparedSeries,
    NoOverlapError,
    VectorSeries,
    best_lag,
    compare,
    line_through,
)
from kr270_milling.studies.identification.measurements import read_measurements, write_measurements

HEAD = "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg"
POSTURE = "10,-80,100,20,30,40"


def read(tmp_path, columns: str, *rows: str):
    file = tmp_path / "tests.csv"
    file.write_text("# a note\n" + f"{HEAD},{columns}\n" + "".join(f"{POSTURE},{row}\n" for row in rows))
    return read_measurements(file, ARM, MOUNT)


def test_a_wrench_acts_at_the_tool_point_and_the_reflector_sits_there(tmp_path):
    result = read(tmp_path, "fx_n,fz_n,dx_mm,dy_mm,dz_mm,sigma_um", "100,-50,0.1,0.2,-0.3,15")
    assert result.q[0] == pytest.approx(np.radians([10, -80, 100, 20, 30, 40]))
    assert result.wrench[0].tolist() == [100, 0, -50, 0, 0, 0]
    assert result.application[0] == pytest.approx(MOUNT.xyz) and result.reflector[0] == pytest.approx(MOUNT.xyz)
    assert (
        result.displacement[0, :3] == pytest.approx([1e-4, 2e-4, -3e-4]) and np.isnan(result.displacement[0, 3:]).all()
    )
    assert result.sigma[0, :3] == pytest.approx(15e-6) and result.sigma_known


def test_a_mass_hangs_in_its_centre_and_the_reflector_is_at_its_stated_place(tmp_path):
    columns = "mass_kg,mass_centre_x_mm,mass_centre_y_mm,mass_centre_z_mm,reflector_x_mm,dx_mm,dy_mm,dz_mm"
    result = read(tmp_path, columns, "100,50,0,-400,120,0,0,-0.5")
    assert result.wrench[0] == pytest.approx([0, 0, -980.665, 0, 0, 0])
    assert result.application[0] == pytest.approx([0.05, 0, -0.4]) and result.reflector[0] == pytest.approx(
        [0.12, 0, 0]
    )
    assert not result.sigma_known


def test_what_is_written_is_read_again(tmp_path):
    first = read_measurements(CONFIG / "load_tests.csv", ARM, MOUNT)
    write_measurements(tmp_path / "again.csv", first)
    again = read_measurements(tmp_path / "again.csv", ARM, MOUNT)
    for name in ("q", "wrench", "application", "reflector", "displacement", "sigma"):
        assert getattr(again, name) == pytest.approx(getattr(first, name), nan_ok=True, abs=1e-12), name


@pytest.mark.parametrize(("made", "name"), [(load_tests, "load_tests.csv"), (cuts, "cuts.csv")])
def test_the_shipped_examples_are_what_their_makers_make(tmp_path, made, name):
    """To 1e-6 mm and 0.01 N: another machine may round otherwise."""
    made(tmp_path / name)
    texts = [(folder / name).read_text().splitlines() for folder in (CONFIG, tmp_path)]
    assert len(texts[0]) == len(texts[1]) and texts[0][:4] == texts[1][:4]
    for ours, theirs in zip(*texts, strict=True):
        for a, b in zip(ours.split(","), theirs.split(","), strict=True):
            assert a == b or float(a) == pytest.approx(float(b), abs=0.011 if name == "cuts.csv" else 1e-6)


@pytest.mark.parametrize(
    ("columns", "row", "text"),
    [
        ("dx_mm,dy_mm,dz_mm", "0,0,0", "neither a wrench nor a mass_kg"),
        ("fx_n,mass_kg,dx_mm,dy_mm,dz_mm", "1,1,0,0,0", "both a wrench and a mass"),
        ("fx_n,dx_mm,dy_mm,dz_mm", "0,0,0,0", "the load is zero"),
        ("mass_kg,dx_mm,dy_mm,dz_mm", "-5,0,0,-1", "mass_kg must be above 0"),
        ("fx_n,dx_mm,dy_mm,dz_mm", "1,250,0,0", "moved the arm by more than"),
        ("fx_n,dx_mm,dy_mm,dz_mm", "1,,0,0", "has no value in the column dx_mm"),
        ("fx_n,dx_mm,dy_mm,dz_mm,sigma_um", "1,0,0,0,0", "standard deviation must be above 0"),
        ("fx_n,dx_mm,dy_mm,dz_mm", "1,nan,0,0", "is not finite"),
    ],
)
def test_unusable_rows_are_refused_with_their_line(tmp_path, columns, row, text):
    with pytest.raises(InputError, match="line 3") as refused:
        read(tmp_path, columns, row)
    assert text in str(refused.value)


def test_a_misspelt_column_and_a_posture_out_of_the_limits_are_refused(tmp_path):
    with pytest.raises(InputError, match="did you mean sigma_um"):
        read(tmp_path, "fx_n,dx_mm,dy_mm,dz_mm,sigma_mu", "1,0,0,0,1")
    file = tmp_path / "far.csv"
    file.write_text(f"{HEAD},fx_n,dx_mm,dy_mm,dz_mm\n0,80,0,0,0,0,1,0,0,0\n")
    with pytest.raises(InputError, match="line 2.*joint limits"):
        read_measurements(file, ARM, MOUNT)


# --- Compare a measured pass with the simulated pass: lag, gains and advice, for a known plant ---


CELL = read_cell(find_file("paper.yaml"), ["path.length_mm=40.0", "stock.grid_step_um=40.0"])


def run(cell):
    return simulate(cell).result


@pytest.fixture(scope="module")
def model():
    return run(CELL)


def as_pass(result, lag=0.0, noise=0.0) -> ComparedSeries:
    rng = np.random.default_rng(4)
    force = result.wrench[:, :3] + noise * 1e6 * rng.normal(size=result.wrench[:, :3].shape)
    place = result.actual + noise * rng.normal(size=result.actual.shape)
    return ComparedSeries(VectorSeries(result.time + lag, force), VectorSeries(result.time + lag, place))


def compared(measured: ComparedSeries, model):
    feed = CELL.target().sample_velocity(model.time_ns)
    return compare(measured, as_pass(model), model.target, feed, 2 * np.pi / CELL.tool.spindle_speed)


@pytest.mark.parametrize("lag", [-0.2, 0.0, 0.137])
def test_the_same_pass_agrees_whatever_its_clock(model, lag):
    result = compared(as_pass(model, lag, noise=2e-6), model)
    assert result.lags["force"] == pytest.approx(lag, abs=6e-4) and result.lags["pose"] == pytest.approx(lag, abs=6e-4)
    assert all(abs(c.line.gain - 1.0) < 0.01 + 3 * c.line.gain_sigma for c in result.channels)
    assert all(c.line.gain_sigma < 0.03 for c in result.channels)
    assert advice(result) == ["measurement and simulation agree: nothing to identify again"]


def test_advice_separates_larger_forces_from_a_softer_arm(model):
    law = CELL.cutting.fractional
    stronger = CELL.replace(cutting=CELL.cutting.replace(fractional=law.replace(stiffness=1.2 * law.stiffness)))
    sentences = advice(compared(as_pass(run(stronger), 0.1, 2e-6), model))
    assert any("identify forces" in s for s in sentences) and not any("identify compliance" in s for s in sentences)
    softer = CELL.replace(arm=CELL.arm.replace(joint_compliance=1.25 * CELL.arm.joint_compliance))
    result = compared(as_pass(run(softer), 0.1, 2e-6), model)
    sentences = advice(result)
    assert any("the deviation is 1.2" in s and "identify compliance" in s for s in sentences)
    assert not any("identify forces" in s for s in sentences)
    assert any("identify damping" in s for s in sentences)  # 1 / sqrt(1.25): 11 % lower
    assert result.ringing["measured"][0] == pytest.approx(result.ringing["simulated"][0] / np.sqrt(1.25), rel=0.02)


def test_a_force_alone_or_a_place_alone_is_compared(model):
    both = as_pass(model)
    assert set(compared(ComparedSeries(both.force, None), model).lags) == {"force"}
    assert set(compared(ComparedSeries(None, both.tool), model).lags) == {"pose"}
    with pytest.raises(MillingError, match="neither a force nor a place"):
        compared(ComparedSeries(None, None), model)


def test_another_pass_is_refused(model):
    noise = np.random.default_rng(0).normal(size=model.wrench[:, :3].shape)
    with pytest.raises(NoOverlapError, match="does not resemble"):
        compared(ComparedSeries(VectorSeries(model.time, noise), None), model)


def test_lag_and_line_of_a_known_series():
    rng = np.random.default_rng(1)
    a = np.cumsum(rng.normal(size=(500, 2)), axis=0)
    assert best_lag(3.0 * a[40:], a[:400], same_size=False)[0] == -40
    assert best_lag(a[:300], a[25:], same_size=True)[0] == 25
    x = rng.normal(size=4000)
    line = line_through(1.3 * x + 2.0 + 0.1 * rng.normal(size=4000), x, 4000)
    assert line.gain == pytest.approx(1.3, abs=4 * line.gain_sigma) and line.offset == pytest.approx(2.0, abs=0.01)
    assert line.gain_sigma == pytest.approx(0.1 / np.sqrt(4000), rel=0.1)


def test_the_command_compares_a_recording(tmp_path, capsys):
    from pass_recording import cell_text, one_pass, write

    cell = tmp_path / "cell.yaml"
    cell.write_text(cell_text())
    recording = write(tmp_path / "pass", one_pass())
    assert main(["compare", str(recording), str(cell), "--json", "--out", str(tmp_path / "out")]) == 0
    result = json.loads(capsys.readouterr().out)
    gains = {channel["name"]: channel["gain"] for channel in result["channels"]}
    assert gains["force y"] == pytest.approx(1.0, abs=1e-6) and gains["deviation"] == pytest.approx(1.0, abs=0.01)
    assert result["lag_s"] == pytest.approx({"force": 0.0, "pose": 0.0}, abs=1e-9)
    assert "measured" in (tmp_path / "out" / "compare.html").read_text()
