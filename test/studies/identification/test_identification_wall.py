"""A measured wall beside the predicted wall: signs, size, factor, the page that asks for data, refused tables."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from kr270_milling import read_cell
from kr270_milling.cli import main
from kr270_milling.studies.identification.wall import compare_wall, read_wall

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "kr270_milling/guide/call_for_data.md").read_text(encoding="utf-8")
QUICK = ["--set", "stock.grid_step_um=40", "--set", "exchange.micro_step_deg=3", "--plants", "4"]


def table(folder, *rows: str, header: str = "x_mm,y_mm,error_um") -> str:
    path = folder / "wall.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return str(path)


def test_the_walls_of_the_slot_are_off_by_the_static_deviation_of_table_2(tmp_path):
    """58.1 um [Klimchik2014], Table 2: the tool moves to the left, cuts the left wall away and leaves the right one."""
    rows = [f"{x},{y},0" for y in (10, -10) for x in (40, 50, 60)]
    compared = compare_wall(read_cell("paper.yaml"), read_wall(table(tmp_path, *rows)), plants=4)
    np.testing.assert_allclose(compared.predicted, 58.1e-6 * np.array([-1] * 3 + [1] * 3), atol=0.5e-6)
    assert np.all(compared.low < compared.predicted) and np.all(compared.predicted < compared.high)


def test_the_factor_of_the_example_returns():
    """1.2, which ``config/wall.csv`` was made with; test_readme.py compares the line with what the command prints."""
    factor, half_width = re.search(r"^measured = ([\d.]+) \+- ([\d.]+) times predicted", PAGE, re.MULTILINE).groups()
    assert float(factor) == pytest.approx(1.2, abs=float(half_width)) and float(half_width) < 0.05


@pytest.mark.parametrize(
    "header, rows, reason",
    [
        (
            "x_mm,y_mm,error_um",
            ["40,10,-58", "40,20,-58", "50,10,-58"],
            "line 3: the place 40, 20 mm is farther than 2",
        ),
        ("x_mm,y_mm,error_um", ["40,10,-58000"] * 3, "line 2: error_um must be in um and at most 5000"),
        ("x_mm,y_mm,error_um", ["40,10,-58"], "has 1 places, but a comparison needs at least 3"),
        ("x_mm,y_mm", ["40,10"], "has no column error_um"),
    ],
)
def test_a_table_that_cannot_be_compared_is_refused_with_its_line(header, rows, reason, tmp_path, capsys):
    assert main(["compare", table(tmp_path, *rows, header=header), "paper.yaml", *QUICK]) == 2
    error = capsys.readouterr().err
    assert all(part in error for part in reason.split(": ")), error
