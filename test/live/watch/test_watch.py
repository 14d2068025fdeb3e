"""The live view: events from messages, the page in a browser while events arrive, and the command beside a graph."""

from __future__ import annotations

import contextlib
import http.client
import json
import subprocess
import sys

import numpy as np
import pass_recording as made
import pytest
from browser import Visit

from kr270_milling.base.errors import InputError
from kr270_milling.cli import main
from kr270_milling.live.watch.feed import PERIOD_NS, LiveEvents
from kr270_milling.live.watch.server import Events, serve
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.codec import from_bytes, serialise
from kr270_milling.show.report.watch_page import watch_page

pytestmark = made.needs_messages


def events_of(messages) -> list[dict]:
    feed = LiveEvents()
    return [event for m in messages for event in feed.events(m.topic, m.data) if m.topic in RECEIVED]


RECEIVED = ("reference_trajectory", "target_trajectory", "tool_pose", "wrench")


def received(messages):
    return [m for m in messages if m.topic in RECEIVED]


def test_samples_are_thinned_and_equal_the_messages():
    messages = received(made.one_pass())
    events = events_of(messages)
    assert [e["kind"] for e in events].count("pass") == 1 and events[0]["kind"] == "pass"
    samples = [e for e in events if e["kind"] == "sample"]
    stamps = np.array([e["t"] for e in samples])
    assert np.all(np.diff(stamps) > 0.99e-9 * PERIOD_NS)
    poses = {m.stamp: from_bytes("geometry_msgs/msg/PoseStamped", m.data) for m in messages if m.topic == "tool_pose"}
    cell = made.cell_of("linear", 1)
    for sample in samples:
        stamp = round(sample["t"] * 1e9)
        target = cell.target().sample(stamp)
        shift = np.asarray(poses[stamp].position) - target
        assert sample["side"] == pytest.approx(1e6 * shift[1], abs=1e-3)  # the path runs along +x: left is +y
        assert sample["up"] == pytest.approx(1e6 * shift[2], abs=1e-3)
        assert sample["x"] == pytest.approx(1e3 * target[0], abs=1e-3)


def test_a_second_pass_is_an_event_and_states_only_when_they_change():
    messages = received(made.one_pass(passes=2))
    assert [e["number"] for e in events_of(messages) if e["kind"] == "pass"] == [1, 2]
    feed = LiveEvents()
    status = {"level": 1, "name": "/robot", "message": "slow"}
    data = serialise("diagnostic_msgs/msg/DiagnosticArray", {"status": [status]})
    assert len(list(feed.events("diagnostics", data))) == 1
    assert list(feed.events("diagnostics", data)) == []


@pytest.fixture
def served():
    events = Events()
    server = serve(events, watch_page(), "127.0.0.1", 0)
    yield events, server.server_port
    server.shutdown()
    server.server_close()


