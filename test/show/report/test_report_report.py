"""report: the page as a whole, for short passes of the paper's cell and of others."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from types import SimpleNamespace

import numpy as np
import pytest
from cuttings import SET_ALUMINIUM
from milled_part import POCKET, RIGID, small_cell

from kr270_milling.base.column import TextTable
from kr270_milling.base.errors import InputError
from kr270_milling.base.record import find_file, flatten
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import ScoredPass, simulate
from kr270_milling.decide.findings import Finding, Place
from kr270_milling.show.report import write_report
from kr270_milling.show.report.assumptions import assumptions, model_frequencies
from kr270_milling.show.report.page.page import plotly_script
from kr270_milling.show.report.tables import fixed_text

WORDS = dict(title="A pass", source="/elsewhere/some one/paper.yaml", command="kr270_milling demo", date="2025-01-02")
VOID = {"meta", "br", "img", "link", "hr", "input"}
MOST = 6_000_000  # [bytes] of a page


class Page(HTMLParser):
    """Tags with their attributes, and whether every one is closed in turn."""

    def __init__(self, text: str):
        super().__init__()
        self.tags, self.open, self.texts, self.scripts = [], [], [], []
        self.feed(text.replace(str(plotly_script()), ""))

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        inside = self.open[-1] if self.open else ""
        {"script": self.scripts, "style": []}.get(inside, self.texts).append(data)


def written(directory, cell, passes, **words) -> str:
    return write_report(directory, cell, passes, **{**WORDS, **words}).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def paper_page(straight, tmp_path_factory):
    return written(tmp_path_factory.mktemp("report"), *straight, paper=True)


@pytest.fixture(scope="module")
def part_page(milled, tmp_path_factory):
    return written(tmp_path_factory.mktemp("part"), *milled)


def test_the_page_is_well_formed_small_complete_and_needs_nothing_from_elsewhere(straight, paper_page):
    page = Page(paper_page)
    assert not page.open and set(flatten(straight[0])) <= set(page.texts)  # the whole configuration
    assert len(paper_page.encode()) < MOST
    names = {tag for tag, _ in page.tags}
    assert not names & {"link", "iframe", "object", "embed", "img", "base"}
    for tag, attributes in page.tags:
        assert not {"src", "href", "action"} & set(attributes), (tag, attributes)
        assert not any(key.startswith("on") for key in attributes)
    assert "default-src 'none'" in str(page.tags)
    assert sum(tag == "script" for tag, _ in page.tags) == 3  # data, plotly, our own
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'KR\.by\("(\w+)"\)', page.scripts[-1])) <= {*ids, "source"}


def test_no_path_of_this_machine_and_one_kind_of_minus_sign_in_the_texts(paper_page, part_page):
    for text in (paper_page, part_page):
        page = Page(text)
        assert not re.search("/elsewhere|some one|/tmp", "".join(page.texts))
        assert not [t for t in page.texts if re.search(r"(^|[ \[(])-\d", t)]


def test_the_papers_column_and_figures_are_there_only_for_the_paper(tmp_path, straight, paper_page):
    for number in ("58.10", "63.20", "0.14", "4.70", "6.70"):
        assert f'<td class="paper">{number}</td>' in paper_page
    for figure in (3, 11, 12, 13, 14, 15):
        assert f"(paper: Fig. {figure}" in paper_page
    other = written(tmp_path, *straight)
    assert 'class="paper"' not in other and "paper: Fig." not in other and "Table 2" not in other


def shown_decision(level: str, sentence: str, method: str, verdict: str) -> SimpleNamespace:
    return SimpleNamespace(
        level=level, sentence=sentence, method_text=method, notes=(sentence,), verdict=SimpleNamespace(text=verdict)
    )


def test_texts_from_files_are_escaped(tmp_path, straight):
    bad = "<script>alert(1)</script>\"'&"
    cell, (first, second, _) = straight
    hostile = [ScoredPass(bad, first.reference, first.result, first.scores), second]
    row = Finding("stop", bad, Place(3, 1, bad), 1.0, 1.0, bad, bad, bad)
    checked = SimpleNamespace(findings=(row,), stability=SimpleNamespace(text=bad), rapid_text=bad)
    words = dict.fromkeys(("title", "source", "command", "date"), bad)
    words |= {"decision": shown_decision("no", bad, bad, bad), "checked": checked}
    page = Page(written(tmp_path, cell.replace(arm=cell.arm.replace(name=bad)), hostile, paper=True, **words))
    assert sum(tag == "script" for tag, _ in page.tags) == 3 and not page.open
    assert page.texts.count(bad) >= 6  # title twice, command, date, tiles
    assert json.loads(page.scripts[0])["robot"]["name"] == bad


def test_the_decision_leads_the_page(tmp_path, straight):
    finding = Finding(
        "warning", "correction per tick", Place(12, 7, "ring"), 31.0, 30.0, "um", "Feed slower.", "it is 31 um", 3
    )
    checked = SimpleNamespace(findings=(finding,), stability=SimpleNamespace(text="stability: stable"), rapid_text="")
    decision = shown_decision("caution", "few robots", "method: spline, as set", "helps (1 to 3 um)")
    table = TextTable("Another table", ("pass", "value"), (("original", "-1.5"), ("other-2", "-0.00000")))
    cell, passes = straight
    cell = cell.replace(part=cell.part.replace(tolerance=30e-6))
    text = written(tmp_path, cell, passes, decision=decision, checked=checked, tables=[table])
    page = Page(text)
    order = ["caution", "few robots", "fails", "30 µm allowed", "passes", "warning", "Feed slower.",
             "ring, line 7, XP12", "spline", "helps", "1 to 3 µm", "stable", "Another table"]  # fmt: skip
    places = [next(k for k, text in enumerate(page.texts) if word in text) for word in order]
    assert places == sorted(places)
    assert '<div class="tile caution edge">' in text  # the verdict, in the colour of the decision
    assert '<div class="tile caution">' in text
    assert "\u22121.5" in page.texts and "0.00000" in page.texts and "other-2" in page.texts
    assert 'data-point="12"' in text and "it is 31 µm" in text and "3 places" in text


def test_a_report_without_a_pass_is_refused(tmp_path, straight):
    with pytest.raises(InputError):
        write_report(tmp_path, straight[0], [], **WORDS)


@pytest.mark.parametrize(
    "changes",
    [
        ["path.length_mm=0.1"],  # three exchange periods, never engaged
        ["path.start_mm=[-30.0, 0.0]", "path.length_mm=5.0"],  # in the air: no force at all
        ["path.start_mm=[-10.0, -10.0]", "path.length_mm=15.0", "stock.min_mm=[0.0, -10.0, -10.0]"],  # one wall
        [
            "tool.teeth=3",
            "tool.rotation=counterclockwise",
            *SET_ALUMINIUM,
            "dynamics.mass_model=consistent",
            "path.length_mm=11.0",
        ],
    ],
)
def test_passes_of_other_cells_are_reported_without_complaint(tmp_path, changes):
    other = read_cell(find_file("paper.yaml"), ["stock.grid_step_um=50.0", *changes])
    data = json.loads(Page(written(tmp_path, other, [simulate(other)])).scripts[0])
    profile = [chart for chart in data["charts"] if chart["name"] == "machined_profile"]
    walls = [panel["title"] for chart in profile for panel in chart["panels"]]
    if changes[0] == "path.start_mm=[-10.0, -10.0]":
        assert walls == ["left wall"]  # no material is left to the right


def test_a_part_shows_its_features_its_source_and_its_tolerance_also_without_any_error(tmp_path, part_page):
    page = Page(part_page)
    data = json.loads(page.scripts[0])
    assert "ring" in page.texts and "Feature by feature" in page.texts
    assert data["tolerance_um"] == pytest.approx([30.0, 30.0])
    assert data["linked"]["source"][2]["text"] == "G0 X-28 Y8 Z2"
    assert data["linked"]["source_name"] == "path.nc"
    evil = "(</title></svg><script>evil</script>)"
    rigid = small_cell(tmp_path, POCKET.replace("(ring)", evil), RIGID)
    text = written(tmp_path, rigid, [simulate(rigid)])
    assert 'id="map_after"' in text and evil not in text
    assert evil in [line["text"] for line in json.loads(Page(text).scripts[0])["linked"]["source"]]


def test_the_assumption_table_quotes_this_cell_and_the_derived_numbers(straight):
    rows = {a.point: a for a in assumptions(straight[0], paper=True)}
    # facts: one tooth at full chip feels 133.3 N per mm in our reading, 7.4 kN to the letter
    assert "133.3 N" in rows["reading of (26)"].value
    assert "7.4 kN" in rows["reading of (26)"].reason
    assert "533.3 Hz" in rows["tooth passing frequency"].value
    assert "0.150 s" in rows["radial engagement"].value
    modes = model_frequencies(straight[0])
    assert modes["lumped"][0] == pytest.approx(6.69, abs=0.02)  # sqrt(1 / (0.717 um/N 790.4 kg)) / 2 pi
    assert 11.0 < modes["consistent"][0] < 14.0
    for hertz in (modes["lumped"][0], modes["consistent"][0]):
        assert f"{hertz:.2f}" in rows["mass model"].value
    linear = read_cell(find_file("paper.yaml"), [*SET_ALUMINIUM, "path.length_mm=12.0"])
    points = {a.point for a in assumptions(linear, paper=False)}
    assert "mass model" in points
    assert not points & {"depth of cut a_p", "damping ratio", "arm variant", "reading of (26)"}


def test_a_rounded_zero_has_no_sign_and_a_missing_number_is_a_dash():
    assert [fixed_text(value, 2) for value in (-0.001, -0.09, np.nan)] == ["0.00", "\u22120.09", "–"]
