"""The report: the page as a whole, for short passes of the paper's cell and of others, and its series."""

import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from budget import budget
from hypothesis import given, settings
from hypothesis import strategies as st
from samples.cuttings import SET_ALUMINIUM
from samples.milled_part import POCKET, RIGID, small_cell

from kr270_milling.base.errors import InputError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.record import flatten
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import ScoredPass, simulate
from kr270_milling.cell.models import arm_of, cut_of, path_of
from kr270_milling.decide.findings import Finding, Place
from kr270_milling.decide.part import assess_all
from kr270_milling.path.trajectory import read_csv
from kr270_milling.show.report import write_report
from kr270_milling.show.report.charts import amplitude_spectrum, envelope_index, thinned_spectrum
from kr270_milling.show.report.linked import linked, part_surface
from kr270_milling.show.report.page import plotly_script
from kr270_milling.show.report.series import deviation_of, file_names, series_columns, write_series
from kr270_milling.show.report.straight_cut import machined_profile, micro_step_forces
from kr270_milling.show.report.tables import assumptions, fixed_text, model_frequencies

WORDS = dict(title="A pass", source="/elsewhere/some one/paper.yaml", command="kr270_milling demo", date="2025-01-02")
VOID = {"meta", "br", "img", "link", "hr", "input"}


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


def test_the_page_is_well_formed_small_complete_and_needs_nothing_from_elsewhere(straight, paper_page, part_page):
    for text in (paper_page, part_page):  # no path of this machine, one kind of minus sign
        texts = Page(text).texts
        assert not re.search("/elsewhere|some one|/tmp", "".join(texts))
        assert not [t for t in texts if re.search(r"(^|[ \[(])-\d", t)]
    page = Page(paper_page)
    assert not page.open and set(flatten(straight[0])) <= set(page.texts)  # the whole configuration
    assert len(paper_page.encode()) < 6_000_000
    assert not any({"src", "href", "action"} & set(attributes) for _, attributes in page.tags)
    assert "default-src 'none'" in str(page.tags)
    assert sum(tag == "script" for tag, _ in page.tags) == 3  # data, plotly, our own
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'KR\.by\("(\w+)"\)', page.scripts[-1])) <= {*ids, "source"}


def test_the_papers_column_and_figures_are_there_only_for_the_paper(tmp_path, straight, paper_page):
    assert {"58.10", "63.20", "0.14", "4.70", "6.70"} <= set(re.findall(r'"paper">([\d.]+)</td>', paper_page))
    assert {"3", "11", "12", "13", "14", "15"} <= set(re.findall(r"\(paper: Fig. (\d+)", paper_page))
    other = written(tmp_path, *straight)
    assert 'class="paper"' not in other and "paper: Fig." not in other and "Table 2" not in other
    with pytest.raises(InputError):
        write_report(tmp_path, straight[0], [], **WORDS)


def shown_decision(level: str, sentence: str, method: str, verdict: str) -> SimpleNamespace:
    text = SimpleNamespace(text=verdict)
    return SimpleNamespace(
        level=level, sentence=sentence, method_text=method, notes=(sentence,), verdict=text, limits=()
    )


def test_texts_from_files_are_escaped(tmp_path, straight):
    bad = "<script>alert(1)</script>\"'&"
    cell, (first, second, _) = straight
    hostile = [ScoredPass(bad, first.reference, first.result, first.scores), second]
    row = Finding("stop", bad, Place(3, 1, bad), 1.0, 1.0, bad, bad, bad, 1, {})
    checked = SimpleNamespace(findings=(row,), stability=SimpleNamespace(text=bad), rapid_text=bad)
    words = dict.fromkeys(("title", "source", "command", "date"), bad)
    words |= {"decision": shown_decision("no", bad, bad, bad), "checked": checked}
    page = Page(written(tmp_path, cell.replace(arm=cell.arm.replace(name=bad)), hostile, paper=True, **words))
    assert sum(tag == "script" for tag, _ in page.tags) == 3 and not page.open
    assert page.texts.count(bad) >= 6  # title twice, command, date, tiles
    assert json.loads(page.scripts[0])["robot"]["name"] == bad and not set("<>&") & set(page.scripts[0])