def answer(port: int, path: str, host: str, method: str = "GET") -> tuple[int, str]:
    """Status and text."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    with contextlib.closing(connection):
        connection.request(method, path, headers={"Host": host, "Connection": "close"})
        with connection.getresponse() as response:
            return response.status, response.read().decode()


def test_only_two_places_can_be_read_and_only_under_the_name_of_this_host(served):
    _, port = served
    assert answer(port, "/", f"127.0.0.1:{port}")[0] == 200
    assert answer(port, "/", f"localhost:{port}")[0] == 200
    assert answer(port, "/", "elsewhere.example")[0] == 403
    assert answer(port, "/../etc", f"127.0.0.1:{port}")[0] == 404
    assert answer(port, "/", f"127.0.0.1:{port}", "POST")[0] == 501


def test_a_port_that_is_in_use_is_refused(served):
    with pytest.raises(InputError, match="cannot be served"):
        serve(Events(), "a page", "127.0.0.1", served[1])


def test_a_late_page_receives_all_events_and_the_stream_ends_with_the_graph(served):
    events, port = served
    sent = [{"kind": "pass", "number": 1, "duration_s": None}, {"kind": "end"}]
    for event in sent:
        events.add(event)
    _, body = answer(port, "/events", f"127.0.0.1:{port}")
    rows = [json.loads(line[6:]) for line in body.splitlines() if line.startswith("data: ")]
    assert rows == sent


def test_the_page_grows_while_events_come_and_reports_the_end_of_the_graph(served, browser):
    events, port = served
    events_sent = events_of(received(made.one_pass(passes=2)))
    wide = Visit(browser, f"http://127.0.0.1:{port}/")
    phone = Visit(browser, f"http://127.0.0.1:{port}/", 390, dark=True, touch=True)
    for visit in (wide, phone):
        visit.page.wait_for_function("document.getElementById('now').textContent.includes('waits for the first pass')")
        assert not visit.page.locator("#live_series").is_visible() and visit.settled_overhang() <= 0.5
    half = len(events_sent) // 2
    samples = [sum(e["kind"] == "sample" for e in part) for part in (events_sent[:half], events_sent)]
    for part, count in zip((events_sent[:half], events_sent[half:]), samples, strict=True):
        for event in part:
            events.add(event)
        for visit in (wide, phone):
            visit.page.wait_for_function("(n) => KR.watch.samples === n", arg=count)
    events.add({"kind": "end"})
    for visit in (wide, phone):
        visit.page.wait_for_function("KR.watch.ended")
        drawn = visit.ask("() => document.getElementById('live_series').data.map((t) => t.y.length)")
        assert len(drawn) == 6 and sum(drawn) == 3 * samples[1]  # two passes, three rows
        assert visit.ask("() => document.getElementById('live_map').data[0].x.length") == drawn[3]
        margins = visit.ask(
            """() => { const gd = document.getElementById('live_map'), x = gd.data[0].x, a = gd._fullLayout.xaxis;
                       return [Math.min(...x) - a.range[0], a.range[1] - Math.max(...x), a._length]; }"""
        )
        assert min(margins[:2]) > 0 and margins[2] > 100, "the path is on the map"
        assert "closed" in visit.page.locator("#now").inner_text()
        assert visit.settled_overhang() <= 0.5 and visit.complaints == []
        assert {url.rsplit("/", 1)[1] for url in visit.requests if not url.startswith("data:")} == {"", "events"}
        visit.close()


# --- the command with a running graph: nothing is published, both end together ---


@pytest.fixture
def watching(ros_environment):
    """The command as a process, and its address."""
    pytest.importorskip("rclpy", reason="needs ROS 2")
    words = [sys.executable, "-m", "kr270_milling.cli", "watch", "--port", "0", "--json"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process, json.loads(process.stdout.readline())["url"]
    finally:
        process.kill()
        process.communicate()


def test_the_page_shows_the_pass_that_runs_and_closes_with_the_graph(watching, browser, tmp_path, capsys):
    process, url = watching
    visit = Visit(browser, url)
    sets = ["--set", "path.length_mm=15.0", "--set", "stock.grid_step_um=40.0"]
    assert main(["run", "paper.yaml", "--passes", "1", "--out", str(tmp_path), *sets]) == 0, capsys.readouterr().err
    visit.page.wait_for_function("KR.watch.ended")
    samples = visit.ask("() => KR.watch.samples")
    last = visit.ask("() => KR.watch.passes[0].t.at(-1)")
    nodes = visit.ask("() => [...document.querySelectorAll('#nodes b')].map((b) => b.textContent)")
    assert visit.complaints == []
    visit.close()
    duration = 15e-3 / (4.0 / 60.0)
    assert samples >= 2 and 0.0 < last <= duration + 1e-9  # by best effort: the number of lost samples may vary
    assert {"/compliant_robot", "/cutting_process", "/trajectory_compensator"} <= set(nodes)
    assert process.wait(timeout=60) == 0
    with Recording(tmp_path / "original") as recording:
        topics = recording.topics()
        assert {"/tf", "/tf_static", "/markers", "/robot_description"} <= set(topics)
        assert topics["/tf"].count >= 5 and topics["/tf_static"].count >= 1
        assert topics["/markers"].type == "visualization_msgs/msg/MarkerArray"
