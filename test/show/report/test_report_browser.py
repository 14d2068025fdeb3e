"""The report in a real browser: no error, no request, nothing cut off, and one place marked in all pictures."""

import contextlib
import dataclasses

import numpy as np
import pytest
from browser import Visit

from kr270_milling.base.frames import Pose
from kr270_milling.decide.decision import Limit
from kr270_milling.decide.part.assessment import judge
from kr270_milling.show.report import judged, write_report
from kr270_milling.show.report.charts import stations
from kr270_milling.show.report.study_page import points, write_page

WORDS = dict(source="cell.yaml", command="kr270_milling demo", date="2026-01-02")
#: where each picture marks the place, in its own coordinates, and where the data say that station k is
MARKS = """() => {
  const L = KR.data.linked, k = KR.place, way = document.querySelector("input[name=axis]:checked").value === "way";
  const marks = {};
  for (const id of ["before", "after", "difference"]) {
    const gd = KR.by("map_" + id);
    if (gd) marks[id] = [gd.layout.shapes[1].xanchor - L.x[k], gd.layout.shapes[1].yanchor - L.y[k]];
  }
  const gd = KR.by("series");
  marks.series = [gd.layout.shapes[0].x0 - (way ? L.distance : L.time)[k],
    gd.layout.shapes[0].x1 - gd.layout.shapes[0].x0];
  const part = KR.by("part");
  if (part.drawn && KR.seen("part")) {
    const here = part.data[3];
    marks.part = [here.x[0] - L.x[k], here.y[0] - L.y[k], here.z[0] - L.z[k]];
  }
  const line = document.querySelector("#source li.here");
  if (line) marks.source = [Number(line.dataset.n) - L.line[k]];
  marks.slider = [Number(KR.by("slider").value) - k];
  return marks;
}"""


