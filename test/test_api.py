"""The front door: what a script or a notebook imports."""

import pydoc
import re
import runpy
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import nbformat
import numpy as np
import pandas
import pytest
from nbclient import NotebookClient

import kr270_milling
from kr270_milling import (
    check,
    compare,
    compensate,
    identify,
    placements,
    read_cell,
    simulate,
    stability,
    stiffness,
    sweep,
    verdict,
)
from kr270_milling.api import Compensation, Pass
from kr270_milling.base.errors import MillingError, ParameterError
from kr270_milling.physics.compensation.method import Correction
from kr270_milling.physics.motion.scores import Scores

NOTEBOOKS = sorted((Path(__file__).parents[1] / "config").glob("*.ipynb"))
EXAMPLES = sorted(Path(kr270_milling.__file__).parent.glob("guide/examples/*.py"))
SHORT = ("path.length_mm=15", "stock.grid_step_um=40", "stock.max_mm=[15,12,0]")


@pytest.fixture(scope="module")
def both():
    return compensate(read_cell("paper.yaml", *SHORT), "linear")


def test_help_shows_every_function_with_its_arguments_and_an_example():
    text = pydoc.plain(pydoc.render_doc(kr270_milling))
    functions = [name for name in kr270_milling.__all__ if name.islower() and not name.startswith("_")]
    assert len(functions) == 12 and set(kr270_milling.__all__) <= set(dir(kr270_milling))
    for name in functions:
        arguments = r"\(\s*\w+.*\n(        .*\n)*(    \).*\n)?"  # from Python 3.13 on one a line where they are many
        assert re.search(rf"^    {name}{arguments}(        .*\n|\s*\n)*?        >>> ", text, re.MULTILINE), name
    with pytest.raises(AttributeError):
        kr270_milling.anything_else  # noqa: B018


def test_the_series_are_the_same_in_frame_csv_and_figure(both, tmp_path):
    frame = both.original.to_frame()
    again = pandas.read_csv(both.original.to_csv(tmp_path / "pass.csv"))
    assert list(frame.columns) == list(again.columns)
    np.testing.assert_allclose(frame.to_numpy(), again.to_numpy(), rtol=1e-12, atol=1e-12)
    figure = both.original.plot()
    np.testing.assert_allclose(figure.data[0].y, frame["path_deviation_um"])


def test_a_notebook_shows_each_result_as_text_frame_figure_and_page(both, tmp_path):
    cell, original = both.original.cell, both.original
    judged = verdict(cell, both.compensated.reference, samples=2)
    lobes = stability(cell, [6000.0, 8000.0])
    for k, shown in enumerate((both, original, judged, lobes)):
        html, frame, figure = shown._repr_html_(), shown.to_frame(), shown.plot()
        assert html.startswith("<p>") and "<script" not in html and isinstance(frame, pandas.DataFrame)
        assert len(frame) > 1 and len(figure.data) > 0
        page = shown.report(tmp_path / f"{k}.html").read_text(encoding="utf-8")
        assert page.startswith("<!DOCTYPE html>") and "</html>" in page[-20:]
    assert f"max {1e6 * original.scores.max_deviation:.2f} um" in repr(original)
    assert "decision: caution" in repr(both) and judged.word in repr(judged)
    assert original.tolerance.passes is None and original.tolerance.wall == original.scores.max_deviation
    assert both.to_frame()["pass"].unique().tolist() == ["original", "linear"]
    np.testing.assert_allclose(judged.to_frame()["original_um"], 1e6 * judged.original)
    assert lobes.to_frame()["spindle_speed_rpm"].tolist() == pytest.approx([6000.0, 8000.0])
    again = simulate(cell, both.planned.reference)
    assert again.max_deviation_um == pytest.approx(both.planned.max_deviation_um, abs=0.1)
    checked = check(cell)
    assert checked.may_be_run and "may be run" in repr(checked)