def test_the_decision_leads_the_page(tmp_path, straight):
    row = Finding("warning", "correction", Place(12, 7, "ring"), 31.0, 30.0, "um", "Feed slower.", "it is 31 um", 3, {})
    checked = SimpleNamespace(findings=(row,), stability=SimpleNamespace(text="stability: stable"), rapid_text="")
    decision = shown_decision("caution", "few robots", "method: spline, as set", "helps (1 to 3 um)")
    cell, passes = straight
    cell = cell.replace(tolerances=cell.tolerances.replace(tolerance=30e-6))
    text = written(tmp_path, cell, passes, decision=decision, checked=checked)
    order = ["caution", "few robots", "fails", "30 µm allowed", "passes", "warning", "it is 31 µm", "Feed slower.",
             "ring, line 7, XP12", "spline", "helps", "1 to 3 µm", "stable"]  # fmt: skip
    texts = Page(text).texts
    places = [next(k for k, text in enumerate(texts) if word in text) for word in order]
    assert places == sorted(places) and 'data-point="12"' in text and "3 places" in text


@pytest.mark.parametrize("changes", [
    ["path.length_mm=0.1"],  # three exchange periods, never engaged
    ["path.start_mm=[-30.0, 0.0]", "path.length_mm=5.0"],  # in the air: no force at all
    ["path.start_mm=[-10.0, -10.0]", "path.length_mm=15.0", "stock.min_mm=[0.0, -10.0, -10.0]"],  # one wall
    ["tool.teeth=3", "tool.rotation=counterclockwise", *SET_ALUMINIUM, "dynamics.mass_model=consistent"],
])  # fmt: skip
def test_passes_of_other_cells_are_reported_without_complaint(tmp_path, changes):
    other = read_cell(find_file("paper.yaml"), ["path.length_mm=11", "stock.grid_step_um=50.0", *changes])
    assert not Page(written(tmp_path, other, [simulate(other)])).open


def test_a_part_shows_its_features_its_source_and_its_tolerance_also_without_any_error(tmp_path, part_page):
    page = Page(part_page)
    data = json.loads(page.scripts[0])
    assert "ring" in page.texts and data["tolerance_um"] == pytest.approx([30.0, 30.0])
    evil = "(</title></svg><script>evil</script>)"
    rigid = small_cell(tmp_path, POCKET.replace("(ring)", evil), RIGID)
    text = written(tmp_path, rigid, [simulate(rigid)])
    assert 'id="map_after"' in text and evil not in text
    assert evil in [line["text"] for line in json.loads(Page(text).scripts[0])["linked"]["source"]]


def test_the_assumption_table_quotes_this_cell_and_the_derived_numbers(straight):
    rows = {point: f"{value} {reason}" for point, value, reason in assumptions(straight[0], paper=True)}
    # facts: one tooth at full chip feels 133.3 N per mm in our reading, 7.4 kN to the letter
    modes = model_frequencies(straight[0])
    assert modes["lumped"][0] == pytest.approx(6.69, abs=0.02)  # sqrt(1 / (0.717 um/N 790.4 kg)) / 2 pi
    for point, words in (
        ("reading of (26)", ("133.3 N", "7.4 kN")),
        ("tooth passing frequency", ("533.3 Hz",)),
        ("radial engagement", ("0.150 s",)),
        ("mass model", [f"{modes[model][0]:.2f}" for model in ("lumped", "consistent")]),
    ):
        assert all(word in rows[point] for word in words), point
    linear = read_cell(find_file("paper.yaml"), [*SET_ALUMINIUM, "path.length_mm=12.0"])
    points = {point for point, *_ in assumptions(linear, paper=False)}
    assert "mass model" in points and not points & {"depth of cut a_p", "damping ratio", "reading of (26)"}


def test_a_rounded_zero_has_no_sign_and_a_missing_number_is_a_dash():
    assert [fixed_text(value, 2) for value in (-0.001, -0.09, np.nan)] == ["0.00", "\u22120.09", "–"]


