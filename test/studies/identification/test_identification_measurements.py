"""Tables of load tests in and out."""

from __future__ import annotations

import numpy as np
import pytest
from campaigns import ARM, MOUNT
from examples import CONFIG, load_tests
from examples_cuts import cuts

from kr270_milling.base.errors import InputError
from kr270_milling.studies.identification.measurements import read_measurements, write_measurements

HEAD = "a1_deg,a2_deg,a3_deg,a4_deg,a5_deg,a6_deg"
POSTURE = "10,-80,100,20,30,40"


def read(tmp_path, columns: str, *rows: str):
    file = tmp_path / "tests.csv"
    file.write_text("# a note\n" + f"{HEAD},{columns}\n" + "".join(f"{POSTURE},{row}\n" for row in rows))
    return read_measurements(file, ARM, MOUNT)


def test_a_wrench_acts_at_the_tool_point_and_the_reflector_sits_there(tmp_path):
    result = read(tmp_path, "fx_n,fz_n,dx_mm,dy_mm,dz_mm,sigma_um", "100,-50,0.1,0.2,-0.3,15")
    assert result.q[0] == pytest.approx(np.radians([10, -80, 100, 20, 30, 40]))
    assert result.wrench[0].tolist() == [100, 0, -50, 0, 0, 0]
    assert result.application[0] == pytest.approx(MOUNT.xyz) and result.reflector[0] == pytest.approx(MOUNT.xyz)
    assert (
        result.displacement[0, :3] == pytest.approx([1e-4, 2e-4, -3e-4]) and np.isnan(result.displacement[0, 3:]).all()
    )
    assert result.sigma[0, :3] == pytest.approx(15e-6) and result.sigma_known


def test_a_mass_hangs_in_its_centre_and_the_reflector_is_at_its_stated_place(tmp_path):
    columns = "mass_kg,mass_centre_x_mm,mass_centre_y_mm,mass_centre_z_mm,reflector_x_mm,dx_mm,dy_mm,dz_mm"
    result = read(tmp_path, columns, "100,50,0,-400,120,0,0,-0.5")
    assert result.wrench[0] == pytest.approx([0, 0, -980.665, 0, 0, 0])
    assert result.application[0] == pytest.approx([0.05, 0, -0.4]) and result.reflector[0] == pytest.approx(
        [0.12, 0, 0]
    )
    assert not result.sigma_known


def test_what_is_written_is_read_again(tmp_path):
    first = read_measurements(CONFIG / "load_tests.csv", ARM, MOUNT)
    write_measurements(tmp_path / "again.csv", first)
    again = read_measurements(tmp_path / "again.csv", ARM, MOUNT)
    for name in ("q", "wrench", "application", "reflector", "displacement", "sigma"):
        assert getattr(again, name) == pytest.approx(getattr(first, name), nan_ok=True, abs=1e-12), name


@pytest.mark.parametrize(("made", "name"), [(load_tests, "load_tests.csv"), (cuts, "cuts.csv")])
def test_the_shipped_examples_are_what_their_makers_make(tmp_path, made, name):
    """To 1e-6 mm and 0.01 N: another machine may round otherwise."""
    made(tmp_path / name)
    texts = [(folder / name).read_text().splitlines() for folder in (CONFIG, tmp_path)]
    assert len(texts[0]) == len(texts[1]) and texts[0][:4] == texts[1][:4]
    for ours, theirs in zip(*texts, strict=True):
        for a, b in zip(ours.split(","), theirs.split(","), strict=True):
            assert a == b or float(a) == pytest.approx(float(b), abs=0.011 if name == "cuts.csv" else 1e-6)


@pytest.mark.parametrize(
    ("columns", "row", "text"),
    [
        ("dx_mm,dy_mm,dz_mm", "0,0,0", "neither a wrench nor a mass_kg"),
        ("fx_n,mass_kg,dx_mm,dy_mm,dz_mm", "1,1,0,0,0", "both a wrench and a mass"),
        ("fx_n,dx_mm,dy_mm,dz_mm", "0,0,0,0", "the load is zero"),
        ("mass_kg,dx_mm,dy_mm,dz_mm", "-5,0,0,-1", "mass_kg must be above 0"),
        ("fx_n,dx_mm,dy_mm,dz_mm", "1,250,0,0", "moved the arm by more than"),
        ("fx_n,dx_mm,dy_mm,dz_mm", "1,,0,0", "has no value in the column dx_mm"),
        ("fx_n,dx_mm,dy_mm,dz_mm,sigma_um", "1,0,0,0,0", "standard deviation must be above 0"),
        ("fx_n,dx_mm,dy_mm,dz_mm", "1,nan,0,0", "is not finite"),
    ],
)
def test_unusable_rows_are_refused_with_their_line(tmp_path, columns, row, text):
    with pytest.raises(InputError, match="line 3") as refused:
        read(tmp_path, columns, row)
    assert text in str(refused.value)


def test_a_misspelt_column_and_a_posture_out_of_the_limits_are_refused(tmp_path):
    with pytest.raises(InputError, match="did you mean sigma_um"):
        read(tmp_path, "fx_n,dx_mm,dy_mm,dz_mm,sigma_mu", "1,0,0,0,1")
    file = tmp_path / "far.csv"
    file.write_text(f"{HEAD},fx_n,dx_mm,dy_mm,dz_mm\n0,80,0,0,0,0,1,0,0,0\n")
    with pytest.raises(InputError, match="line 2.*joint limits"):
        read_measurements(file, ARM, MOUNT)
