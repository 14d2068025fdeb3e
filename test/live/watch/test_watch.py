"""The live view: events from messages, and the page in a browser while events arrive (the command: test_graph)."""

from __future__ import annotations

import contextlib
import http.client
import json

import numpy as np
import pass_recording as made
import pytest
from browser import Visit

from kr270_milling.base.errors import InputError
from kr270_milling.live.watch.feed import PERIOD_NS, LiveEvents
from kr270_milling.live.watch.server import Events, serve
from kr270_milling.recordings.messages.codec import from_bytes, serialise
from kr270_milling.show.report.watch_page import watch_page

pytestmark = made.needs_messages
RECEIVED = ("reference_trajectory", "target_trajectory", "tool_pose", "wrench")


def received(**options) -> list:
    return [m for m in made.one_pass(**options) if m.topic in RECEIVED]


def events_of(messages) -> list[dict]:
    feed = LiveEvents()
    return [event for m in messages for event in feed.events(m.topic, m.data)]


def test_samples_are_thinned_and_equal_the_messages_and_states_are_events_when_they_change():
    messages = received()
    events = events_of(messages)
    assert [e["kind"] for e in events].count("pass") == 1 and events[0]["kind"] == "pass"
    samples = [e for e in events if e["kind"] == "sample"]
    stamps = np.array([e["t"] for e in samples])
    assert np.all(np.diff(stamps) > 0.99e-9 * PERIOD_NS)
    poses = {m.stamp: from_bytes("geometry_msgs/msg/PoseStamped", m.data) for m in messages if m.topic == "tool_pose"}
    cell = made.cell_of()
    for sample in samples:
        stamp = round(sample["t"] * 1e9)
        target = cell.target().sample(stamp)
        shift = np.asarray(poses[stamp].position) - target
        expected = 1e3 * target[0], 1e6 * shift[1], 1e6 * shift[2]  # the path runs along +x: left is +y
        assert (sample["x"], sample["side"], sample["up"]) == pytest.approx(expected, abs=1e-3)
    feed = LiveEvents()
    status = {"level": 1, "name": "/robot", "message": "slow"}
    data = serialise("diagnostic_msgs/msg/DiagnosticArray", {"status": [status]})
    assert [len(list(feed.events("diagnostics", data))) for _ in range(2)] == [1, 0]


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


def test_only_two_places_can_be_read_under_the_name_of_this_host_and_a_late_page_receives_all_events(served):
    events, port = served
    here = f"127.0.0.1:{port}"
    requests = [("/", here), ("/", f"localhost:{port}"), ("/", "elsewhere.example"), ("/../etc", here)]
    assert [answer(port, *request)[0] for request in requests] == [200, 200, 403, 404]
    assert answer(port, "/", here, "POST")[0] == 501
    sent = [{"kind": "pass", "number": 1, "duration_s": None}, {"kind": "end"}]
    for event in sent:
        events.add(event)
    _, body = answer(port, "/events", here)
    assert [json.loads(line[6:]) for line in body.splitlines() if line.startswith("data: ")] == sent
    with pytest.raises(InputError, match="cannot be served"):
        serve(Events(), "a page", "127.0.0.1", port)


def test_the_page_grows_while_events_come_and_reports_the_end_of_the_graph(served, browser):
    events, port = served
    events_sent = events_of(received(passes=2))
    assert [e["number"] for e in events_sent if e["kind"] == "pass"] == [1, 2]
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
        assert "closed" in visit.page.locator("#now").inner_text()
        assert visit.settled_overhang() <= 0.5 and visit.complaints == []
        assert {url.rsplit("/", 1)[1] for url in visit.requests if not url.startswith("data:")} == {"", "events"}
        visit.close()
