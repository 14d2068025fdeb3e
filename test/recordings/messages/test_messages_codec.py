"""Records to bytes and back: in a circle, against the middleware's own serialiser, and what must be refused."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from splines import spline

from kr270_milling.base import samples
from kr270_milling.base.errors import MessageError
from kr270_milling.base.samples import PoseSample, WrenchSample
from kr270_milling.exchange.inputs import checked_pose, checked_wrench
from kr270_milling.path.trajectory import Trajectory, TrajectoryError
from kr270_milling.recordings.messages import codec
from kr270_milling.recordings.messages.codec import to_bytes

POSE, WRENCH = (codec.type_of(record) for record in (PoseSample, WrenchSample))
RANDOM = np.random.default_rng(7).normal(size=40)
ROWS = np.random.default_rng(8).normal(size=(3, 5, 6))
ROWS[1:, 2] = ROWS[2, 3] = np.nan  # a point with positions only, and a point without accelerations
NAMES = tuple(f"joint_{i}" for i in range(1, 7))
STAMP = 3_000_000_001
DOWN = np.array([1.0, 0.0, 0.0, 0.0])
LEARNED = (
    samples.LearnedRecording("original/original.mcap", "ab" * 32, 121, 120),
    samples.LearnedRecording("", "cd" * 32, 3, 0),
)
RECORDS = [
    PoseSample(STAMP, "workpiece", RANDOM[:3], RANDOM[3:7]),
    WrenchSample(STAMP, "tcp", RANDOM[:6]),
    samples.TwistSample(0, "workpiece", RANDOM[6:12]),
    samples.JointSample(STAMP, NAMES, RANDOM[:6]),
    samples.JointSample(STAMP, (), ()),
    samples.ClockSample(STAMP),
    samples.Text("fräsen"),
    samples.JointProgram(STAMP, "base_link", NAMES, np.arange(5) * 40_000_000, ROWS[0], ROWS[1], ROWS[2]),
    samples.StockMap(STAMP, "workpiece", float(np.float32(2e-4)), RANDOM[:3], np.arange(28).reshape(7, 4)),
    samples.CompensatorState("/left/trajectory_compensator", "learned", 2, True, "01234567", "89abcdef", LEARNED),
]
RUNS = [
    Trajectory.straight_line([0.0, 0.0, 0.1], [1.0, 0.0, 0.0], 0.01, 0.05, 0.05),
    spline(np.arange(5) * 40_000_000, RANDOM[:15].reshape(5, 3)),
]


def bits(record) -> tuple:
    """Type and fields of a record; of arrays the type, the shape and the bytes: -0.0 is not 0.0."""
    names = record._fields if hasattr(record, "_fields") else [field.name for field in dataclasses.fields(record)]
    values = [getattr(record, name) for name in names]
    return type(record), [
        (value.dtype, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value for value in values
    ]


@pytest.mark.parametrize("record", [*RECORDS, *RUNS], ids=lambda r: type(r).__name__)
def test_a_record_comes_back_with_every_bit_also_from_the_middleware(record):
    def read(data: bytes):
        run = isinstance(record, Trajectory)
        return codec.trajectory_from_bytes(data, as_sent=True) if run else codec.from_bytes(codec.type_of(record), data)

    data = to_bytes(record)
    assert bits(read(data)) == bits(record)
    for end in (0, 3, 8, len(data) // 2, len(data) - 2):
        with pytest.raises((ValueError, MessageError)):
            read(data[:end])
    rclpy = pytest.importorskip("rclpy.serialization")
    package, _, name = codec.type_of(record).split("/")
    kind = getattr(pytest.importorskip(f"{package}.msg"), name)
    assert bits(read(rclpy.serialize_message(rclpy.deserialize_message(data, kind)))) == bits(record)


def test_every_number_is_in_the_field_of_its_name():
    pose, wrench, twist = (codec.deserialise(codec.type_of(record), to_bytes(record)) for record in RECORDS[:3])
    assert (pose.header.stamp.sec, pose.header.stamp.nanosec, pose.header.frame_id) == (3, 1, "workpiece")
    at, turn = pose.pose.position, pose.pose.orientation
    assert [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w] == RANDOM[:7].tolist()
    pairs = (wrench.wrench.force, wrench.wrench.torque), (twist.twist.linear, twist.twist.angular)
    for (one, other), values in zip(pairs, (RANDOM[:6], RANDOM[6:12]), strict=True):
        assert [one.x, one.y, one.z, other.x, other.y, other.z] == values.tolist()


def test_a_record_keeps_its_arrays():
    with pytest.raises(ValueError, match="position"):
        samples.JointSample(0, NAMES, [[1.0, 2.0]])
    with pytest.raises(ValueError, match="read-only"):
        RECORDS[3].position[0] = 1.0


def test_what_the_exchange_cannot_use_is_refused():
    for frame in ("base_link", "", "workpiece2", "Workpiece", "tcp"):
        with pytest.raises(MessageError, match="frame"):
            checked_pose(codec.from_bytes(POSE, to_bytes(PoseSample(0, frame, np.zeros(3), DOWN))))
    for bad in (np.nan, np.inf, -np.inf):
        for values in np.where(np.eye(6), bad, 1.0):
            with pytest.raises(MessageError, match="not finite"):
                checked_wrench(codec.from_bytes(WRENCH, to_bytes(WrenchSample(0, "workpiece", values))))
            with pytest.raises(MessageError):
                checked_pose(PoseSample(0, "workpiece", values[:3], np.append(values[3:], 0.0)))
    with pytest.raises(MessageError):
        checked_pose(PoseSample(0, "workpiece", np.zeros(3), 2 * DOWN))
    large = WrenchSample(3, "workpiece", np.full(6, 1.7e308))  # finite, though the sum overflows
    with pytest.raises(MessageError, match="beyond"):
        checked_wrench(large)
    with pytest.raises(ValueError, match="too early"):
        codec.from_bytes(WRENCH, to_bytes(large)[:40])


def test_a_trajectory_of_something_else_is_refused_and_tool0_is_the_tool_tip_before_0_3():
    run = Trajectory([0, 10], [[0.0, 0, 0], [1e-3, 0, 0]], DOWN, [[0.1, 0, 0], [0.1, 0, 0]])
    data, far = to_bytes(run), np.float64(1e-3).tobytes()
    fields = codec.deserialise("trajectory_msgs/msg/MultiDOFJointTrajectory", data)
    fields.joint_names = ["tool0"]
    old = codec.store_of(codec.type_of(run)).serialize_cdr(fields, codec.type_of(run))
    assert to_bytes(codec.trajectory_from_bytes(bytes(old))) == data == to_bytes(codec.trajectory_from_bytes(data))
    for changed, error, sentence in (
        (data.replace(b"workpiece", b"base_link"), MessageError, "frame"),
        (data.replace(b"tcp", b"tip"), MessageError, "tcp"),
        (data[:70], MessageError, "cannot be read"),
        (data.replace(far, np.float64(np.nan).tobytes()), TrajectoryError, "finite"),
    ):
        with pytest.raises(error, match=sentence):
            codec.trajectory_from_bytes(changed)


def test_a_state_with_other_fields_is_refused_and_rclpy_reads_a_state():
    state, kind = RECORDS[-1], "diagnostic_msgs/msg/DiagnosticStatus"
    read = codec.deserialise(kind, to_bytes(state))
    assert (read.level, read.name) == (0, state.name)
    assert {pair.key: pair.value for pair in read.values}["learned_1.recording"] == "original/original.mcap"
    with pytest.raises(ValueError, match="state of a compensator"):
        codec.from_bytes(kind, to_bytes(state).replace(b"finished", b"finishes"))


def test_any_message_is_written_from_nested_mappings():
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    status = {"name": "n", "level": 2, "values": [{"key": "k", "value": "v"}]}
    actual = codec.deserialise(kind, codec.serialise(kind, {"header": {"stamp": {"sec": 1}}, "status": [status]}))
    assert actual.header.stamp.sec == 1 and actual.status[0].level == 2 and actual.status[0].values[0].value == "v"
    with pytest.raises(KeyError, match="no field x"):
        codec.serialise(kind, {"x": 1})
    points = RANDOM[:30].reshape(10, 3)
    strip = {"points": points, "colors": np.abs(points[:, [0, 1, 2, 0]]), "text": "ä", "header": {"frame_id": "abc"}}
    array = ("visualization_msgs/msg/MarkerArray", {"markers": [strip, {}, strip]})
    kinds = [name for name in codec.store_of(kind).fielddefs if "/msg/" in name]
    for name, fields in [array, *((name, {}) for name in kinds)]:  # as rosbags writes them
        data = codec.serialise(name, fields)
        assert bytes(codec.store_of(name).serialize_cdr(codec.deserialise(name, data), name)) == data, name


def test_the_example_of_the_page_runs():
    text = Path(codec.__file__).parents[2].joinpath("guide/contributing/messages.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(example, {})


def test_a_second_record_of_a_message_type_is_refused():
    with pytest.raises(ValueError, match="geometry_msgs/msg/PoseStamped has a record already"):
        codec._by_type([codec.KINDS[PoseSample], codec.KINDS[PoseSample]])
