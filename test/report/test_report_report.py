"""report: the page as a whole, for short passes of the paper's cell and of others."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import numpy as np
import pytest

from kr270_milling.base.errors import InputError
from kr270_milling.base.record import find_file, flatten
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import ScoredPass, compensated, simulate
from kr270_milling.report import write_report
from kr270_milling.report.assumptions import assumptions, mode_frequencies
from kr270_milling.report.gallery import gallery
from kr270_milling.report.html import fixed, verdict

SHORT = ["path.length_mm=12.0", "stock.grid_step_um=40.0"]
WORDS = dict(title="A pass", source="paper.yaml", command="kr270_milling demo", date="2025-01-02")
VOID = {"meta", "br", "img", "link", "hr", "input"}


class Page(HTMLParser):
    """Tags with their attributes, and whether every one is closed in turn."""

    def __init__(self, text: str):
        super().__init__()
        self.tags, self.open, self.texts = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


@pytest.fixture(scope="module")
def cell():
    return read_cell(find_file("paper.yaml"), SHORT)


@pytest.fixture(scope="module")
def passes(cell):
    original = simulate(cell)
    return [original, *(compensated(cell, original, m) for m in ("linear", "spline"))]


@pytest.fixture(scope="module")
def written(tmp_path_factory, cell, passes):
    directory = tmp_path_factory.mktemp("report")
    path = write_report(directory, cell, passes, paper=True, **WORDS)
    return path, path.read_text(encoding="utf-8")


def test_the_page_is_well_formed_and_needs_nothing_from_elsewhere(written):
    page = Page(written[1])
    assert not page.open
    names = {tag for tag, _ in page.tags}
    assert not names & {"script", "link", "iframe", "object", "embed", "img", "base"}
    for tag, attributes in page.tags:
        for key in ("src", "href", "xlink:href", "data", "action"):
            assert (attributes.get(key) or "#").startswith("#"), (tag, attributes)
        assert not any(key.startswith("on") for key in attributes)
    assert "@import" not in written[1]
    assert not re.search(r"url\((?!#)", written[1])
    web = set(re.findall(r"https?://[^\s\"'<]+", written[1]))
    assert web <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}  # names of name spaces


def test_every_id_is_there_once_and_every_reference_finds_one(written):
    ids = re.findall(r' id="([^"]*)"', written[1])
    assert len(ids) == len(set(ids))
    used = set(re.findall(r'url\(#([^)]*)\)|href="#([^"]*)"', written[1]))
    assert {a or b for a, b in used} <= set(ids)


def test_the_scores_stand_in_the_page_as_they_were_given(written, passes):
    for one in passes:
        for value, digits in (
            (one.scores.static_deviation * 1e6, 2),
            (one.scores.max_deviation * 1e6, 2),
            (one.scores.low_frequency, 2),
            (one.scores.ringing_damping, 3),
        ):
            assert f"<td>{fixed(value, digits)}</td>" in written[1]


def test_the_papers_column_is_there_only_for_the_paper(tmp_path, cell, passes, written):
    for number in ("58.10", "63.20", "0.14", "4.70", "6.70"):
        assert f'<td class="paper">{number}</td>' in written[1]
    other = write_report(tmp_path, cell, passes, **WORDS).read_text(encoding="utf-8")
    assert 'class="paper"' not in other
    assert "paper: Fig." not in other
    assert "Table 2" not in other


def test_the_whole_configuration_is_listed(written, cell):
    page = Page(written[1])
    for key in flatten(cell):
        assert key in page.texts


def test_figures_are_files_of_their_own_that_parse_as_xml(written):
    files = sorted((written[0].parent / "figures").iterdir())
    assert len(files) == 9
    for path in files:
        assert ET.parse(path).getroot().tag == "{http://www.w3.org/2000/svg}svg"
        assert path.stat().st_size < 150_000
    assert not list(written[0].parent.rglob("*.part"))


def test_texts_from_files_are_escaped(tmp_path, cell, passes):
    bad = "<script>alert(1)</script>\"'&"
    hostile_cell = cell.replace(arm=cell.arm.replace(name=bad))
    first = passes[0]
    hostile = [ScoredPass(bad, first.reference, first.result, first.scores), passes[1]]
    path = write_report(tmp_path, hostile_cell, hostile, title=bad, source=bad, command=bad, date=bad, paper=True)
    page = Page(path.read_text(encoding="utf-8"))
    assert "script" not in {tag for tag, _ in page.tags}
    assert page.texts.count(bad) >= 6  # title twice, source, arm, command, date, pass
    assert not page.open


def test_a_second_report_replaces_the_first_and_has_the_same_figures(tmp_path, cell, passes, written):
    before = {p.name: p.read_bytes() for p in (written[0].parent / "figures").iterdir()}
    for _ in range(2):
        write_report(tmp_path, cell, passes, paper=True, **WORDS)
    assert {p.name: p.read_bytes() for p in (tmp_path / "figures").iterdir()} == before


def test_a_report_without_a_pass_is_refused(tmp_path, cell):
    with pytest.raises(InputError):
        write_report(tmp_path, cell, [], **WORDS)


@pytest.mark.parametrize(
    "changes",
    [
        ["path.length_mm=0.1"],  # three exchange periods, never engaged
        ["path.start_mm=[-30.0, 0.0]", "path.length_mm=5.0"],  # in the air: no force at all
        ["path.start_mm=[-10.0, -10.0]", "path.length_mm=15.0", "stock.min_mm=[0.0, -10.0, -10.0]"],  # one wall
        ["tool.teeth=3", "tool.rotation=counterclockwise", "cutting.law=linear_edge", "path.length_mm=11.0"],
        ["dynamics.mass_model=consistent", "dynamics.damping_ratio=0.03", "path.length_mm=11.0"],
    ],
)
def test_passes_of_other_cells_are_drawn_without_complaint(changes):
    other = read_cell(find_file("paper.yaml"), ["stock.grid_step_um=50.0", *changes])
    for picture in gallery(other, [simulate(other)]):
        ET.fromstring(picture.svg)
        assert "nan" not in re.sub(r">[^<]*<", "><", picture.svg)


def test_no_wall_is_drawn_where_no_material_is_left(cell):
    half = read_cell(
        find_file("paper.yaml"), ["path.start_mm=[-10.0, -5.0]", "stock.min_mm=[0.0, -10.0, -10.0]", *SHORT]
    )
    (profile,) = (p for p in gallery(half, [simulate(half)]) if p.name == "machined_profile")
    assert "left wall" in profile.svg
    assert "right wall" not in profile.svg


def test_the_assumption_table_quotes_this_cell_and_the_derived_numbers(cell):
    rows = {a.point: a for a in assumptions(cell, paper=True)}
    # facts: one tooth at full chip feels 133.3 N per mm in our reading, 7.4 kN to the letter
    assert "133.3 N" in rows["reading of (26)"].value
    assert "7.4 kN" in rows["reading of (26)"].reason
    assert "533.3 Hz" in rows["tooth passing frequency"].value
    assert "0.150 s" in rows["radial engagement"].value
    modes = mode_frequencies(cell)
    assert modes["lumped"][0] == pytest.approx(6.69, abs=0.02)  # sqrt(1 / (0.717 um/N 790.4 kg)) / 2 pi
    assert 11.0 < modes["consistent"][0] < 14.0
    for hertz in (modes["lumped"][0], modes["consistent"][0]):
        assert f"{hertz:.2f}" in rows["mass model"].value


def test_assumptions_about_the_papers_text_are_left_out_for_another_cell(cell):
    linear = read_cell(find_file("paper.yaml"), ["cutting.law=linear_edge", *SHORT])
    points = {a.point for a in assumptions(linear, paper=False)}
    assert "mass model" in points
    assert not points & {"depth of cut a_p", "damping ratio", "arm variant", "reading of (26)"}


def test_the_verdict_names_before_after_and_the_method(passes):
    text = verdict(passes)
    best = min(passes[1:], key=lambda p: p.scores.max_deviation)
    assert f"{passes[0].scores.max_deviation * 1e6:.2f} µm before" in text
    assert f"{best.scores.max_deviation * 1e6:.2f} µm after ('{best.name}')" in text
    assert "not compensated" in verdict(passes[:1])


def test_a_rounded_zero_has_no_sign_and_a_missing_number_is_a_dash():
    assert fixed(-0.001, 2) == "0.00"
    assert fixed(-0.09, 2) == "−0.09"
    assert fixed(np.nan, 2) == "–"
