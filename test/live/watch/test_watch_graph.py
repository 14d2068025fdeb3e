"""``kr270_milling watch`` with a running graph: the page grows, nothing is published, both end together."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from browser import Visit

pytest.importorskip("rclpy", reason="needs ROS 2")

from kr270_milling.cli import main
from kr270_milling.recordings.bag.reader import Recording


@pytest.fixture
def watching(ros_environment):
    """The command as a process, and its address."""
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
