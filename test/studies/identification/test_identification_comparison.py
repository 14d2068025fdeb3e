"""Compare a measured pass with the simulated pass: lag, gains and advice, for a known plant."""

from __future__ import annotations

import json

import numpy as np
import pytest

from kr270_milling.base.errors import MillingError
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
