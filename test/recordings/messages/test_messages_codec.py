"""Records to bytes and back, against the middleware's own serialiser and in a circle."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from same_bits import same_bits
from splines import spline

from kr270_milling.base.samples import (
    ClockSample,
    JointProgram,
    JointSample,
    PoseSample,
    StockMap,
    Text,
    TwistSample,
    WrenchSample,
)
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.messages import codec
from kr270_milling.recordings.messages.codec import (
    deserialise,
    from_bytes,
    serialise,
    to_bytes,
    trajectory_from_bytes,
    type_of,
)

RANDOM = np.random.default_rng(7).normal(size=40)
ROWS = np.random.default_rng(8).normal(size=(3, 5, 6))
ROWS[1:, 2] = ROWS[2, 3] = np.nan  # a point with positions only, and a point without accelerations
NAMES = tuple(f"joint_{i}" for i in range(1, 7))
STAMP = 3_000_000_001
RECORDS = [
    PoseSample(STAMP, "workpiece", RANDOM[:3], RANDOM[3:7]),
    WrenchSample(STAMP, "tcp", RANDOM[:6]),
    TwistSample(0, "workpiece", RANDOM[6:12]),
    JointSample(STAMP, NAMES, RANDOM[:6]),
    JointSample(STAMP, (), ()),
    ClockSample(STAMP),
    Text("fräsen"),
    JointProgram(STAMP, "base_link", NAMES, np.arange(5) * 40_000_000, ROWS[0], ROWS[1], ROWS[2]),
    StockMap(STAMP, "workpiece", float(np.float32(2e-4)), RANDOM[:3], np.arange(28).reshape(7, 4)),
]
RUNS = [
    Trajectory.straight_line([0.0, 0.0, 0.1], [1.0, 0.0, 0.0], 0.01, 0.05, 0.05),
    spline(np.arange(5) * 40_000_000, RANDOM[:15].reshape(5, 3)),
]


@pytest.mark.parametrize("record", RECORDS, ids=lambda r: type(r).__name__)
def test_a_record_comes_back_from_its_bytes_with_every_bit(record):
    assert same_bits(from_bytes(type_of(record), to_bytes(record)), record) == ""


@pytest.mark.parametrize("run", RUNS)
def test_a_trajectory_comes_back_with_every_bit(run):
    actual = trajectory_from_bytes(to_bytes(run), as_sent=True)
    assert actual.frame == run.frame and actual.time_ns.tobytes() == run.time_ns.tobytes()
    assert actual.position.tobytes() == run.position.tobytes()
    assert actual.quaternion.tobytes() == run.quaternion.tobytes()
    assert (actual.velocity is None) == (run.velocity is None)
    assert run.velocity is None or actual.velocity.tobytes() == run.velocity.tobytes()


@pytest.mark.parametrize("record", [*RECORDS, *RUNS], ids=lambda r: type(r).__name__)
def test_the_middleware_reads_the_bytes_as_the_same_message(record):
    rclpy = pytest.importorskip("rclpy.serialization")
    package, _, name = type_of(record).split("/")
    kind = getattr(pytest.importorskip(f"{package}.msg"), name)
    message = rclpy.deserialize_message(to_bytes(record), kind)
    again = rclpy.serialize_message(message)
    assert rclpy.deserialize_message(again, kind) == message
    if not isinstance(record, Trajectory):
        assert same_bits(from_bytes(type_of(record), again), record) == ""


@pytest.mark.parametrize("record", RECORDS, ids=lambda r: type(r).__name__)
def test_bytes_that_end_early_are_refused(record):
    data = to_bytes(record)
    for end in (0, 3, 8, len(data) // 2, len(data) - 2):
        with pytest.raises(ValueError):
            from_bytes(type_of(record), data[:end])


def test_same_bits_tells_minus_zero_a_shape_and_another_nan():
    def posed(*position: float) -> PoseSample:
        return PoseSample(0, "a", np.array(position), np.array([0.0, 0.0, 0.0, 1.0]))

    pose = posed(0.0, 1.0, np.nan)
    assert same_bits(pose, posed(0.0, 1.0, np.nan)) == ""
    assert same_bits(pose, posed(-0.0, 1.0, np.nan)) == "position"
    assert same_bits(pose, posed(0.0, 1.0, -np.nan)) == "position"
    assert same_bits(pose, posed(0.0, 1.0)) == "position"
    assert same_bits(pose, PoseSample(0, "b", pose.position, pose.quaternion)) == "frame"
    assert same_bits(pose, ClockSample(0)) == "type"


def test_a_record_refuses_a_wrong_shape_and_keeps_its_arrays():
    with pytest.raises(ValueError, match="position"):
        JointSample(0, NAMES, [[1.0, 2.0]])
    with pytest.raises(ValueError, match="read-only"):
        next(record for record in RECORDS if isinstance(record, JointSample)).position[0] = 1.0


def test_any_message_is_written_from_nested_mappings():
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    status = {"name": "n", "level": 2, "values": [{"key": "k", "value": "v"}]}
    actual = deserialise(kind, serialise(kind, {"header": {"stamp": {"sec": 1}}, "status": [status]}))
    assert actual.header.stamp.sec == 1 and actual.status[0].level == 2 and actual.status[0].values[0].value == "v"
    with pytest.raises(KeyError, match="no field x"):
        serialise(kind, {"x": 1})


def test_the_example_of_the_readme_runs():
    text = Path(codec.__file__).with_name("README.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(example, {})
