"""Tolerance and decision: what passes, what fails by how much and where, and that no refused program is written."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from small_part import GCODE, assignments, small_part

from kr270_milling.base.errors import ConfigError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.sections import Tolerances
from kr270_milling.cli import main
from kr270_milling.decide.tolerance import judge_part


def part(**features):
    rows = tuple(SimpleNamespace(name=n, max_wall=w, max_floor=f) for n, (w, f) in features.items())
    walls, floors = ([getattr(row, key) for row in rows] for key in ("max_wall", "max_floor"))
    whole = SimpleNamespace(max_wall=np.nanmax(walls), max_floor=np.nanmax(floors))
    return SimpleNamespace(rows=rows, whole=whole)


def cell_with(**tolerances):
    return SimpleNamespace(part=Tolerances(**tolerances))


def test_the_error_that_is_farthest_beyond_its_own_tolerance_decides():
    found = judge_part(
        cell_with(tolerance=50e-6, floor_tolerance=10e-6, features=("pocket=30",)),
        part(slot=(49e-6, 9e-6), pocket=(40e-6, np.nan)),
    )
    assert not found.passes and found.feature == "pocket" and found.tolerance == pytest.approx(30e-6)
    assert found.words == "largest wall or floor error misses 30 um (40 um at pocket)"


def test_all_within_passes_and_without_a_tolerance_nothing_is_said():
    rows = part(slot=(49e-6, 9e-6))
    assert judge_part(cell_with(tolerance=50e-6), rows).passes is True
    found = judge_part(cell_with(), rows)
    assert found.passes is None and found.wall == 49e-6 and found.error == 49e-6


@pytest.mark.parametrize("text", ["pocket", "=30", "pocket=", "pocket=-1", "pocket=nan"])
def test_a_feature_tolerance_that_cannot_be_meant_is_refused(text):
    with pytest.raises(ConfigError, match="part.features"):
        read_cell(find_file("paper.yaml"), [f'part.features=["{text}"]'])


def words(directory, *more: str, sets=()) -> list[str]:
    pairs = assignments(directory, GCODE, "compensation.method=linear", *sets)
    return ["compensate", "paper.yaml", "--no-verdict", "--out", str(directory / "out"), *more,
            *(part for pair in pairs for part in ("--set", pair))]  # fmt: skip


def test_compensate_leads_with_the_decision(tmp_path, capsys):
    assert main(words(tmp_path, sets=["part.tolerance_um=2000"])) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("decision: caution: largest wall or floor error meets 2000 um on the model (")


def test_a_refused_path_gets_no_program_or_a_marked_one(tmp_path, capsys):
    refused = ["limits.spindle_torque_n_m=0.001"]
    assert main(words(tmp_path, "--json", sets=refused)) == 1
    found = json.loads(capsys.readouterr().out)
    assert (
        found["decision"] == "no"
        and found["may_be_run"] is False
        and not any(k.startswith("krl") for k in found["programs"])
    )
    assert not list((tmp_path / "out").rglob("*.src"))
    assert main(words(tmp_path, "--json", "--force", sets=refused)) == 1
    programs = sorted((tmp_path / "out").rglob("*.src"))
    assert programs and all(path.name.startswith("NOT_RELEASED") for path in programs)
    stop = next(f for f in json.loads(capsys.readouterr().out)["check"]["findings"] if f["severity"] == "stop")
    for path in programs:
        header = " ".join(line.removeprefix("; ") for line in path.read_text().splitlines())
        assert stop["sentence"] in header and "decision: no: the path must not be run" in header


def test_the_decision_of_a_tool_path_has_walls_and_floors(tmp_path, capsys):
    assert small_part(tmp_path).part.of() == (0.0, 0.0)
    assert main(words(tmp_path, "--json", sets=["part.wall_tolerance_um=1"])) == 1
    found = json.loads(capsys.readouterr().out)
    before = found["as_programmed"]
    assert before["passes_tolerance"] is False and before["wall_um"] > 1 and before["floor_um"] >= 0
    assert found["recommended_method"] is None and found["method"] == "linear"
