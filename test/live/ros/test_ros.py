"""What all nodes share: reports, transitions, parameters, the environment of their processes."""

import os
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from ros_domain import is_used

from kr270_milling.base.errors import InputError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.base.record import Record, specs
from kr270_milling.cell.cell_file import cell_text, read_cell, write_cell_file
from kr270_milling.live.nodes.cutting_process import CuttingProcess
from kr270_milling.live.ros.environment import GUARD, PARENT, PROFILES, RANGE, child_environment, this_host_only
from kr270_milling.live.ros.node import ManagedNode
from kr270_milling.live.ros.readiness import Report, unmatched

ERROR = 2
ROOT = Path(__file__).resolve().parents[3]


class Failing(ManagedNode):
    def __init__(self, **kwargs):
        super().__init__("failing", **kwargs)

    def configure(self) -> None:
        raise InputError("stock", "is missed by the path")

    def refuse(self) -> None:
        raise InputError("message", "of no use")

    def stumble(self) -> None:
        raise ZeroDivisionError("a mistake")


def test_failed_transition_and_unusable_input_are_reported_and_a_mistake_in_a_callback_ends_the_node(world):
    node, reports = world.add(Failing), world.diagnostics(world.partner())
    world.until(lambda: "/failing" in reports.last)
    for _ in range(2):  # a transition can be repeated
        node.trigger_configure()
        reports.until("/failing", "is missed by the path", ERROR)
    assert not node.active
    refused = node.refused
    refuse = node.create_timer(0.01, node.refuse)
    reports.until("/failing", "of no use", ERROR)
    refuse.cancel()
    assert node.failure is None and node.refused > refused
    node.create_timer(0.01, node.stumble)
    world.until(lambda: node.failure)
    assert node.failure == "ZeroDivisionError in stumble: a mistake"


def test_a_closed_node_leaves_no_port(world, domain, short_cell, tmp_path):
    world.add(CuttingProcess, cell=short_cell, directory=tmp_path)
    assert is_used(domain)
    world.close()
    end = time.monotonic() + 60.0
    while is_used(domain):
        assert time.monotonic() < end, "a port is open"
        time.sleep(0.02)


# --- whether a pass may start, by the reports of its nodes ---


@pytest.mark.parametrize(("node", "key", "value", "sentence"), [
    ("cut", "refused", "0", ""),
    ("robot", "subscribers of /a", "cut, viewer", "robot has not discovered that recorder subscribes to /a"),
    ("robot", "subscribers of /a", "recorder", "robot has not discovered that cut subscribes to /a"),
    ("recorder", "records", "", "robot has not discovered that recorder subscribes to /b"),
    ("recorder", "left_out", "/b", ""),
    ("cut", "reference", "2", "not every node has the reference: robot has 1"),
])  # fmt: skip
def test_a_pass_may_start_when_every_publisher_knows_every_subscriber(node, key, value, sentence):
    """A robot and a cut, and a recorder of the topics "a*", with one other value."""
    values = {
        "robot": {"subscribers of /a": "cut, recorder", "subscribers of /b": "", "reads": "/w", "reference": "1"},
        "cut": {"subscribers of /w": "robot", "reads": "/a, /x", "reference": "1"},
        "recorder": {"reads": "/a", "records": "/a*", "left_out": "/w" if key == "records" else ""},
    }
    values[node][key] = value
    missing = unmatched({name: Report(0, "", texts) for name, texts in values.items()})
    assert missing.startswith(sentence) and bool(missing) == bool(sentence)


# --- the environment of node processes: discovery on this host only ---


SHIPPED = str(find_file("fastdds.xml").resolve())
HOST = {RANGE: "LOCALHOST"}


@pytest.mark.parametrize(("given", "added"), [
    ({}, {PROFILES[0]: SHIPPED, RANGE: "SYSTEM_DEFAULT"}), (HOST, {PROFILES[0]: SHIPPED, **HOST}),
    ({PROFILES[0]: "/my.xml"}, HOST), ({PROFILES[1]: "/my.xml"}, HOST),
    ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, HOST), ({RANGE: "SUBNET"}, {}),
])  # fmt: skip
def test_discovery_stays_on_this_host_unless_the_user_opens_it(given, added):
    """With the shipped profile, where the user has no profile and no other middleware."""
    assert this_host_only(given) == added


def test_child_finds_its_own_libraries_and_knows_its_parent(monkeypatch):
    monkeypatch.setenv(GUARD, "1")
    environment = child_environment()
    assert GUARD not in environment
    assert environment[PARENT] == str(os.getpid())


# --- The cell file of a run: the numbers of the cell, bit for bit ---


def values(record: Record) -> list:
    rows = [(spec.key, getattr(record, spec.name)) for spec in specs(type(record))]
    return [pair for key, value in rows for pair in (values(value) if isinstance(value, Record) else [(key, value)])]


def test_cell_file_gives_the_same_numbers_bit_for_bit_without_another_file_or_an_empty_list(tmp_path):
    given = ("tool.diameter_mm=12.7", "path.feed_rate_m_per_min=3.3", "mount.abc_deg=[0.1,89.9,0.7]")
    cell = read_cell(find_file("paper.yaml"), given)
    write_cell_file(cell, tmp_path / "cell.yaml")
    again, text = read_cell(tmp_path / "cell.yaml"), (tmp_path / "cell.yaml").read_text()
    for (key, before), (_, after) in zip(values(cell), values(again), strict=True):
        missing = isinstance(before, float) and np.isnan(before)  # a coefficient of the law that is not in use
        assert np.array_equal(before, after, equal_nan=missing), key
    assert "includes" not in text and "[]" not in text


def test_tool_path_file_is_named_absolutely(tmp_path, monkeypatch):
    (tmp_path / "part.nc").write_text(find_file("test_piece.nc").read_text())
    (tmp_path / "cell.yaml").write_text(find_file("test_piece.yaml").read_text().replace("test_piece.nc", "part.nc"))
    monkeypatch.chdir(tmp_path)
    assert str(tmp_path / "part.nc") in cell_text(read_cell("cell.yaml"))
