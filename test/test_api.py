"""The front door: what a script or a notebook imports."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import kr270_milling
from kr270_milling import Trajectory, check, compensate, read_cell, simulate, verdict

SHORT = ("path.length_mm=15", "stock.grid_step_um=40", "stock.max_mm=[15,12,0]")


@pytest.fixture(scope="module")
def both():
    return compensate(read_cell("paper.yaml", *SHORT), "linear")


def test_every_name_of_the_front_door_exists_and_others_do_not():
    for name in kr270_milling.__all__:
        assert getattr(kr270_milling, name)
    with pytest.raises(AttributeError):
        kr270_milling.anything_else  # noqa: B018


def test_importing_the_package_imports_no_library():
    code = "import sys, kr270_milling; assert 'numpy' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_a_pass_shows_its_scores(both):
    static, most = 1e6 * both.original.scores.static_deviation, 1e6 * both.original.scores.max_deviation
    assert repr(both.original) == f"<Pass original: static {static:.2f} um, max {most:.2f} um>"
    assert "decision: caution" in repr(both) and isinstance(both.compensated.reference, Trajectory)
    assert both.original.tolerance.passes is None and both.original.tolerance.wall == both.original.scores.max_deviation


def test_the_series_are_the_same_in_frame_csv_and_figure(both, tmp_path):
    pandas = pytest.importorskip("pandas")
    frame = both.original.to_frame()
    again = pandas.read_csv(both.original.to_csv(tmp_path / "pass.csv"))
    assert list(frame.columns) == list(again.columns)
    np.testing.assert_allclose(frame.to_numpy(), again.to_numpy(), rtol=1e-12, atol=1e-12)
    figure = both.original.plot()
    np.testing.assert_allclose(figure.data[0].y, 1e3 * frame["path_deviation_mm"])


def test_check_and_verdict_of_a_compensated_pass(both):
    cell = both.original.cell
    checked, judged = check(cell), verdict(cell, both.compensated.reference, samples=2)
    assert checked.may_be_run and judged.word in repr(judged) and "may be run" in repr(checked)
    assert max(len(repr(shown)) for shown in (cell, checked, judged)) < 200
    planned = simulate(cell, both.compensated.reference).scores.max_deviation
    assert planned == pytest.approx(both.compensated.scores.max_deviation, abs=0.1e-6)  # the program has rounded points


def test_compensate_says_what_of_the_correction_was_not_let_through():
    cell = read_cell("paper.yaml", "path.length_mm=14.4", "compensation.max_correction_mm=0.02")
    found = compensate(cell, "linear").checked.findings
    assert [f.severity for f in found if f.what == "correction limited"] == ["warning"]
