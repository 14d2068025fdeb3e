"""The environment of node processes: discovery on this host only."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
import yaml

from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.record import Record, specs
from kr270_milling.cell.cell import read_cell
from kr270_milling.live.graph.processes import cell_text, write_cell_file
from kr270_milling.live.ros.environment import GUARD, PARENT, PROFILES, RANGE, child_environment, this_host_only


def test_shipped_profile_is_used_where_the_user_has_none():
    added = this_host_only({})
    assert added[PROFILES[0]].endswith("fastdds.xml") and os.path.isfile(added[PROFILES[0]])
    assert this_host_only({RANGE: "LOCALHOST"})[PROFILES[0]] == added[PROFILES[0]]


def test_profile_of_the_user_wins_and_discovery_stays_on_the_host():
    for name in PROFILES:
        assert this_host_only({name: "/my.xml"}) == {RANGE: "LOCALHOST"}
    assert this_host_only({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}) == {RANGE: "LOCALHOST"}


def test_user_who_opens_the_discovery_range_is_left_alone():
    assert this_host_only({RANGE: "SUBNET"}) == {}


def test_child_finds_its_own_libraries_and_knows_its_parent(monkeypatch):
    monkeypatch.setenv(GUARD, "1")
    environment = child_environment()
    assert GUARD not in environment
    assert environment[PARENT] == str(os.getpid())


def test_missing_ros_is_one_sentence_with_the_command_that_installs_it(tmp_path):
    hide = "import importlib.util as u; find = u.find_spec; u.find_spec = lambda n: None if n == 'rclpy' else find(n);"
    code = hide + "from kr270_milling.cli import main; raise SystemExit(main(['run', 'paper.yaml']))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert ran.returncode == 2
    assert "kr270_milling[ros]" in ran.stderr and ran.stderr.count("\n") == 1


# --- The cell file of a run: the numbers of the cell, bit for bit ---


def values(record: Record) -> list:
    result = []
    for spec in specs(type(record)):
        value = getattr(record, spec.name)
        result += values(value) if isinstance(value, Record) else [(spec.key, value)]
    return result


SETS = [(), ("tool.diameter_mm=12.7", "path.feed_rate_m_per_min=3.3", "mount.abc_deg=[0.1,89.9,0.7]")]


@pytest.mark.parametrize("assignments", SETS)
def test_cell_file_gives_the_same_numbers_bit_for_bit(tmp_path, assignments):
    cell = read_cell(find_file("paper.yaml"), assignments)
    write_cell_file(cell, tmp_path / "cell.yaml")
    again = read_cell(tmp_path / "cell.yaml")
    for (key, before), (_, after) in zip(values(cell), values(again), strict=True):
        missing = isinstance(before, float) and np.isnan(before)  # a coefficient of the law that is not in use
        assert np.array_equal(before, after, equal_nan=missing), key


def test_cell_file_needs_no_other_file_and_has_no_empty_list():
    tree = yaml.safe_load(cell_text(read_cell(find_file("paper.yaml"))))["/**"]["ros__parameters"]
    assert "includes" not in tree

    def leaves(value):
        return [v for child in value.values() for v in leaves(child)] if isinstance(value, dict) else [value]

    assert [] not in leaves(tree)


def test_tool_path_file_is_named_absolutely(tmp_path, monkeypatch):
    (tmp_path / "part.nc").write_text(find_file("test_piece.nc").read_text())
    (tmp_path / "cell.yaml").write_text(find_file("test_piece.yaml").read_text().replace("test_piece.nc", "part.nc"))
    monkeypatch.chdir(tmp_path)
    text = cell_text(read_cell("cell.yaml"))
    assert str(tmp_path / "part.nc") in text
