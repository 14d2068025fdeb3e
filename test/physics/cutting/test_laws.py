"""Force laws as functions of the chip thickness, and a third law that goes through every command."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cuttings import ALUMINIUM, PAPER_LAW
from hypothesis import given
from hypothesis import strategies as st

import kr270_milling
from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.record import build, find_file, flatten
from kr270_milling.cell.cell import read_cell
from kr270_milling.physics.cutting import AL7075_T6, KLIMCHIK2014, Cutting, fractional, linear_edge

thickness = st.floats(0.0, 1e-3)


def test_fractional_law_has_the_stiffness_k_0_at_first_and_r_k_0_at_last():
    law = PAPER_LAW.fractional
    slope = [(fractional(h + d, 5e6, 18e-6, 0.1) - fractional(h, 5e6, 18e-6, 0.1)) / d for h, d in ((0, 1e-10), (1, 1))]
    assert slope == pytest.approx([law.stiffness / 1e-3, law.ratio * law.stiffness / 1e-3], rel=1e-4)


@pytest.mark.parametrize("cutting", [PAPER_LAW, ALUMINIUM], ids=["fractional", "linear_edge"])
def test_no_chip_means_no_force(cutting):
    for h in (0.0, -1e-6, -1.0):
        assert cutting.force_per_depth(h) == (0.0, 0.0)


@given(thickness, thickness)
def test_a_thicker_chip_needs_more_force(a, b):
    for cutting in (PAPER_LAW, ALUMINIUM):
        low, high = (cutting.force_per_depth(h) for h in sorted((a, b)))
        assert low[0] <= high[0] and low[1] <= high[1]


@pytest.mark.parametrize("cutting", [PAPER_LAW, ALUMINIUM], ids=["fractional", "linear_edge"])
def test_arrays_give_what_numbers_give(cutting):
    h = np.linspace(-2e-5, 2e-4, 50)
    tangential, radial = cutting.force_per_depth(h)
    assert np.array_equal(tangential, [cutting.force_per_depth(x)[0] for x in h])
    assert np.array_equal(radial, [cutting.force_per_depth(x)[1] for x in h])


def test_linear_edge_law_jumps_in_with_the_edge_force():
    assert linear_edge(1e-12, 600.46e6, 17.9e3) == pytest.approx(17.9e3, rel=1e-6)
    assert linear_edge(1e-4, 600.46e6, 17.9e3) == pytest.approx(60.046e3 + 17.9e3)


LINEAR_EDGE = {
    "tangential_cutting_n_per_mm2": 700.0,
    "tangential_edge_n_per_mm": 17.9,
    "radial_cutting_n_per_mm2": 180.96,
    "radial_edge_n_per_mm": 20.42,
}
FRACTIONAL = {"stiffness_n_per_m": 5e6, "specific_chip_thickness_um": 18.0, "ratio": 0.1, "radial_ratio": 0.3}


def test_a_file_names_only_the_law_that_it_uses():
    cutting = build(Cutting, {"law": "linear_edge", "linear_edge": LINEAR_EDGE})
    assert cutting.coefficients == pytest.approx([700e6, 17.9e3, 180.96e6, 20.42e3, 0.0, 0.0])
    assert build(Cutting, {"fractional": FRACTIONAL}).coefficients == pytest.approx([5e6, 18e-6, 0.1, 0.3, 0.0])
    assert set(flatten(cutting)) == {
        "law",
        "moments",
        "chip_angle",
        "detail",
        "end_ratio",
        "fractional.axial_ratio",
    } | {f"linear_edge.{key}" for key in (*LINEAR_EDGE, "axial_cutting_n_per_mm2", "axial_edge_n_per_mm")}


@pytest.mark.parametrize("law, coefficients", [("linear_edge", LINEAR_EDGE), ("fractional", FRACTIONAL)])
def test_a_law_without_one_of_its_coefficients_is_refused_with_its_key(law, coefficients):
    for missing in coefficients:
        given = {key: value for key, value in coefficients.items() if key != missing}
        with pytest.raises(ConfigError, match=f"{law}.{missing}: has no value, it must be given where cutting.law is"):
            build(Cutting, {"law": law, law: given})
    with pytest.raises(ConfigError, match="has no value"):
        build(Cutting, {"law": law})
    with pytest.raises(ParameterError, match="must be given"):
        Cutting(law)


def test_not_a_number_is_not_a_missing_coefficient():
    with pytest.raises(ConfigError, match="nan is not usable"):
        build(Cutting, {"fractional": {**FRACTIONAL, "ratio": math.nan}})
    with pytest.raises(ConfigError, match="nan is not usable"):
        build(Cutting, {"fractional": FRACTIONAL, "linear_edge": {"radial_edge_n_per_mm": math.nan}})


def test_a_node_is_given_no_coefficient_that_the_cell_does_not_have():
    keys = flatten(read_cell(find_file("paper.yaml")))
    assert "cutting.fractional.ratio" in keys and "cutting.linear_edge.radial_edge_n_per_mm" not in keys


def test_the_axial_force_has_coefficients_of_its_own():
    steel = Cutting("linear_edge", linear_edge=AL7075_T6.replace(axial_cutting=220e6, axial_edge=1e3))
    assert steel.axial and not ALUMINIUM.axial and not PAPER_LAW.axial
    assert steel.axial_per_depth(1e-4) == pytest.approx(220e6 * 1e-4 + 1e3) and steel.axial_per_depth(0.0) == 0.0
    bent = Cutting(fractional=KLIMCHIK2014.replace(axial_ratio=0.4))
    assert bent.axial_per_depth(1e-4) == pytest.approx(0.4 * bent.force_per_depth(1e-4)[0])


@pytest.mark.parametrize("tree", [{"law": "kienzle"}, {"fractional": {"ratio": 1.5}}, {"fractional": {"ratio": True}}])
def test_unusable_laws_are_refused(tree):
    with pytest.raises(ConfigError):
        build(Cutting, tree)


# --- A third force law, one new file and one new row of the table, goes through every command that needs a law ---


HERE = Path(__file__).parent
PACKAGE = Path(kr270_milling.__file__).parent
K_C, M_C, RATIO = 700e6, 0.25, 0.35  # k_c1.1 [N/m^2], m_c, k_r: ordinary aluminium
SETTINGS = (
    "cutting.law=kienzle", "cutting.kienzle.specific_force_n_per_mm2=700", "cutting.kienzle.exponent=0.25",
    "cutting.kienzle.radial_ratio=0.35", "path.length_mm=16", "stock.grid_step_um=40", "stock.max_mm=[16,12,0]",
)  # fmt: skip


@pytest.fixture(scope="module")
def copy(tmp_path_factory) -> Path:
    """The package with the third law; the compiled code is copied too, so a law that changed it would be seen."""
    folder = tmp_path_factory.mktemp("third_law")
    shutil.copytree(PACKAGE, folder / "kr270_milling")
    shutil.copytree(PACKAGE.parent / "config", folder / "config")
    shutil.copy(PACKAGE.parent / "package.xml", folder)
    shutil.copy(HERE / "kienzle.py", folder / "kr270_milling/physics/cutting")
    table = folder / "kr270_milling/physics/cutting/laws.py"
    text = table.read_text(encoding="utf-8")
    row = '"linear_edge": LinearEdgeLaw'
    assert text.count(row) == 1
    text = text.replace(row, row + ', "kienzle": KienzleLaw')
    line = "from kr270_milling.physics.cutting.linear_edge import LinearEdgeLaw\n"
    text = text.replace(line, line + "from kr270_milling.physics.cutting.kienzle import KienzleLaw\n")
    table.write_text(text, encoding="utf-8")
    return folder


def run(copy: Path, *words: str) -> dict:
    """The JSON answer of a command of the copy."""
    program = "import sys; from kr270_milling.cli import main; sys.exit(main(sys.argv[1:]))"
    done = subprocess.run(
        [sys.executable, "-c", program, *words, "--json"], cwd=copy, env={**os.environ, "PYTHONPATH": str(copy)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def settings() -> list[str]:
    return [word for setting in SETTINGS for word in ("--set", setting)]


def kienzle_slot(feed: np.ndarray) -> np.ndarray:
    """Mean F_x, F_y (n, 2) [N] of a slot, 4 teeth, 1 mm deep, h = f cos(phi): N a / 2 pi times the closed integrals.

    int cos^(2 - m) = sqrt(pi) G(3/2 - m/2) / G(2 - m/2), int cos^(1 - m) sin = 0 over the half turn of a slot.
    """
    integral = math.sqrt(math.pi) * math.gamma(1.5 - M_C / 2) / math.gamma(2 - M_C / 2)
    tangential = 4 * 1e-3 / (2 * math.pi) * K_C * feed * (feed / 1e-3) ** -M_C * integral
    return np.stack([-RATIO * tangential, tangential], -1)


def test_a_slot_by_the_third_law_has_the_force_of_the_closed_form(copy):
    """The sweep, which was compiled before the law existed, calls the new law; 1 % as the other slots of the book."""
    program = (
        "import math, numpy as np\n"
        "from kr270_milling.physics.cutting import Cut, Cutting, Stock, Tool, LAWS\n"
        f"law = LAWS['kienzle']({K_C}, {M_C}, {RATIO})\n"
        "tool = Tool(diameter=0.02, teeth=4, spindle_speed=800.0)\n"
        "stock = Stock(min=np.array([0.0, -0.012, -5e-3]), max=np.array([0.03, 0.012, 0.0]), grid_step=10e-6)\n"
        "cut = Cut(tool, Cutting('kienzle', kienzle=law), stock, math.radians(1.0))\n"
        "cut.sweep([-0.011, 0.0, -1e-3], [0.012, 0.0, -1e-3], 0, 360 * 60)\n"
        "print(*cut.sweep([0.012, 0.0, -1e-3], [0.0124, 0.0, -1e-3], 360 * 60, 360)[:2])\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=copy, env=environment, capture_output=True, text=True, check=True
    )
    expected = kienzle_slot(np.array([0.1e-3]))[0]
    assert [float(word) for word in done.stdout.split()] == pytest.approx(expected, abs=0.01 * np.abs(expected).max())


def test_simulate_and_stability_take_the_third_law(copy):
    assert run(copy, "simulate", "paper.yaml", *settings())
    assert run(copy, "stability", "paper.yaml", *settings(), "--speeds", "8000:8000:1")


def test_compensate_has_a_verdict_with_the_third_law(copy, tmp_path):
    words = ["--method", "spline", "--verdict", "3", "--out", str(tmp_path)]
    verdict = run(copy, "compensate", "paper.yaml", *settings(), *words)["verdict"]
    assert verdict["samples"] == 3 and len(set(verdict["compensated_mm"])) == 3
    assert (tmp_path / "reference_spline.csv").is_file()


def test_identify_forces_fits_the_third_law(copy, tmp_path):
    feeds = np.array([0.04e-3, 0.08e-3, 0.12e-3, 0.16e-3, 0.2e-3])
    rows = [
        f"{1e3 * feed:.6g},1,20,slot,{fx:.12g},{fy:.12g}"
        for feed, (fx, fy) in zip(feeds, kienzle_slot(feeds), strict=True)
    ]
    (tmp_path / "cuts.csv").write_text("\n".join(["feed_per_tooth_mm,depth_mm,width_mm,mode,fx_n,fy_n", *rows]) + "\n")
    words = ["--teeth", "4", "--diameter-mm", "20", "--law", "kienzle", "--out", str(tmp_path / "out")]
    found = run(copy, "identify", "forces", str(tmp_path / "cuts.csv"), *words)["kienzle"]
    fitted = [found[key] for key in ("specific_force_n_per_mm2", "exponent", "radial_ratio")]
    assert fitted == pytest.approx([700.0, M_C, RATIO], rel=1e-3)
    (file,) = (tmp_path / "out").glob("*.yaml")
    assert "law: kienzle" in file.read_text(encoding="utf-8") and "force_coefficients" in file.read_text(
        encoding="utf-8"
    )
