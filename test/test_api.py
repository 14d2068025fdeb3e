"""The front door: what a script or a notebook imports."""

from __future__ import annotations

import pydoc
import re
import subprocess
import sys

import numpy as np
import pandas
import pytest

import kr270_milling
from kr270_milling import Trajectory, check, compensate, read_cell, simulate, stability, verdict

SHORT = ("path.length_mm=15", "stock.grid_step_um=40", "stock.max_mm=[15,12,0]")


@pytest.fixture(scope="module")
def both():
    return compensate(read_cell("paper.yaml", *SHORT), "linear")


def test_every_name_of_the_front_door_exists_and_others_do_not():
    for name in kr270_milling.__all__:
        assert getattr(kr270_milling, name)
    with pytest.raises(AttributeError):
        kr270_milling.anything_else  # noqa: B018


def test_help_shows_every_function_with_its_arguments_and_an_example():
    text = pydoc.plain(pydoc.render_doc(kr270_milling))
    functions = [name for name in kr270_milling.__all__ if name.islower() and not name.startswith("_")]
    assert len(functions) == 7 and set(kr270_milling.__all__) <= set(dir(kr270_milling))
    for name in functions:
        assert re.search(rf"^    {name}\(\w+.*\n(        .*\n|\s*\n)*?        >>> ", text, re.MULTILINE), name


def test_importing_the_package_imports_no_library():
    code = "import sys, kr270_milling; assert 'numpy' not in sys.modules"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_a_pass_shows_its_scores(both):
    static, most = 1e6 * both.original.scores.static_deviation, 1e6 * both.original.scores.max_deviation
    assert repr(both.original) == f"<Pass original: static {static:.2f} um, max {most:.2f} um>"
    assert "decision: caution" in repr(both) and isinstance(both.compensated.reference, Trajectory)
    assert both.original.tolerance.passes is None and both.original.tolerance.wall == both.original.scores.max_deviation


def test_the_series_are_the_same_in_frame_csv_and_figure(both, tmp_path):
    frame = both.original.to_frame()
    again = pandas.read_csv(both.original.to_csv(tmp_path / "pass.csv"))
    assert list(frame.columns) == list(again.columns)
    np.testing.assert_allclose(frame.to_numpy(), again.to_numpy(), rtol=1e-12, atol=1e-12)
    figure = both.original.plot()
    np.testing.assert_allclose(figure.data[0].y, frame["path_deviation_um"])


@pytest.fixture(scope="module")
def judged(both):
    return verdict(both.original.cell, both.compensated.reference, samples=2)


def test_a_notebook_shows_each_result_as_text_frame_figure_and_page(both, judged, tmp_path):
    lobes = stability(both.original.cell, [6000.0, 8000.0])
    for k, shown in enumerate((both, both.original, judged, lobes)):
        html, frame, figure = shown._repr_html_(), shown.to_frame(), shown.plot()
        assert html.startswith("<p>") and "<script" not in html and isinstance(frame, pandas.DataFrame)
        assert len(frame) > 1 and len(figure.data) > 0
        page = shown.report(tmp_path / f"{k}.html").read_text(encoding="utf-8")
        assert page.startswith("<!DOCTYPE html>") and "</html>" in page[-20:]
    assert both.to_frame()["pass"].unique().tolist() == ["original", "linear"]
    np.testing.assert_allclose(judged.to_frame()["original_um"], 1e6 * judged.original)
    assert lobes.to_frame()["spindle_speed_rpm"].tolist() == pytest.approx([6000.0, 8000.0])


def test_check_and_verdict_of_a_compensated_pass(both, judged):
    cell, checked = both.original.cell, check(both.original.cell)
    assert checked.may_be_run and judged.word in repr(judged) and "may be run" in repr(checked)
    assert max(len(repr(shown)) for shown in (cell, checked, judged)) < 200
    planned = simulate(cell, both.compensated.reference).scores.max_deviation
    assert planned == pytest.approx(both.compensated.scores.max_deviation, abs=0.1e-6)  # the program has rounded points


def test_compensate_says_what_of_the_correction_was_not_let_through():
    cell = read_cell("paper.yaml", "path.length_mm=14.4", "compensation.max_correction_mm=0.02")
    found = compensate(cell, "linear").checked.findings
    assert [f.severity for f in found if f.what == "correction limited"] == ["warning"]
