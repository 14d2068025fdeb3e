"""The report in a real browser: no error, no request, nothing cut off, and one place marked in all pictures."""

from __future__ import annotations

import numpy as np
import pytest
from browser import Visit, browser
from milled_part import POCKET, small_cell

from kr270_milling.base.frames import Pose
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import commanded_joints, compensated, simulate
from kr270_milling.report import write_report
from kr270_milling.robot import pose

WORDS = dict(source="cell.yaml", command="kr270_milling demo", date="2026-01-02")
#: where each picture marks the place, in its own coordinates, and where the data say that station k is
MARKS = """() => {
  const L = KR.data.linked, k = KR.place, way = document.querySelector("input[name=axis]:checked").value === "way";
  const found = {};
  for (const id of ["before", "after", "difference"]) {
    const gd = document.getElementById("map_" + id);
    if (gd) found[id] = [gd.layout.shapes[1].xanchor - L.x[k], gd.layout.shapes[1].yanchor - L.y[k]];
  }
  const gd = document.getElementById("series");
  found.series = [gd.layout.shapes[0].x0 - (way ? L.way : L.time)[k], gd.layout.shapes[0].x1 - gd.layout.shapes[0].x0];
  const part = document.getElementById("part");
  if (part.drawn && KR.seen("part")) {
    const here = part.data[part.data.length - 1];
    found.part = [here.x[0] - L.x[k], here.y[0] - L.y[k], here.z[0] - L.z[k]];
  }
  const line = document.querySelector("#source li.here");
  if (line) found.source = [Number(line.dataset.n) - L.line[k]];
  found.slider = [Number(document.getElementById("slider").value) - k];
  return found;
}"""


@pytest.fixture(scope="module")
def running():
    with browser() as found:
        yield found


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    directory = tmp_path_factory.mktemp("part")
    cell = small_cell(directory, POCKET, "part.tolerance_um=30")
    original = simulate(cell)
    passes = [original, *(compensated(cell, original, method) for method in ("linear", "spline"))]
    return cell, passes, write_report(directory, cell, passes, title="A part", **WORDS).as_uri()


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    cell = read_cell(find_file("paper.yaml"), ["path.length_mm=20.0", "stock.grid_step_um=40.0"])
    original = simulate(cell)
    passes = [original, compensated(cell, original, "linear")]
    path = write_report(tmp_path_factory.mktemp("demo"), cell, passes, title="The paper", paper=True, **WORDS)
    return cell, passes, path.as_uri()


@pytest.fixture(scope="module")
def visit(running, part):
    found = Visit(running, part[2])
    found.ask("KR.drawEverything()")
    yield found
    found.close()


@pytest.fixture(scope="module")
def paper(running, demo):
    found = Visit(running, demo[2])
    found.ask("KR.drawEverything()")
    yield found
    found.close()


