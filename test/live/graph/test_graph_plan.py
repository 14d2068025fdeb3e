"""Which passes a run makes, with a graph whose passes are simulated at once."""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from kr270_milling.live.graph.driver import Driver
from kr270_milling.live.graph.watchdog import AlreadyRunning, Watchdog
from kr270_milling.live.ros import topics

pytest.importorskip("rclpy")

from kr270_milling.cell.jobs import compensated, compensator, record_of, simulate
from kr270_milling.live.graph import plan
from kr270_milling.live.graph.graph import RunValues


class PlainGraph:
    """What ``run_plan`` needs of a graph."""

    driver = SimpleNamespace(namespace="/")

    def __init__(self, cell):
        self.cell = cell
        self.compensator = compensator(cell, cell.target())
        self.ran: dict[str, object] = {}

    @property
    def repeats(self) -> bool:
        return self.compensator.repeats

    def choose(self, method: str) -> None:
        self.compensator.choose(method)

    def run_pass(self, name: str) -> RunValues:
        self.ran[name] = simulate(self.cell, self.compensator.reference, name)
        self.compensator.revise(record_of(self.cell, self.ran[name].result))
        state = self.compensator
        return RunValues(name, Path(name), "", 1.0, tuple(state.errors), state.finished)


@pytest.fixture
def run(monkeypatch, short_cell):
    """Runs a plan for a cell with other parameters of the compensation; returns the graph and the rows."""

    def run(methods, passes=None, **parameters):
        cell = short_cell.replace(compensation=short_cell.compensation.replace(**parameters))
        graph = PlainGraph(cell)

        def recorded(recording, name, namespace):
            return SimpleNamespace(scored=graph.ran[str(recording)], lost_to_end=0)

        monkeypatch.setattr(plan, "pass_from_recording", recorded)
        return graph, plan.run_plan(graph, methods, passes)

    return run


def test_each_method_that_does_not_repeat_makes_one_pass(run):
    _, rows = run(["linear", "spline"])
    assert [row.scored.name for row in rows] == ["original", "linear", "spline"]
    assert not any(row.learning for row in rows)


def test_the_number_of_passes_may_be_given(run):
    _, rows = run(["linear"], 3)
    assert [row.scored.name for row in rows] == ["original", "linear", "linear_2"]
    assert [row.scored.name for row in run(["learned"], 1)[1]] == ["original"]


@pytest.mark.parametrize("method, repeat", [("learned", False), ("spline", True)])
def test_a_method_that_repeats_continues_until_the_compensator_is_finished_as_off_line(run, method, repeat):
    """The compensator is asked; the method's name decides nothing."""
    graph, (original, best) = run([method], repeat=repeat, max_passes=4)
    assert graph.compensator.finished and 2 <= len(best.learning) <= 4
    assert list(graph.ran) == ["original", *(f"{method}_{n + 1}" for n in range(len(best.learning)))]
    off_line = compensated(graph.cell, original.scored, method)
    assert best.scored.name == method and best.scored.scores == off_line.scores


def test_the_original_pass_is_the_best_where_no_revision_helps(run):
    graph, (original, best) = run(["spline"], repeat=True, max_correction=1e-9)
    assert len(best.learning) >= 1 and best.scored.scores.max_deviation <= original.scored.scores.max_deviation


# --- What the runner takes from the reports of the nodes ---


def report(pid: str, message: str, level: bytes = b"\0") -> DiagnosticArray:
    status = DiagnosticStatus(name="/recorder", level=level, message=message, values=[KeyValue(key="pid", value=pid)])
    return DiagnosticArray(status=[status])


def test_reports_of_another_process_under_our_name_are_ignored(ros_environment, world):
    sent = world.partner().create_publisher(*topics.DIAGNOSTICS)
    with contextlib.closing(Driver("", lambda: None)) as driver:
        driver.pids["/recorder"] = "1"
        driver.until(sent.get_subscription_count, "matching", 60.0)
        sent.publish(report("1", "recording"))
        sent.publish(report("2", "the directory is there already", b"\2"))
        driver.until(lambda: driver.foreign, "the other report", 60.0)
        assert driver.status("recorder").message == "recording" and not driver.errors
        watchdog = Watchdog(set(), pytest.fail)
        with pytest.raises(AlreadyRunning, match="/recorder already runs"):
            watchdog.check(driver, {"recorder": Alive()})
        watchdog.coming_up = False
        watchdog.check(driver, {"recorder": Alive()})


class Alive:
    """A process that has not ended."""

    alive = True