def test_sweep_and_placements_are_frames_with_the_rows_of_the_commands():
    short = ("path.length_mm=2", "stock.grid_step_um=50", "stock.max_mm=[2,12,0]")
    rows = sweep("paper.yaml", *short, vary={"path.depth_of_cut_mm": [0.2, -1, 0.4], "tool.teeth": [2]})
    assert rows["path.depth_of_cut_mm"].tolist() == [0.2, -1.0, 0.4] and rows["tool.teeth"].tolist() == [2.0] * 3
    assert (rows["error"] == "").tolist() == [True, False, True]
    alone = simulate(read_cell("paper.yaml", *short, "path.depth_of_cut_mm=0.4", "tool.teeth=2"))
    assert rows["max_deviation_um"][2] == alone.max_deviation_um > rows["max_deviation_um"][0]
    cell = read_cell("paper.yaml", *short)
    here = 1e3 * cell.workpiece.xyz[0]
    places = placements(cell, x_mm=[here, here + 9000.0], tool_turn_deg=[0.0])
    assert places.groupby("x_mm")["feasible"].any().tolist() == [True, False] and len(places) == 16


def test_the_notebooks_run_in_an_empty_folder_and_are_stored_without_outputs(tmp_path):
    """One kernel for all, which forgets the names of a notebook before the next."""
    together, parts = nbformat.v4.new_notebook(), []
    for path in NOTEBOOKS:
        cells = nbformat.read(path, as_version=4).cells
        together.cells += [*cells, nbformat.v4.new_code_cell("%reset -f")]
        parts.append([cell for cell in cells if cell.cell_type == "code"])
        assert all(cell.outputs == [] and cell.execution_count is None for cell in parts[-1])
    NotebookClient(together, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()
    for cells in parts:
        shown = "".join(str(cell.outputs) for cell in cells)
        assert "_um" in shown and "text/html" in shown and "application/vnd.plotly" in shown
        if shutil.which("chromium"):  # draws the image that a converted notebook keeps
            assert "image/svg+xml" in shown


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_prints_numbers(example, capsys, few_robots):
    runpy.run_path(str(example), run_name="__main__")
    assert re.search(r"\d", capsys.readouterr().out)


def test_the_plan_is_beside_the_paper_and_the_written_program_has_a_row_of_its_own():
    cell, scores = read_cell("paper.yaml"), Scores(2e-6, 3e-6, 6.7, np.nan, np.nan)
    run = Pass(name="linear", reference=None, result=None, scores=scores, cell=cell)
    both = Compensation(replace(run, name="original"), run, run, None, None)
    (table,) = both.tables()
    assert table.columns[-1] == "max, paper"
    assert [(row[0], row[-1]) for row in table.rows] == [
        ("original", "63.20"), ("linear, planned", "4.70"), ("linear, written", "-"),
    ]  # fmt: skip
    assert (
        both.compensated is both.written
        and "max, paper"
        not in replace(both, original=replace(run, cell=read_cell("paper.yaml", "tool.teeth=2"))).tables()[0].columns
    )


def test_a_dict_replaces_values_of_a_section_and_wrong_names_are_sentences():
    cell = read_cell("paper.yaml", *SHORT)
    moved = cell.replace(dynamics={"reference_inertia": True})
    assert moved.dynamics.reference_inertia and moved.dynamics.damping_ratio == cell.dynamics.damping_ratio
    with pytest.raises(ParameterError, match="dynamic .*did you mean dynamics"):
        cell.replace(dynamic={})
    with pytest.raises(MillingError, match="a text for each key"):
        read_cell("paper.yaml", ["path.length_mm=20"])
    with pytest.raises(ParameterError, match="'liner'.*did you mean linear"):
        compensate(cell, "liner")


@pytest.mark.parametrize(("call", "sentence"), [
    (lambda cell: compensate("paper.yaml"), "cell is 'paper.yaml', but must be a Cell"),
    (lambda cell: check(cell, np.zeros((3, 3))), r"reference is array\(.*\), but must be a Trajectory"),
    (lambda cell: verdict(cell, SimpleNamespace()), "but must be a Trajectory"),
    (lambda cell: simulate(cell, "reference.csv"), "reference is 'reference.csv', but must be a Trajectory"),
    (lambda cell: stability(cell, [8000, -1]), "speeds_rpm is .*finite numbers above 0"),
    (lambda cell: stability(cell, "4000:8000/3"), "speeds_rpm is '4000:8000/3', but must be finite"),
    (lambda cell: placements(cell, x_mm=[np.nan]), "x_mm is .*finite numbers"),
    (lambda cell: placements(cell, x_mm=[]), "x_mm is .*finite numbers"),
    (lambda cell: sweep("paper.yaml", vary={"tool.teeth": []}), "tool.teeth is .*finite numbers"),
    (lambda cell: cell.replace(tool=None), "tool is None, but must be a record Tool"),
])  # fmt: skip
def test_an_argument_of_another_kind_is_refused_in_a_sentence_of_one_line(call, sentence):
    with pytest.raises(kr270_milling.MillingError, match=sentence):
        call(read_cell("paper.yaml", *SHORT))


def test_a_single_value_is_a_list_of_one():
    rows = sweep("paper.yaml", *SHORT, vary={"cutting.chip_angle": "nominal", "path.depth_of_cut_mm": 0.2})
    assert rows["error"].tolist() == [""] and rows["cutting.chip_angle"].tolist() == ["nominal"]


@pytest.mark.parametrize(("returned", "reason"), [
    (lambda target: target.position, "method mine .*a Correction"),
    (lambda target: Correction(np.zeros((3, 3)), smooth=True), r"\(3, 3\), but must be finite .*, 3\)"),
    (lambda target: Correction(np.full_like(target.position, np.nan), smooth=True), "'not finite', but must be finite"),
])  # fmt: skip
def test_a_method_of_ones_own_that_returns_no_correction_is_refused_in_a_sentence(returned, reason):
    fields = {"name": "mine", "repeats": False, "smooth": True, "recommended": False}
    with pytest.raises(ParameterError, match=reason):
        compensate(
            read_cell("paper.yaml", *SHORT), SimpleNamespace(**fields, revise=lambda task: returned(task.target))
        )


@pytest.mark.parametrize("method", [3, lambda task: None, SimpleNamespace, SimpleNamespace(name="mine")])
def test_an_object_that_is_no_method_is_refused_in_a_sentence(method):
    with pytest.raises(ParameterError, match="a name, or an object with name, smooth, repeats"):
        compensate(read_cell("paper.yaml", *SHORT), method)


def test_stiffness_identify_and_compare_give_the_keys_of_the_commands():
    pose = stiffness("kr270_2.yaml", joints_deg=[90, -50, 120, 180, 25, 180])
    assert np.shape(pose["stiffness"]) == (6, 6)
    assert identify("material", "Al7075")["materials"]
    with pytest.raises(MillingError, match="nowhere"):
        compare("nowhere.mcap", "paper.yaml")


SCRIPT = """
from kr270_milling.base.extensions import register
register("force_laws", "mine", "own_law:OwnLaw")
from kr270_milling import read_cell
keys = ("tangential_cutting_n_per_mm2", "tangential_edge_n_per_mm", "radial_cutting_n_per_mm2", "radial_edge_n_per_mm")
given = [f"cutting.mine.{key}=20" for key in keys]
print(type(read_cell("paper.yaml", "cutting.law=mine", *given).cutting.active).__name__)
register("methods", "late", "own_law:Late")
"""
LAW = """
from kr270_milling.physics.cutting.laws import LinearEdgeLaw

class OwnLaw(LinearEdgeLaw):
    pass
"""


def test_a_script_registers_a_force_law_of_a_file_before_the_first_cell_and_not_after(tmp_path):
    (tmp_path / "own_law.py").write_text(LAW)
    (tmp_path / "script.py").write_text(SCRIPT)
    ran = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert ran.stdout == "OwnLaw\n" and "entry point late" in ran.stderr and "comes too late" in ran.stderr
