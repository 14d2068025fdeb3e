"""Errors in measurements are noticed: each row runs the public command and states the sentence and the exit code."""

from __future__ import annotations

import csv
import dataclasses

import numpy as np
import pytest
from campaigns import TRUE, loads, measured
from hostile import answered, ask

from kr270_milling.base.parameter_file import find_file
from kr270_milling.studies.identification.measurements import write_measurements

ANGLES = tuple(f"a{j}_deg" for j in range(1, 7))
SHIFTS, FORCES = ("dx_mm", "dy_mm", "dz_mm"), ("fx_n", "fy_n", "fz_n")
LOAD = ("compliance", "load_tests.csv", "--arm", "kr270_2.yaml", "--cell", "test_piece.yaml")
CUT = ("forces", "cuts.csv", "--cell", "test_piece.yaml")


def times(names, factor: float, row: int | None = None):
    def change(rows) -> None:
        for values in rows if row is None else [rows[row]]:
            values.update({name: repr(factor * float(values[name])) for name in names if values.get(name)})

    return change


def swapped(one: str, other: str):
    def change(rows) -> None:
        for values in rows:
            values[one], values[other] = values[other], values[one]

    return change


def other_mode(rows) -> None:
    for values in rows:
        values["mode"] = {"up": "down", "down": "up"}.get(values["mode"], values["mode"])


TABLE = {
    "metres for mm": (LOAD, times(SHIFTS, 1e-3), 2, "displacements in m in the columns of mm"),
    "kgf for N": (LOAD, times(FORCES, 1 / 9.80665), 2, "forces in kgf in the columns of N?"),
    "kN for N": (LOAD, times(FORCES, 1e-3), 2, "forces in kN in the columns of N?"),
    "radians for degrees": (LOAD, times(ANGLES, np.pi / 180), 2, "radians in the columns of degrees?"),
    "x and y of the displacements swapped": (LOAD, swapped(*SHIFTS[:2]), 1, "x and y of the displacements swapped"),
    "x and y of the loads swapped": (LOAD, swapped(*FORCES[:2]), 1, "x and y of the loads swapped"),
    "wrong sign": (LOAD, times(SHIFTS, -1.0), 1, "the arm moved against its loads: look at the signs"),
    "one value ten times too large": (LOAD, times(["dx_mm"], 10.0, 9), 0, "test 10 contradicts the others"),
    "one large value ten times too large": (LOAD, times(["dz_mm"], 10.0, 4), 1, "test 5 contradicts the others"),
    "forces in kN": (CUT, times(FORCES, 1e-3), 0, "forces in kN in the columns of N?"),
    "feed per revolution": (CUT, times(["feed_per_tooth_mm"], 4.0), 0, "is feed_per_tooth_mm the feed per revolution?"),
    "up and down swapped": (CUT, other_mode, 1, "up and down milling are swapped?"),
    "one force ten times too large": (CUT, times(["fy_n"], 10.0, 3), 1, "cut 4 contradicts the others"),
    "one force three times too large": (CUT, times(["fy_n"], 3.0, 9), 0, "cut 10 contradicts the others"),
    "no force": (CUT, times(FORCES, 0.0), 1, "negative or zero, which no cut has"),
}


def rows_of(name: str) -> list[dict]:
    with open(find_file(name), encoding="utf-8") as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


def written(folder, rows: list[dict], separator: str = ",") -> str:
    path = folder / "table.csv"
    with open(path, "w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0], delimiter=separator)
        writer.writeheader()
        writer.writerows(rows)
    return str(path)


def run(kind: str, table: str, *words: str) -> tuple[int, str]:
    answer = ask("identify", kind, table, *words)
    assert "Warning" not in answer.out + answer.err
    return answer.code, answer.out + answer.err


@pytest.mark.parametrize("name", TABLE)
def test_an_error_is_named_and_no_file_comes_from_a_useless_result(name, tmp_path):
    """pytest turns every warning of Python into an error, so none reaches a terminal."""
    (kind, source, *words), change, code, sentence = TABLE[name]
    rows = rows_of(source)
    change(rows)
    ended, text = run(kind, written(tmp_path, rows), *words, "--out", str(tmp_path / "out"))
    assert (ended, sentence in text) == (code, True), text
    assert (tmp_path / "out" / f"{kind}.yaml").exists() == (code == 0)


@pytest.mark.parametrize("name", [name for name in TABLE if "times too large" in name])
def test_a_robust_fit_gives_what_the_table_without_the_error_gives(name, tmp_path):
    (kind, source, *words), change, _, _ = TABLE[name]
    key = "compliance_urad_per_n_m" if kind == "compliance" else "tangential_cutting_n_per_mm2"
    rows, results = rows_of(source), []
    for more in ((), ("--robust",)):
        results.append(answered("identify", kind, written(tmp_path, rows), *words, *more)[key])
        change(rows)
    np.testing.assert_allclose(results[1], results[0], rtol=0.06)


@pytest.mark.parametrize("command", [LOAD, CUT])
def test_a_shipped_table_raises_no_doubt_and_a_german_spreadsheet_is_the_same_table(tmp_path, command):
    """Columns separated by semicolons, a comma for the point."""
    kind, source, *words = command
    german = [{k: v if k == "note" else v.replace(".", ",") for k, v in row.items()} for row in rows_of(source)]
    shipped = answered("identify", kind, source, *words)
    assert shipped["doubts"] == [] and shipped["usable"]
    assert answered("identify", kind, written(tmp_path, german, ";"), *words) == shipped


def campaign(folder, arm=TRUE, signs=1) -> str:
    rng, path = np.random.default_rng(3), str(folder / "campaign.csv")
    tests = measured(loads(rng, 24), arm, rng)
    write_measurements(path, dataclasses.replace(tests, q=tests.q * signs))
    return path


def test_angles_of_another_sign_and_a_base_that_tilts_are_named(tmp_path):
    """A1 counted about +z, as ROS does."""
    table = campaign(tmp_path, signs=[-1, 1, 1, 1, 1, 1])
    code, text = run("compliance", table, "--arm", "test_piece.yaml")
    assert code == 1 and "with the sign of A1 changed" in text, text
    tilted = campaign(tmp_path, TRUE.replace(base_compliance=np.array([0.3e-6, 0.3e-6, 0.0])))
    code, text = run("compliance", tilted, "--arm", "test_piece.yaml")
    assert "the residuals look like a base that tilts by 0.3, 0.3 urad/(N m) about x, y" in text, text
    assert "fit it with --base (about z " in text and "base z" not in text
    code, text = run("compliance", tilted, "--arm", "test_piece.yaml", "--base")
    assert code == 0 and "look like a base" not in text
    assert "not identified: base z: it turns the arm as joint 1" in text
    assert answered("identify", "compliance", campaign(tmp_path), "--arm", "test_piece.yaml")["doubts"] == []
