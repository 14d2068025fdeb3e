from __future__ import annotations

import numpy as np
import pytest
import yaml

from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.record import Record, specs
from kr270_milling.cell.cell import read_cell
from kr270_milling.live.graph.processes import cell_text, write_cell_file


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