def settled(visit) -> dict:
    visit.ask("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return visit.ask(MARKS)


def agrees(visit) -> None:
    for name, differences in settled(visit).items():
        assert np.abs(differences).max() < 1e-4, name


def test_the_page_says_nothing_asks_for_nothing_and_starts_at_the_worst_place(visit, part):
    assert visit.complaints == [] and visit.requests == [part[2]]
    shown = visit.ask("() => KR.data.linked.passes[KR.shownPass()].side[KR.place]")
    sides = visit.ask("""() => { const p = KR.data.linked.passes[KR.shownPass()], s = KR.data.linked.scored;
                              return Math.max(...[...p.side].map((v, i) => s[i] ? Math.abs(v) : 0)); }""")
    assert abs(shown) == sides
    agrees(visit)


def test_hovering_a_map_and_a_curve_moves_the_mark_everywhere(visit):
    for picture, trace in (("map_before", 1), ("series", 0)):
        visit.ask("KR.go(0)")
        visit.page.locator(f"#{picture}").scroll_into_view_if_needed()
        place = visit.ask(
            """([id, n]) => { const gd = document.getElementById(id), t = gd.data[n], a = gd._fullLayout;
               const k = Math.floor(t.x.length * 0.4), box = gd.getBoundingClientRect();
               return [box.left + a.xaxis._offset + a.xaxis.d2p(t.x[k]),
                       box.top + a.yaxis._offset + a.yaxis.d2p(t.y[k] ?? 0), t.customdata[k]]; }""",
            [picture, trace],
        )
        visit.page.mouse.move(place[0] - 30, place[1])
        visit.page.mouse.move(place[0], place[1], steps=4)
        visit.page.wait_for_function("KR.place > 0")
        agrees(visit)
        near = visit.ask(
            """(k) => { const L = KR.data.linked;
                        return Math.hypot(L.x[k] - L.x[KR.place], L.y[k] - L.y[KR.place]); }""",
            place[2],
        )
        assert near < 3.0  # [mm]: what a pointer can tell


def test_what_was_off_the_screen_catches_up_when_it_comes_there(visit):
    visit.ask("() => { scrollTo(0, 0); KR.go(200); }")
    visit.page.locator("#part").scroll_into_view_if_needed()
    visit.page.wait_for_function(
        """() => { const d = document.getElementById("part").data, L = KR.data.linked;
                   return KR.place === 200 && d[d.length - 1].x[0] === L.x[200]; }"""
    )
    agrees(visit)


def test_keys_slider_and_findings_step_through_the_path(visit):
    visit.ask("KR.go(40)")
    visit.page.locator("body").focus()
    visit.page.keyboard.press("ArrowRight")
    visit.page.keyboard.press("Shift+ArrowRight")
    assert visit.ask("KR.place") == 51
    visit.page.keyboard.press("ArrowLeft")
    agrees(visit)
    visit.page.locator("#slider").focus()
    visit.page.keyboard.press("End")
    assert visit.ask("KR.place") == visit.ask("KR.data.linked.time.length - 1")
    visit.page.locator("#worst").click()
    assert visit.ask("KR.place") == visit.ask("KR.worst(KR.shownPass())")
    visit.page.locator("#source li").nth(5).click()
    assert visit.ask("KR.data.linked.line[KR.place]") == 6
    agrees(visit)


def test_playing_runs_along_the_path_and_stops_at_its_end(visit):
    visit.ask("KR.go(KR.data.linked.time.length - 5)")
    visit.page.locator("#play").click()
    visit.page.wait_for_function("KR.place === KR.data.linked.time.length - 1")
    visit.page.wait_for_function("document.getElementById('play').getAttribute('aria-pressed') === 'false'")
    agrees(visit)


def test_the_switches_change_scale_axis_and_pass(visit):
    ends = (
        "() => ['before', 'after', 'difference'].map((id) => document.getElementById('map_' + id).data[1].marker.cmax)"
    )
    own = visit.ask(ends)
    assert len(set(own)) == 3
    visit.page.get_by_label("one for all").check()
    assert len(set(visit.ask(ends))) == 1 and visit.ask(ends)[0] == max(own)
    visit.page.get_by_label("time", exact=True).check()
    assert "time" in visit.ask("() => document.getElementById('series').layout.xaxis.title.text")
    agrees(visit)
    visit.page.locator("#pass").select_option(label="linear")
    visit.page.wait_for_function("document.getElementById('map_after_title').textContent.startsWith('linear')")
    visit.page.get_by_label("each its own").check()
    visit.page.get_by_label("way", exact=True).check()
    assert visit.complaints == []


def test_the_robot_holds_the_tool_where_it_is_commanded(visit, part):
    cell, passes, _ = part
    model = visit.ask("() => KR.data.robot.pass_name")
    reference = next(p for p in passes if p.name == model).reference
    for station in (0, 700):
        station = min(station, visit.ask("KR.data.linked.time.length") - 1)
        stamp = round(visit.ask("(k) => KR.data.linked.time[k]", station) * 1e9)
        tool = np.array(visit.ask("(k) => KR.toolAt(k)", station))
        expected = (cell.workpiece.pose @ Pose(reference.sample(stamp), np.eye(3))).position
        assert np.linalg.norm(tool - expected) < 2e-3  # [m]: postures in between are interpolated
    first = pose(cell.arm, cell.mount, commanded_joints(cell, reference)[0]).position
    np.testing.assert_allclose(visit.ask("() => KR.toolAt(0)"), first, atol=1e-5)


def test_tolerance_and_largest_values_are_marked(visit, part):
    shapes = visit.ask(
        "() => document.getElementById('series').layout.shapes.filter((s) => s.line.dash === 'dash').map((s) => s.y0)"
    )
    assert sorted(set(np.round(shapes, 3))) == [-30.0, 30.0]
    marked = visit.ask(
        "() => document.getElementById('series').data.filter((t) => t.mode === 'markers+text').map((t) => t.y[0])"
    )
    assert len(marked) == 3


@pytest.mark.parametrize("which", ["visit", "paper"])
def test_nothing_is_wider_than_the_screen_in_light_and_dark(request, which):
    visit = request.getfixturevalue(which)
    for width, dark in ((1400, True), (390, True), (390, False)):
        visit.page.emulate_media(color_scheme="dark" if dark else "light")
        visit.page.set_viewport_size({"width": width, "height": 900})
        visit.page.wait_for_function(
            """([wide, ink]) => { const s = document.getElementById('series')._fullLayout;
                                  return s.width <= wide && s.width > 0.6 * wide && s.font.color === ink; }""",
            arg=[width, "#e8ecf0" if dark else "#1d2329"],
        )
        assert visit.settled_overhang() <= 0.5
        back = visit.ask("() => getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, back[4:-1].split(","))) < 200) == dark
    assert visit.complaints == [] and len(visit.requests) == 1
    assert visit.ask(
        """() => [...document.querySelectorAll('[role=img]')]
                 .every((e) => (e.getAttribute('aria-label') || '').length > 20)"""
    )


def test_a_phone_opened_turned_and_a_page_printed(running, demo):
    visit = Visit(running, demo[2], 390, touch=True)
    visit.page.set_viewport_size({"width": 844, "height": 390})
    visit.page.emulate_media(color_scheme="dark")
    visit.page.wait_for_function("document.getElementById('series').layout.font.color === '#e8ecf0'")
    visit.page.wait_for_function("document.getElementById('series')._fullLayout.width > 700")
    assert visit.settled_overhang() <= 0.5 and visit.complaints == []
    visit.page.emulate_media(media="print", color_scheme="dark")
    visit.ask("dispatchEvent(new Event('beforeprint'))")
    assert visit.ask("() => document.getElementById('series').layout.font.color") == "#000"
    assert visit.ask("() => [...document.querySelectorAll('.chart')].every((e) => e.drawn)")
    visit.close()
