"""The report of a part: what its page says and shows."""

from __future__ import annotations

import html
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from milled_part import POCKET, RIGID, small_cell

from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.decision.part import assess_all
from kr270_milling.report import write_report
from kr270_milling.report.part_gallery import feature_table, part_gallery, part_verdict

NAMES = ["tool_path", "arm_posture", "deviation_map", "surface_map", "deviation_along_path", "loads"]
ABOUT = dict(title="A part", source="cell.yaml", command="kr270_milling simulate cell.yaml", date="2026-01-01")


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_cell(tmp_path_factory.mktemp("report"), POCKET.replace("(ring)", "(ring_a-1)"))


@pytest.fixture(scope="module")
def passes(cell):
    original = simulate(cell)
    return [original, compensated(cell, original, "spline")]


@pytest.fixture(scope="module")
def parts(cell, passes):
    return assess_all(cell, passes)


@pytest.fixture(scope="module")
def page(cell, passes, parts, tmp_path_factory):
    return write_report(tmp_path_factory.mktemp("out"), cell, passes, parts=parts, **ABOUT).read_text()


def test_the_pictures_are_whole_and_the_same_each_time(cell, passes, parts):
    first, second = part_gallery(cell, passes, parts), part_gallery(cell, passes, parts)
    assert [p.name for p in first] == NAMES
    for one, other in zip(first, second, strict=True):
        assert ET.fromstring(one.svg).tag.endswith("svg") and one.svg == other.svg
        assert len(one.svg) < 1_500_000


def test_maps_show_the_pass_before_and_the_one_after(parts, cell, passes):
    pictures = {p.name: p.svg for p in part_gallery(cell, passes, parts)}
    for name in ("deviation_map", "surface_map"):
        assert "original" in pictures[name] and "spline" in pictures[name]
        assert f"{parts[0].whole.max_normal * 1e6:.1f}" in pictures["deviation_map"]


def test_the_table_sets_each_feature_before_and_after_side_by_side(parts):
    table = feature_table(parts)
    assert [(feature, name) for feature, name, _ in table["rows"]] == [
        (feature, name) for feature in ("side", "ring_a-1", "whole part") for name in ("original", "spline")
    ]
    side = table["rows"][0][2]
    assert float(side[0]) == pytest.approx(parts[0].rows[0].max_normal * 1e6, abs=0.05)
    assert len(side) == len(table["head"])


def test_the_page_speaks_of_the_part_and_not_of_a_straight_cut(page, parts):
    assert part_verdict(parts) in html.unescape(page)
    assert "The part, feature by feature" in page and "Accuracy before and after" not in page
    for name in NAMES:
        assert f'<figure id="{name}">' in page
    assert "path.nc: 0." in page  # m of path
    assert not re.search(r'(src|href)="https?:', page)


def test_a_posture_that_is_followed_is_said(tmp_path):
    cell = small_cell(tmp_path, POCKET, "dynamics.follow_pose=true")
    text = write_report(tmp_path, cell, [simulate(cell)], **ABOUT).read_text()
    assert "follow the posture along the path" in text and "not compensated" in text


def test_a_part_without_any_error_has_pictures_too(tmp_path):
    cell = small_cell(tmp_path, POCKET, RIGID)
    rigid = [simulate(cell)]
    parts = assess_all(cell, rigid)
    assert np.nanmax(parts[0].whole.max_wall) < 1e-12
    assert len(part_gallery(cell, rigid, parts)) == len(NAMES)
