"""The shipped cell of the test piece: its claims, and ``simulate`` on it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from milled_part import CONFIG

from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.cli import main
from kr270_milling.decide.part import assess, assess_all

COARSE = ("stock.grid_step_um=50.0", "exchange.micro_step_deg=3.0")


@pytest.fixture(scope="module")
def cell():
    return read_cell(CONFIG / "test_piece.yaml", COARSE)


def with_features(path, *names: str):
    """The programme of the test piece with some of its features only."""
    keep, copied = True, []
    for line in (CONFIG / "test_piece.nc").read_text().splitlines():
        if line.startswith("("):
            keep = line.strip("()") in names
        if keep or line.startswith(("N540", "N550")):
            copied.append(line.replace("M3", "M3 F4000"))
    path.write_text("\n".join(copied) + "\n")
    return path


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The square and the inclined side only."""
    return with_features(tmp_path_factory.mktemp("short") / "short.nc", "square", "inclined_side")


def test_the_posture_is_as_its_comment_says(cell):
    joints = np.degrees(cell.joints(cell.target()))
    lower, upper = np.degrees(cell.arm.joint_lower), np.degrees(cell.arm.joint_upper)
    assert min((joints - lower).min(), (upper - joints).min()) > 16
    assert joints[:, 4].max() < -50
    model = cell.modal_model
    soft = model.output @ model.shape @ np.diag(model.frequency**-2.0) @ model.shape.T @ model.force + model.feedthrough
    assert 0.45e-6 < soft[0, 0] < soft[1, 1] < 0.85e-6


def test_the_programme_asks_for_the_spindle_speed_and_the_feed_of_the_cell(cell):
    assert cell.feed_rate * 60 == pytest.approx(4.0)  # F4000
    per_tooth = cell.feed_rate * 2 * np.pi / cell.tool.spindle_speed / cell.tool.teeth
    assert per_tooth == pytest.approx(0.125e-3)


def test_the_square_is_left_too_large_by_tens_of_micrometres(short):
    cell = read_cell(CONFIG / "test_piece.yaml", [*COARSE, f"path.file={short}"])
    part = assess(cell, simulate(cell))
    square, inclined = part.rows
    assert (square.name, inclined.name) == ("square", "inclined_side")
    # half immersion, 1.2 mm deep: a mean force of some 90 N at 0.5 to 0.8 um/N; climb milling pushes the tool away
    assert 30e-6 < square.mean_wall < 80e-6 and inclined.mean_wall < square.mean_wall
    made = part.surface.walls.error[part.surface.walls.feature == part.path.features.index("square")]
    assert np.quantile(made, 0.02) > 0
    assert square.cut_length == pytest.approx(385e-3, rel=0.05)  # four sides of 100 mm less what the entry leaves


def test_simulate_prints_each_feature_and_writes_the_part(short, tmp_path, capsys):
    words = ["simulate", str(CONFIG / "test_piece.yaml"), "--set", f"path.file={short}"]
    for setting in COARSE:
        words += ["--set", setting]
    assert main([*words, "--json", "--out", str(tmp_path)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row["feature"] for row in found["features"]] == ["square", "inclined_side"]
    assert found["whole_part"]["max_wall_error_um"] == max(row["max_wall_error_um"] for row in found["features"])
    stl = tmp_path / "part.stl"
    assert str(stl) in found["files"] and stl.stat().st_size > 1_000_000
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "inclined_side" in text and "whole part" in text and "nan" not in text


def test_one_pass_of_inverse_leaves_a_twentieth_of_walls_and_floors_with_every_corner(tmp_path):
    """Sharp corners, helix, axial force and inertia of the arm. A fifth was asked for; a coarser cut is simulated."""
    path = with_features(tmp_path / "diamond.nc", "diamond")
    cell = read_cell(CONFIG / "test_piece.yaml", [*COARSE, f"path.file={path}"])
    assert cell.tool.helix > 0.0 and cell.cutting.axial and cell.dynamics.reference_inertia
    original = simulate(cell)
    before, after = assess_all(cell, (original, compensated(cell, original, "inverse")))
    assert before.whole.max_wall > 50e-6 and before.whole.max_floor > 50e-6
    assert after.whole.max_wall < before.whole.max_wall / 20 and after.whole.max_floor < before.whole.max_floor / 20
    assert after.whole.max_normal < before.whole.max_normal / 20  # while it cuts, also where the wall goes later
