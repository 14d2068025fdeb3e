"""The end of a node process: exit codes and signals."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from ros_domain import running

pytest.importorskip("rclpy")

from kr270_milling.base.process import exit_code

NODE = """
import ctypes, sys
from kr270_milling.live.ros.node import ReportingNode
from kr270_milling.live.ros.spin import run_node
class Blocked(ReportingNode):
    def __init__(self, **kwargs):
        super().__init__("blocked", **kwargs)
        print("up", flush=True)
    def destroy_node(self):
        print("leaving", flush=True)
        ctypes.PyDLL(None).sleep(100)
run_node(Blocked)
"""


def test_second_signal_ends_a_node_whose_middleware_blocks_while_it_leaves(ros_environment):
    with running([sys.executable, "-c", NODE], ros_environment, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"up\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == b"leaving\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == -signal.SIGINT


def test_error_has_the_exit_code_of_the_command_line():
    assert exit_code(None) == 0 and exit_code(KeyboardInterrupt()) == 130 and exit_code(ValueError()) == 2
    assert exit_code(SystemExit(143)) == 143 and exit_code(SystemExit()) == 0 and exit_code(SystemExit("no")) == 1


FAILS = """
from kr270_milling.live.ros.node import ReportingNode, guarded
from kr270_milling.live.ros.spin import run_node
class Failing(ReportingNode):
    calls = 0
    def __init__(self, **kwargs):
        super().__init__("failing", **kwargs)
        self.create_timer(0.0005, self.stumble)
    @guarded
    def stumble(self):
        self.calls += 1
        print(self.calls, flush=True)
        if self.calls == 100:
            raise ZeroDivisionError("a mistake")
run_node(Failing)
"""


def test_node_that_fails_ends_before_its_next_callback(ros_environment):
    ran = subprocess.run([sys.executable, "-c", FAILS], env=ros_environment, capture_output=True, text=True, timeout=30)
    assert ran.returncode == 1 and ran.stdout.split()[-1] == "100"
    assert ran.stderr.splitlines()[-1] == "failing: ZeroDivisionError in stumble: a mistake"
