"""What the runner takes from the reports of the nodes."""

from __future__ import annotations

import contextlib

import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from kr270_milling.live.graph.driver import Driver
from kr270_milling.live.graph.watchdog import AlreadyRunning, Watchdog
from kr270_milling.live.ros import topics


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