# --- series: CSV files, and names that stay inside the directory ---
def test_every_series_comes_back_with_twelve_digits_and_every_reference_with_its_joints(tmp_path, straight):
    def close(table, expected):  # a number of thirteen digits is wrong by half of the last one at most
        np.testing.assert_allclose(table, expected, rtol=5e-13, atol=0)

    cell, passes = straight
    paths = write_series(tmp_path, arm_of(cell), path_of(cell).target, passes)
    assert [p.name for p in paths[:3]] == ["original.csv", "linear.csv", "spline.csv"]
    for path, one in zip(paths[:3], passes, strict=True):
        names = list(series_columns(one.result, path_of(cell).target))
        assert path.read_text().splitlines()[0] == ",".join(names) and len(names) == 27
        table = dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
        r = one.result
        np.testing.assert_allclose(table["time_s"], r.time_ns * 1e-9, rtol=1e-15)
        for k, axis in enumerate("xyz"):
            for kind in ("target", "reference", "tool", "actual"):
                close(table[f"{kind}_{axis}_mm"], 1e3 * getattr(r, kind)[:, k])
            close(table[f"deflection_{axis}_um"], 1e6 * r.deflection[:, k])
            close(table[f"deflection_r{axis}_deg"], np.degrees(r.deflection[:, 3 + k]))
            close(table[f"force_{axis}_n"], r.wrench[:, k])
            close(table[f"moment_{axis}_n_m"], r.wrench[:, 3 + k])
        close(table["path_deviation_um"], 1e6 * deviation_of(r, path_of(cell).target))
        close(table["pose_correction_um"], 1e6 * r.correction)
    trajectory, joints = read_csv(paths[5])
    np.testing.assert_array_equal(trajectory.position, passes[2].reference.position)
    np.testing.assert_array_equal(trajectory.velocity, passes[2].reference.velocity)
    np.testing.assert_allclose(joints, arm_of(cell).joints(passes[2].reference), atol=1e-12)


def test_file_names_are_plain_inside_the_directory_and_different_even_without_regard_to_case(tmp_path, straight):
    cell, (first, *_) = straight
    write_series(tmp_path / "out", arm_of(cell), path_of(cell).target, [dataclasses.replace(first, name="../../etc/x")])
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    names = file_names(["a b", "a/b", "A_B", "", "..", "../../etc/x", "x" * 300, "Ω"])
    assert len({n.lower() for n in names}) == len(names)
    assert all(n.strip("_") and re.fullmatch(r"[A-Za-z0-9_-]{1,64}", n) for n in names)


# --- report.charts and report.straight_cut: micro-step forces, spectra, walls ---
def test_micro_step_forces_average_to_the_wrench_of_each_exchange_period():
    cell = read_cell(find_file("paper.yaml"), ["path.length_mm=6.0", "stock.grid_step_um=20.0"])
    result = simulate(cell).result
    force = micro_step_forces(cut_of(cell), result.tool, path_of(cell).clock.micro_steps)
    means = force.reshape(-1, path_of(cell).clock.micro_steps, 3).mean(axis=1)
    assert np.abs(result.wrench[1:, 1]).max() > 10.0
    np.testing.assert_allclose(means, result.wrench[1:, :3], atol=1e-9)


def test_an_amplitude_is_read_from_the_spectrum():
    time = np.arange(4800) / 4800
    values = 3.0 + 2.0 * np.sin(2 * np.pi * 100 * time) + 0.5 * np.cos(2 * np.pi * 533 * time)
    frequency, amplitude = amplitude_spectrum(values, 1 / 4800)
    assert amplitude[frequency == 100.0] == pytest.approx(2.0, rel=1e-9)
    assert amplitude[frequency == 533.0] == pytest.approx(0.5, rel=1e-9)
    assert amplitude[np.abs(frequency - 1000) < 100].max() < 1e-9


def test_thinning_a_spectrum_loses_no_peak():
    frequency, amplitude = np.arange(1, 40_001) * 0.1, np.ones(40_000)
    amplitude[5332] = 10.0
    thin, values = thinned_spectrum(frequency, amplitude, 2000.0, 300)
    assert thin[np.argmax(values)] == frequency[5332] and thin.size <= 300 and np.all(np.diff(thin) > 0)