def shown(browser, directory, cell, passes, width: int, place: str = "", **words) -> Visit:
    """The report of some passes, everything on it drawn; few stations and small solids: here the processor draws."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stations, "__defaults__", (600,))
        url = write_report(directory, cell, passes, **WORDS, **words).as_uri() + place
    visit = Visit(browser, url, width, dark=width < 600, touch=width < 600)
    visit.page.add_style_tag(content=".plot.robot, .plot.part { height: 150px !important; }")
    visit.ask("KR.drawEverything()")
    return visit


@pytest.fixture(scope="module")
def visit(browser, milled, tmp_path_factory):
    """Three passes, and a decision with three unknowns."""
    cell, passes = milled
    decision, checked = judged(cell, passes[:2], [judge(cell, ran) for ran in passes[:2]])
    limits = tuple(Limit(name, share, "a test") for name, share in (("servo lag", 0.6), ("base", 0.3), ("tool", 0.001)))
    more = dict(title="A part", decision=dataclasses.replace(decision, limits=limits), checked=checked)
    with contextlib.closing(shown(browser, tmp_path_factory.mktemp("part"), cell, passes, 1400, **more)) as page:
        yield page


def agrees(visit) -> None:
    """Every picture marks the place, when no late event of the pointer has moved the place for two frames."""
    marks = visit.ask(
        f"""async () => {{
          const frame = () => new Promise((done) => requestAnimationFrame(done));
          for (let k; k !== KR.place;) {{ k = KR.place; await frame(); await frame(); }}
          return ({MARKS})();
        }}"""
    )
    for name, differences in marks.items():
        assert np.abs(differences).max() < 1e-4, name


def test_the_page_has_no_console_message_and_no_request_and_starts_at_the_worst_place(visit):
    assert visit.complaints == [] and visit.requests == [visit.page.url]
    here, most = visit.ask("""() => {
      const p = KR.data.linked.passes[KR.shownPass()], s = KR.data.linked.scored;
      return [Math.abs(p.side[KR.place]), Math.max(...[...p.side].map((v, i) => s[i] ? Math.abs(v) : 0))]; }""")
    assert here == most
    agrees(visit)


def test_hovering_a_map_and_a_curve_moves_the_mark_everywhere(visit):
    for picture, trace in (("map_before", 1), ("series", 0)):
        visit.ask("KR.go(0)")
        visit.page.locator(f"#{picture}").scroll_into_view_if_needed()
        place = visit.ask(
            """([id, n]) => { const gd = KR.by(id), t = gd.data[n], a = gd._fullLayout;
               const k = Math.floor(t.x.length * 0.4), box = gd.getBoundingClientRect();
               return [box.left + a.xaxis._offset + a.xaxis.d2p(t.x[k]),
                       box.top + a.yaxis._offset + a.yaxis.d2p(t.y[k] ?? 0), t.customdata[k]]; }""",
            [picture, trace],
        )
        visit.page.mouse.move(place[0] - 30, place[1])
        visit.page.mouse.move(place[0], place[1], steps=4)
        visit.page.wait_for_function(  # within 3 mm, the resolution of a pointer; places on the way there come before
            """(k) => { const L = KR.data.linked, n = KR.place;
                        return n > 0 && Math.hypot(L.x[k] - L.x[n], L.y[k] - L.y[n]) < 3; }""",
            arg=place[2],
        )
        agrees(visit)
    # what was off the screen catches up when it comes there
    visit.ask("() => { scrollTo(0, 0); KR.go(200); }")
    visit.page.locator("#part").scroll_into_view_if_needed()
    visit.page.wait_for_function(
        """() => { const d = KR.by("part").data, L = KR.data.linked;
                   return KR.place === 200 && d[3].x[0] === L.x[200]; }"""
    )
    agrees(visit)


def test_keys_slider_and_findings_step_through_the_path(visit):
    visit.ask("KR.go(40)")
    visit.page.locator("body").focus()
    for key in ("ArrowRight", "Shift+ArrowRight", "ArrowLeft"):
        visit.page.keyboard.press(key)
    assert visit.ask("KR.place") == 50
    agrees(visit)
    visit.page.locator("#slider").focus()
    visit.page.keyboard.press("End")
    assert visit.ask("KR.place") == visit.ask("KR.data.linked.time.length - 1")
    visit.page.locator("#worst").click()
    assert visit.ask("KR.place") == visit.ask("KR.worst(KR.shownPass())")
    visit.page.locator("#source li").nth(5).click()
    assert visit.ask("KR.data.linked.line[KR.place]") == 6
    agrees(visit)


def test_play_runs_at_real_speed_and_stops_at_the_end_of_the_path(visit):
    """With a clock of the test: 0.04 s of the clock are 0.4 s of the path at ten times the speed."""
    visit.ask("() => { KR.now = performance.now; performance.now = () => KR.clock; KR.clock = 0; KR.go(20); }")
    visit.page.locator("#speed").select_option("10")
    visit.page.locator("#play").click()
    visit.ask("() => { KR.clock += 40; }")
    visit.page.wait_for_function("KR.place > 21 && KR.place === KR.stationAt(KR.data.linked.time[20] + 0.4)")
    visit.ask("() => { performance.now = KR.now; KR.go(KR.data.linked.time.length - 5); }")
    visit.page.wait_for_function("KR.place === KR.data.linked.time.length - 1")
    visit.page.wait_for_function("KR.by('play').getAttribute('aria-pressed') === 'false'")
    agrees(visit)


def test_tolerance_is_marked_and_the_filter_leaves_what_is_beyond(visit):
    dashed = visit.ask("() => KR.by('series').layout.shapes.filter((s) => s.line.dash === 'dash').map((s) => s.y0)")
    assert sorted(set(np.round(dashed, 3))) == [-30.0, 30.0]
    values = "() => ['before', 'after'].map((id) => KR.by('map_' + id).data[1].marker.color)"
    every = visit.ask(values)
    visit.page.locator("#beyond").check()
    beyond = visit.ask(values)
    assert beyond == [[value for value in column if abs(value) > 30.0] for column in every]
    assert 0 < len(beyond[0]) < len(every[0])
    visit.page.locator("#beyond").uncheck()
    assert visit.ask(values) == every


def test_a_zoom_of_the_curves_moves_the_maps_and_chooses_the_rows_of_the_csv_file(visit):
    visit.ask("() => Plotly.relayout('series', {'xaxis.range': [100, 140].map((k) => KR.data.linked.distance[k])})")
    visit.page.wait_for_function("KR.zoom?.first === 100 && KR.zoom.last === 140")
    ranges = """(id) => { const a = KR.by(id)._fullLayout; return [...a.xaxis.range, ...a.yaxis.range]; }"""
    visit.page.wait_for_function(
        """() => { const [a, b] = KR.by('map_after')._fullLayout.xaxis.range;
                   return b - a < 0.9 * (KR.mapFrame[1] - KR.mapFrame[0]); }"""
    )
    left, right, low, high = visit.ask(ranges, "map_before")
    assert [left, right, low, high] == pytest.approx(visit.ask(ranges, "map_after"))
    x, y = (np.array(visit.ask(f"[...KR.data.linked.{axis}.slice(100, 141)]")) for axis in "xy")
    assert left < x.min() and x.max() < right and low < y.min() and y.max() < high
    with visit.page.expect_download() as saved:  # of the stations on the screen and the passes of the legend
        visit.ask("() => Plotly.restyle('series', { visible: 'legendonly' }, [1])")
        visit.page.locator("#csv").click()
    visit.ask("() => Plotly.restyle('series', { visible: true }, [1])")
    first, *rows = [line.split(",") for line in saved.value.path().read_text().splitlines()]
    row = dict(zip(first, rows[0], strict=True))
    assert len(rows) == 41 and {"time_s", "way_mm", "x_mm"} < set(row)
    assert not any(name.startswith("linear_") for name in row)
    side = visit.ask("KR.data.linked.passes[0].side[100]")
    assert float(row["original_deviation_left_um"]) == pytest.approx(side, rel=1e-5)
    visit.page.locator("#series .nsewdrag").first.dblclick(delay=600)  # [ms], of each press: Plotly counts up to 500
    visit.page.wait_for_function("KR.zoom === null")


def test_the_switches_change_scale_axis_and_pass(visit):
    visit.page.get_by_label("one for all").check()
    ends = visit.ask("['before', 'after', 'difference'].map((id) => KR.by('map_' + id).data[1].marker.cmax)")
    assert len(set(ends)) == 1
    visit.page.get_by_label("time", exact=True).check()
    agrees(visit)
    visit.page.locator("#pass").select_option(label="linear")
    visit.page.wait_for_function("KR.by('map_after_title').textContent.startsWith('linear')")
    visit.page.get_by_label("way", exact=True).check()
    assert visit.complaints == []


def test_the_robot_holds_the_tool_where_it_is_commanded(visit, milled):
    cell, passes = milled
    model = visit.ask("() => KR.data.robot.pass_name")
    reference = next(p for p in passes if p.name == model).reference
    for station in (0, 350):
        stamp = round(visit.ask("(k) => KR.data.linked.time[k]", station) * 1e9)
        tool = np.array(visit.ask("(k) => KR.toolAt(k)", station))
        expected = (cell.workpiece.pose @ Pose(reference.sample(stamp), np.eye(3))).position
        assert np.linalg.norm(tool - expected) < 2e-3  # [m]: postures in between are interpolated


def test_nothing_is_wider_than_the_screen_in_light_and_dark_and_the_bars_of_the_unknowns_have_their_shares(visit):
    for width, theme in ((1400, "light"), (390, "light"), (820, "dark")):
        visit.page.emulate_media(color_scheme=theme)
        visit.page.set_viewport_size({"width": width, "height": 900})
        visit.page.wait_for_function(f"KR.by('series')._fullLayout.width <= {width}")
        assert visit.settled_overhang() <= 0.5
        bars = visit.ask("""() => [...document.querySelectorAll("#limits tr")].map((row) => {
          const [bar, track] = ["rect", "svg"].map((e) => row.querySelector(e).getBoundingClientRect());
          return [row.querySelector("th").textContent, bar.width / track.width, track.width, track.height]; })""")
        assert [(name, round(share, 2)) for name, share, *_ in bars] == [("servo lag", 0.6), ("base", 0.3)]
        assert min(size for row in bars for size in row[2:]) > 8
        assert visit.page.locator("#limits .measure").first.is_visible() == (width > 600)
    dark = visit.ask("[getComputedStyle(document.body).backgroundColor, KR.by('series')._fullLayout.font.color]")
    assert sum(map(int, dark[0][4:-1].split(","))) < 200 and dark[1] == "#e8ecf0"
    assert visit.complaints == []


def test_a_phone_opened_at_the_address_of_a_place_turned_and_a_page_printed(browser, straight, tmp_path):
    cell, passes = straight
    words = dict(place="#XP3", title="The paper", paper=True)
    with contextlib.closing(shown(browser, tmp_path, cell, passes[:2], 390, **words)) as phone:
        assert phone.ask("() => [KR.data.linked.point[KR.place], KR.data.linked.point[KR.place - 1]]") == [3, 2]
        phone.ask("KR.go(40)")
        phone.page.wait_for_function("location.hash === `#XP${KR.data.linked.point[40]}`")
        phone.ask("() => { location.hash = '#XP99999999'; }")
        phone.page.wait_for_function("KR.place === KR.data.linked.time.length - 1")
        phone.page.set_viewport_size({"width": 844, "height": 390})
        assert phone.settled_overhang() <= 0.5 and phone.complaints == []
        phone.page.emulate_media(media="print", color_scheme="dark")
        phone.ask("dispatchEvent(new Event('beforeprint'))")
        assert phone.ask("() => KR.by('series').layout.font.color") == "#000"
        assert phone.ask("() => [...document.querySelectorAll('.chart')].every((e) => e.drawn)")
        assert phone.settled_overhang() <= 0.5


def test_the_page_of_a_study_loads_plotly_from_its_folder_or_names_the_missing_file(browser, tmp_path):
    figures = [points("Lines", "x [um]", "y [N]", {"one": ([0, 1], [1, 2]), "other": ([0, 1], [2, np.nan])}, ("one",))]
    path = write_page(tmp_path / "study.html", "A study", ["removed 3 mm3"], [], figures)
    with contextlib.closing(Visit(browser, path.as_uri(), 390, dark=True)) as visit:
        assert visit.ask("KR.by('figure_0').data[1].marker.color") == "#ff8f4f"
        assert [url.rsplit("/", 1)[1] for url in visit.requests] == ["study.html", "plotly.min.js"]
        assert not visit.page.locator("#missing").is_visible()
        assert visit.settled_overhang() <= 0.5 and visit.complaints == []
    path.with_name("plotly.min.js").unlink()
    with contextlib.closing(Visit(browser, path.as_uri())) as visit:
        assert "plotly.min.js next to this page" in visit.page.locator("#missing").inner_text()
