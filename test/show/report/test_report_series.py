"""report.series: CSV of every series, names that stay inside the directory."""

from __future__ import annotations

import numpy as np
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import ScoredPass, compensated, simulate
from kr270_milling.path.trajectory_csv import read_csv
from kr270_milling.show.report.series import COLUMNS, deviation_of, file_names, write_series


@pytest.fixture(scope="module")
def cell():
    return read_cell(find_file("paper.yaml"), ["path.length_mm=12.0", "stock.grid_step_um=40.0"])


@pytest.fixture(scope="module")
def passes(cell):
    original = simulate(cell)
    return [original, compensated(cell, original, "spline")]


def close(table, expected):
    """A number of thirteen digits is wrong by half of the last one at most."""
    np.testing.assert_allclose(table, expected, rtol=5e-13, atol=0)


def test_every_series_comes_back_with_twelve_digits(tmp_path, cell, passes):
    paths = write_series(tmp_path, cell, passes)
    assert [p.name for p in paths[:2]] == ["original.csv", "spline.csv"]
    for path, one in zip(paths[:2], passes, strict=True):
        assert path.read_text().splitlines()[0] == ",".join(COLUMNS)
        table = dict(zip(COLUMNS, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
        r = one.result
        np.testing.assert_allclose(table["time_s"], r.time_ns * 1e-9, rtol=1e-15)
        for k, axis in enumerate("xyz"):
            for kind in ("target", "reference", "tool", "actual"):
                close(table[f"{kind}_{axis}_mm"], 1e3 * getattr(r, kind)[:, k])
            close(table[f"deflection_{axis}_mm"], 1e3 * r.deflection[:, k])
            close(table[f"deflection_r{axis}_deg"], np.degrees(r.deflection[:, 3 + k]))
            close(table[f"force_{axis}_n"], r.wrench[:, k])
            close(table[f"moment_{axis}_n_m"], r.wrench[:, 3 + k])
        close(table["path_deviation_mm"], 1e3 * deviation_of(r, cell.target()))
        close(table["correction_mm"], 1e3 * r.correction)


def test_the_largest_deviation_of_the_series_is_the_score(tmp_path, cell, passes):
    path = write_series(tmp_path, cell, passes)[0]
    table = dict(zip(COLUMNS, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
    engaged = table["time_s"] >= cell.full_engagement - 1e-9
    largest = np.abs(table["path_deviation_mm"][engaged]).max()
    assert largest == pytest.approx(1e3 * passes[0].scores.max_deviation, rel=5e-13)


def test_reference_trajectories_are_written_with_joint_angles(tmp_path, cell, passes):
    path = write_series(tmp_path, cell, passes)[3]
    trajectory, joints = read_csv(path)
    np.testing.assert_array_equal(trajectory.position, passes[1].reference.position)
    np.testing.assert_array_equal(trajectory.velocity, passes[1].reference.velocity)
    np.testing.assert_allclose(joints, cell.joints(passes[1].reference), atol=1e-12)


def test_a_pass_cannot_be_named_out_of_the_directory(tmp_path, cell, passes):
    hostile = [ScoredPass("../../etc/x", passes[0].reference, passes[0].result, passes[0].scores)]
    out = tmp_path / "out"
    for path in write_series(out, cell, hostile):
        assert path.resolve().parent == out.resolve()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_file_names_are_plain_and_different_even_without_regard_to_case():
    names = file_names(["a b", "a/b", "A_B", "", "..", "x" * 300, "Ω"])
    assert len({n.lower() for n in names}) == len(names)
    assert all(n.strip("_") and set(n) <= set("abAB_x0123456789pas") and len(n) <= 64 for n in names)