def test_both_walls_of_a_slot_are_shown_where_the_tool_was_pushed_to(straight):
    """Positive is to the left of the feed, on the left wall (cut too deep) as on the right one (material left)."""
    cell, (ran, *_) = straight
    chart = machined_profile(assess_all(cell, [ran]))[0]
    assert [panel.title for panel in chart.panels] == ["left wall", "right wall"]
    for panel in chart.panels:
        (shown,) = panel.curves
        at = path_of(cell).target.sample(ran.result.time_ns)[:, 0] * 1e3
        pushed = np.interp(shown.x, at, (ran.result.actual - ran.result.target)[:, 1] * 1e6)
        np.testing.assert_allclose(shown.y[5:-5], pushed[5:-5], atol=1.0)  # a cusp, and the nearest passage of a tooth


# --- report.charts and report.linked: thinned to what can be seen, no maximum lost ---
@settings(max_examples=budget(30))
@given(st.integers(1, 6000), st.integers(2, 60), st.integers(0, 2**32 - 1))
def test_thinning_keeps_both_ends_and_every_extremum_of_a_bucket(size, buckets, seed):
    y = np.random.default_rng(seed).normal(size=size)
    rows = envelope_index(y, buckets)
    assert rows[0] == 0 and rows[-1] == size - 1 and np.all(np.diff(rows) > 0)
    assert rows.size <= max(2 * buckets + 2, 1)
    edges = np.linspace(0, size, buckets + 1).astype(int)
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        if a < b:
            inside = y[rows[(rows >= a) & (rows < b)]]
            assert inside.max() == y[a:b].max() and inside.min() == y[a:b].min()


@pytest.fixture(scope="module")
def case(milled):
    cell, passes = milled
    parts = assess_all(cell, passes)
    return cell, passes, parts, linked(path_of(cell), passes, parts)


def test_the_largest_deviation_of_each_pass_is_a_station_as_in_the_table(case):
    *_, parts, outcome = case
    for one, part in zip(outcome["passes"], parts, strict=True):
        counted = np.abs(one["side"][outcome["scored"] == 1]).max()
        assert counted == pytest.approx(part.whole.max_normal * 1e6, rel=1e-12)


def test_line_point_and_feature_of_a_station_are_those_of_its_time(case):
    cell, _, _, outcome = case
    toolpath, target = path_of(cell).timed.toolpath, path_of(cell).target
    source = Path(cell.path.file).read_text().splitlines()
    assert [line["text"] for line in outcome["source"]] == source
    for k in range(0, outcome["time"].size, 97):
        stamp = round(outcome["time"][k] * 1e9)
        block = int(path_of(cell).timed.block_at(np.array([stamp]))[0])
        assert source[outcome["line"][k] - 1].startswith("G") and outcome["line"][k] == toolpath.line[block]
        assert outcome["features"][outcome["feature"][k]] == toolpath.features[toolpath.feature[block]]
        knot = outcome["point"][k] - 1
        assert target.time_ns[knot] >= stamp and (knot == 0 or target.time_ns[knot - 1] < stamp)
        place = [outcome[axis][k] for axis in "xyz"]
        np.testing.assert_allclose(place, 1e3 * target.sample(stamp), atol=1e-9)


def test_a_pass_that_was_cut_off_is_unknown_beyond_its_end(case):
    cell, passes, *_ = case
    whole = passes[1].result
    half = len(whole.time_ns) // 2
    fields = {name: value[:half] for name, value in vars(whole).items() if isinstance(value, np.ndarray)}
    short = dataclasses.replace(passes[1], result=dataclasses.replace(whole, **fields))
    outcome = linked(path_of(cell), [passes[0], short], assess_all(cell, [passes[0], short]))
    late = outcome["time"] > short.result.time[-1]
    whole, cut_off = (one["side"] for one in outcome["passes"])
    assert late.any() and np.isnan(cut_off[late]).all() and np.isfinite(whole).all()


def test_the_surface_keeps_the_largest_errors_of_floors_and_walls(case):
    parts = case[2]
    surface = part_surface(parts)
    assert max(surface["z"].shape) <= 120 and surface["z"].shape == (surface["y"].size, surface["x"].size)
    for one, part in zip(surface["passes"], parts, strict=True):
        assert np.nanmax(np.abs(one["floor"])) == pytest.approx(part.whole.max_floor * 1e6)
        assert np.abs(one["wall"]).max() == pytest.approx(part.whole.max_wall * 1e6)
