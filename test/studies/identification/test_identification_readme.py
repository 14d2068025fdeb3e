"""The README of the folder: its commands run, its columns are those that are read, its bands are what comes out."""

from __future__ import annotations

import csv
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml

from kr270_milling.cli import main
from kr270_milling.studies.identification import cuts, measurements

ROOT = Path(__file__).resolve().parents[3]
TEXT = (ROOT / "kr270_milling" / "studies" / "identification" / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def ran(tmp_path_factory) -> dict:
    """Every command of the page in its order, in one directory; JSON of each."""
    place, outcome = tmp_path_factory.mktemp("page"), {}
    for name, text in re.findall(r"<!-- (\w+\.yaml) -->\n```yaml\n(.*?)```", TEXT, re.DOTALL):
        (place / name).write_text(text)
    ring(place / "ring.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        lines = [line for block in re.findall(r"```sh\n(.*?)```", TEXT, re.DOTALL) for line in block.splitlines()]
        for line in lines:
            words = shlex.split(line)[1:]
            out = place / f"{len(outcome)}.json"
            with out.open("w") as stream, pytest.MonkeyPatch.context() as quiet:
                quiet.setattr("sys.stdout", stream)
                assert main([*words, "--json"]) == 0, line
            outcome[line] = json.loads(out.read_text())
    return {"place": place, **outcome}


def ring(path) -> None:
    """A machine with modes at 11, 15 and 23 Hz, rung down."""
    t = 1e-3 * np.arange(3000)
    modes = [(11.0, 0.04, [0.1, 1.0, 0.0]), (15.0, 0.03, [1.0, -0.1, 0.2]), (23.0, 0.03, [0.1, 0.1, 1.0])]
    rings = [np.outer(np.exp(-z * 2 * np.pi * f * t) * np.cos(2 * np.pi * f * t), shape) for f, z, shape in modes]
    rows = np.column_stack([t, 1e-4 * sum(rings)])
    np.savetxt(path, rows, delimiter=",", header="time_s,x,y,z", comments="")


def result(ran: dict, *words: str) -> dict:
    (outcome,) = [value for line, value in ran.items() if all(word in line for word in words)]
    return outcome


def test_the_identified_arm_and_coefficients_are_those_that_the_examples_were_made_with(ran):
    arm = result(ran, "load_tests.csv")
    truth = np.array([0.26, 0.15, 0.26, 1.79, 1.52, 2.13]) * [1.18, 0.92, 1.10, 0.85, 1.12, 1.25]
    away = np.abs(np.array(arm["compliance_urad_per_n_m"]) - truth) / arm["ci95_urad_per_n_m"]
    assert all(arm["identifiable"]) and away.max() < 1.5
    forces = result(ran, "cuts.csv")
    for key, true in (("k_tc_n_per_mm2", 767.01), ("k_rc_n_per_mm2", 168.8), ("k_ac_n_per_mm2", 222.0)):
        assert abs(forces[key] - true) < 1.5 * forces["ci95"][key]


def test_the_bands_are_those_of_the_page_and_the_identified_one_is_narrower(ran):
    block = TEXT[TEXT.index("<!-- bands -->") :]
    shown = [[float(v) for v in re.findall(r"\d+", row)[-3:]] for row in re.findall(r"^\| .*%  ?\|$", block, re.M)]
    widths = []
    for row, command in zip(shown, ("before", "after"), strict=True):
        band = result(ran, "compensate", command)["verdict"]["original_mm"]
        widths.append((band[2] - band[0]) / (band[2] + band[0]))
        assert [1e3 * band[0], 1e3 * band[2], 100 * widths[-1]] == pytest.approx(row, rel=0.15)
    assert widths[1] < 0.7 * widths[0]


def test_the_plan_is_written_and_pays_as_the_page_states(ran):
    plan = result(ran, "--plan 12")
    errors = {design["name"]: design["error_um"] for design in plan["designs"]}
    ratio = errors["random (median of 201)"] / errors["planned for the test pose"]
    (sentence,) = re.findall(r"here (\d\.\d) times as large", TEXT)
    assert ratio == pytest.approx(float(sentence), abs=0.1)
    program = (ran["place"] / "plan" / "LOADTEST.src").read_text()
    assert program.count("PTP {A1 ") == 12 and program.count("HALT") == 24
    with (ran["place"] / "plan" / "plan.csv").open() as stream:
        rows = list(csv.reader(line for line in stream if not line.startswith("#")))
    assert len(rows) == 13 and set(rows[0]) <= set(measurements.COLUMNS)


def test_modes_are_written_as_the_cell_takes_them(ran):
    modes = result(ran, "identify damping")["modes"]
    assert [mode["frequency_hz"] for mode in modes] == pytest.approx([11.0, 15.0, 23.0], rel=2e-3)
    tree = yaml.safe_load((ran["place"] / "identified" / "modes.yaml").read_text())
    assert len(tree["/**"]["ros__parameters"]["dynamics"]["modes"]) == 3
    cell = ran["place"] / "rung.yaml"
    cell.write_text('/**:\n  ros__parameters:\n    includes: ["my_slot.yaml", "identified/modes.yaml"]\n')
    assert main(["simulate", str(cell), "--json"]) == 0


def test_every_column_of_the_page_is_read_and_every_column_that_is_read_is_there():
    named = set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| `.*?\|", TEXT, re.M))))
    ranges = {f"a{j}_deg" for j in range(1, 7)} | set(measurements.MASS)
    known = {*measurements.COLUMNS, *cuts.COLUMNS, "mode"}
    assert named <= known and known - named - ranges - {"note", *measurements.LOAD} == set()
