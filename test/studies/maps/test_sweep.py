"""Sweeps: axes, samples, rows that do not depend on the chunk. Workers are in ``test_engine``."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.errors import InputError, ParameterError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.studies.maps.engine import Study
from kr270_milling.studies.maps.sweep import Axis, Sweep, parse_axis

pytest.importorskip("pyarrow")
SHORT = ("path.length_mm=4", "stock.grid_step_um=40", "stock.max_mm=[4,12,0]")


def sweep(**more) -> Sweep:
    axes = (Axis("path.depth_of_cut_mm", (0.2, 0.4)), Axis("tool.teeth", (2.0, 4.0)))
    return Sweep(str(find_file("paper.yaml")), SHORT, axes, **more)


def test_axes_are_ranges_or_lists():
    assert parse_axis("tool.teeth=2:6:2") == Axis("tool.teeth", (2.0, 4.0, 6.0))
    assert parse_axis("path.depth_of_cut_mm=0.2:2:0.2").values[-1] == pytest.approx(2.0)
    assert parse_axis("dynamics.mass_model=lumped,rigid").values == ("lumped", "rigid")
    for text in ("tool.teeth", "tool.teeth=", "tool.teeth=1:0:1", "tool.teeth=1:2:0", "=1,2", "x=1:2:nan"):
        with pytest.raises(ParameterError):
            parse_axis(text)


def test_a_key_that_no_cell_has_is_refused_before_anything_is_started():
    with pytest.raises(ParameterError, match="did you mean tool.teeth"):
        Sweep(str(find_file("paper.yaml")), (), (Axis("tool.teth", (2.0,)),))


def test_a_grid_has_every_combination_and_a_hypercube_every_stratum():
    assert [sweep().values(i) for i in range(4)] == [(0.2, 2.0), (0.2, 4.0), (0.4, 2.0), (0.4, 4.0)]
    drawn = sweep(samples=40)
    values = np.array([drawn.values(i) for i in range(40)])
    for column, low, high in ((0, 0.2, 0.4), (1, 2.0, 4.0)):
        strata = np.floor((values[:, column] - low) / (high - low) * 40)
        assert sorted(strata) == list(range(40))


def test_files_are_neither_few_nor_without_number():
    for count, chunk in ((4, 1), (640, 8), (100_000, 8), (10_000_000, 500)):
        assert sweep(samples=count).chunk == chunk


def test_the_rows_are_plain_passes_whatever_the_chunk():
    import io

    import pyarrow.parquet as parquet

    def rows(chunk):
        made = sweep(chunk=chunk)
        return [row for n in range(made.chunks) for row in parquet.read_table(io.BytesIO(made(n))).to_pylist()]

    one, all_at_once = rows(1), rows(4)
    assert one == all_at_once and [row["index"] for row in one] == [0, 1, 2, 3]
    cell = read_cell(find_file("paper.yaml"), [*SHORT, "path.depth_of_cut_mm=0.4", "tool.teeth=2"])
    assert one[2]["max_deviation_um"] == 1e6 * simulate(cell).scores.max_deviation


def test_every_spindle_speed_runs_with_the_nearest_period_of_whole_micro_steps():
    """The cell has 0.5 ms, 24 steps of 1 deg at 8000 rpm; at 7400 rpm a step takes 1 / 44.4 ms: 22.2 of them."""
    made = Sweep(str(find_file("paper.yaml")), SHORT, (Axis("tool.spindle_speed_rpm", (7400.0, 8000.0, 0.0)),))
    rows = [made.row(index) for index in range(3)]
    assert [row["exchange.period_ms"] for row in rows] == pytest.approx([22 / 44.4, 0.5, 0.5], rel=1e-12)
    assert [bool(row["error"]) for row in rows] == [False, False, True] and "spindle_speed" in rows[2]["error"]
    own = Sweep(made.cell, SHORT, (*made.axes, Axis("exchange.period_ms", (0.5,))))
    assert "whole number of micro-steps" in own.row(0)["error"]  # what was asked for is not changed


def test_a_folder_of_another_study_is_refused(tmp_path):
    Study(tmp_path, {"seed": 1})
    Study(tmp_path, {"seed": 1})
    with pytest.raises(InputError, match="another study"):
        Study(tmp_path, {"seed": 2})
