"""Parameter records as ROS parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip("rclpy")

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from kr270_milling.base.errors import ConfigError
from kr270_milling.base.record import Record, parameter
from kr270_milling.live.ros.parameters import declare


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
