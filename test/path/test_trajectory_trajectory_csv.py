"""Trajectories as CSV: what is written is read back to the last bit."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from splines import spline

from kr270_milling.base.errors import InputError
from kr270_milling.path.trajectory_csv import read_csv, write_csv

RANDOM = np.random.default_rng(5)
QUATERNION = RANDOM.normal(size=(7, 4))
RUN = spline(
    np.cumsum([0, 50_000_000, 4_000_000, 1, 12_000_000, 333_333_333, 9_999_999_999]), RANDOM.normal(size=(7, 3)),
    QUATERNION / np.linalg.norm(QUATERNION, axis=1, keepdims=True),
)  # fmt: skip


@pytest.mark.parametrize("run", [RUN, RUN.with_position(RUN.position)], ids=["with velocity", "without"])
@pytest.mark.parametrize("joints", [None, RANDOM.uniform(-3, 3, (7, 6))], ids=["without joints", "with joints"])
def test_a_trajectory_comes_back_from_its_file(tmp_path, run, joints):
    write_csv(tmp_path / "t.csv", run, joints)
    back, angles = read_csv(tmp_path / "t.csv")
    for name in ("time_ns", "position", "velocity"):
        np.testing.assert_array_equal(getattr(back, name), getattr(run, name))
    np.testing.assert_allclose(back.quaternion, run.quaternion, rtol=0, atol=1e-15)
    assert (angles is None) == (joints is None) and (joints is None or np.abs(angles - joints).max() < 1e-15)


def test_the_file_has_one_header_that_a_csv_reader_understands(tmp_path):
    write_csv(tmp_path / "t.csv", RUN, np.zeros((7, 6)))
    with open(tmp_path / "t.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert (
        len(rows) == 7
        and float(rows[2]["time_s"]) == 0.054
        and float(rows[2]["x_mm"]) == pytest.approx(1e3 * RUN.position[2, 0], rel=1e-15)
    )
    assert {"qx", "qw", "a1_deg", "a6_deg"} <= set(rows[0])


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda text: text.replace("time_s", "t"), 1),
        (lambda text: text.rstrip("\n"), 8),
        (lambda text: text.replace("0.054000000,", "0.054000000,nan,", 1), 4),
        (lambda text: text.replace("0.054000000,", "0.001000000,"), 4),
        (lambda text: text.replace("0.054000000,", "zero,"), 4),
        (lambda text: text.replace("0.000000000,", "1e300,"), 2),
    ],
)
def test_a_spoilt_file_is_refused_with_its_line(tmp_path, change, line):
    write_csv(tmp_path / "t.csv", RUN)
    (tmp_path / "t.csv").write_text(change((tmp_path / "t.csv").read_text()))
    with pytest.raises(InputError) as caught:
        read_csv(tmp_path / "t.csv")
    assert caught.value.line == line
