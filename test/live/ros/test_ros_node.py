from __future__ import annotations

import subprocess
import sys

import pytest
from ros_domain import running
from sample_messages import wrench_msg

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
