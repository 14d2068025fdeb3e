from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from ros_domain import running
from sample_messages import wrench_msg

from kr270_milling.base.errors import ConfigError
from kr270_milling.base.process import exit_code
from kr270_milling.base.record import Record, parameter
from kr270_milling.live.ros.parameters import declare

pytest.importorskip("rclpy")

from kr270_milling.base.errors import InputError
from kr270_milling.live.nodes.cutting_process import CuttingProcess
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.node import ManagedNode, ReportingNode, guarded

ERROR = 2


class Clumsy(ReportingNode):
    def __init__(self, **kwargs):
        super().__init__("clumsy", **kwargs)

    @guarded
    def refuse(self) -> None:
        raise InputError("message", "of no use")

    @guarded
    def stumble(self) -> None:
        raise ZeroDivisionError("a mistake")


class Failing(ManagedNode):
    def __init__(self, **kwargs):
        super().__init__("failing", **kwargs)

    def configure(self) -> None:
        raise InputError("stock", "is missed by the path")


def test_unusable_input_is_reported_and_the_node_continues(world):
    node, reports = world.add(Clumsy), world.diagnostics(world.partner())
    world.until(lambda: "/clumsy" in reports.last)
    node.refuse()
    reports.until("/clumsy", "of no use", ERROR)
    assert node.failure is None and node.refused == 1


def test_mistake_in_a_callback_is_reported_and_ends_the_node(world):
    node = world.add(Clumsy)
    node.stumble()
    assert node.failure == "ZeroDivisionError in stumble: a mistake"


def test_failed_transition_is_reported_with_its_reason_and_can_be_repeated(world):
    node, reports = world.add(Failing), world.diagnostics(world.partner())
    world.until(lambda: "/failing" in reports.last)
    for _ in range(2):
        node.trigger_configure()
        reports.until("/failing", "is missed by the path", ERROR)
    assert not node.active


def test_names_can_be_remapped(world, short_cell, tmp_path):
    remap = ["-r", "tool_pose:=/elsewhere/pose", "-r", "__node:=knife"]
    world.add(CuttingProcess, *remap, cell=short_cell, directory=tmp_path)
    partner = world.partner()
    world.until(lambda: partner.count_subscribers("/elsewhere/pose") == 1)
    assert partner.count_subscribers("/tool_pose") == 0
    world.until(lambda: "knife" in partner.get_node_names())


def test_two_test_runs_have_different_domains_and_exchange_no_messages(world, domain, ros_environment):
    publisher = world.partner().create_publisher(*topics.WRENCH)
    code = (
        "import sys; sys.path.insert(0, 'test'); import conftest, ros_domain\n"
        "turn = ros_domain.own_domain(); number = turn.__enter__()\n"
        "from kr270_milling.live.ros import topics\n"
        "world = conftest.World(number); node = world.partner()\n"
        "messages = world.listen(node, topics.WRENCH); world.step(1.5)\n"
        "print(number, len(messages), node.count_publishers('wrench'))\n"
        "world.close()\n"
    )
    command = [sys.executable, "-c", code]
    with running(command, ros_environment, stdout=subprocess.PIPE, text=True) as other:
        while other.poll() is None:
            publisher.publish(wrench_msg(0, [0.0] * 6))
            world.step(0.02)
        number, messages, publishers = map(int, other.stdout.read().split())
    assert number != domain and messages == publishers == 0


def test_autostart_is_described_and_cannot_be_set_later_and_a_status_names_its_hardware(world, short_cell, tmp_path):
    from rclpy.parameter import Parameter

    node = world.add(CuttingProcess, cell=short_cell, directory=tmp_path)
    assert node.describe_parameter("autostart").description and node.describe_parameter("autostart").read_only
    assert not node.set_parameters([Parameter("autostart", value=True)])[0].successful
    messages = world.listen(world.partner(), topics.DIAGNOSTICS)
    world.until(lambda: messages)
    assert messages[0].status[0].hardware_id


# --- Parameter records as ROS parameters ---


@dataclass(frozen=True, eq=False)
class Sample(Record):
    speed: float = parameter(unit="rpm", low=10.0, high=600.0, text="a speed")
    angles: np.ndarray = parameter(unit="deg", low=-90.0, high=90.0, size=2, text="two angles")
    teeth: int = parameter(3, low=1, high=9, text="a count")


def declared(tmp_path, text: str) -> Sample:
    """The record as a node reads it from a parameter file."""
    (tmp_path / "node.yaml").write_text("/**:\n  ros__parameters:\n" + text)
    context = Context()
    rclpy.init(args=[], context=context)
    try:
        arguments = ["--ros-args", "--params-file", str(tmp_path / "node.yaml")]
        node = Node("sample", context=context, cli_args=arguments, use_global_arguments=False)
        try:
            return declare(node, Sample)
        finally:
            node.destroy_node()
    finally:
        rclpy.shutdown(context=context)


def test_a_node_takes_whole_numbers_where_floats_are_due(tmp_path):
    sample = declared(tmp_path, "    speed_rpm: 60\n    angles_deg: [30, -90]\n")
    assert sample.speed == pytest.approx(2 * np.pi)
    np.testing.assert_allclose(np.degrees(sample.angles), [30.0, -90.0])


def test_a_node_takes_whole_numbers_of_an_included_file(tmp_path):
    (tmp_path / "below.yaml").write_text("/**:\n  ros__parameters:\n    speed_rpm: 60\n    angles_deg: [30, -90.5]\n")
    with pytest.raises(ConfigError):  # -90.5 is out of range, not of type
        declared(tmp_path, f"    includes: ['{tmp_path / 'below.yaml'}']\n    teeth: 4\n")
    sample = declared(tmp_path, f"    includes: ['{tmp_path / 'below.yaml'}']\n    angles_deg: [1, 2]\n")
    assert sample.speed == pytest.approx(2 * np.pi) and sample.teeth == 3


def test_a_node_refuses_a_fraction_for_a_count_and_a_number_out_of_range(tmp_path):
    for text, key in (("speed_rpm: 60\n    teeth: 2.5", "teeth"), ("speed_rpm: 5", "speed_rpm")):
        with pytest.raises(ConfigError, match=key):
            declared(tmp_path, f"    {text}\n    angles_deg: [1.0, 2.0]\n")


# --- The end of a node process: exit codes and signals ---


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
