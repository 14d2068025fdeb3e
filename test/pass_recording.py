"""Recordings of a short pass for tests: made message by message without a ROS graph, and changed afterwards."""

from __future__ import annotations

import dataclasses
import functools
import importlib.util
from pathlib import Path

import numpy as np
import pytest

from kr270_milling.bag.reader import Recording
from kr270_milling.bag.writer import BagWriter
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import commanded_joints, compensator, pass_record
from kr270_milling.messages import encode
from kr270_milling.simulation.sides import CuttingSide, RobotSide

needs_messages = pytest.mark.skipif(
    importlib.util.find_spec("geometry_msgs") is None, reason="the message definitions of ROS are not installed"
)
CELL = """/**:
  ros__parameters:
    includes: ["paper.yaml"]
    path: {{length_mm: 4.0}}
    stock: {{grid_step_um: 20.0}}
    exchange: {{iterations: {iterations}}}
    compensation: {{method: {method}}}
"""
POSE, TWIST = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped"
WRENCH, JOINTS = "geometry_msgs/msg/WrenchStamped", "sensor_msgs/msg/JointState"
REFERENCE, PROGRAM = "trajectory_msgs/msg/MultiDOFJointTrajectory", "trajectory_msgs/msg/JointTrajectory"
LATCHED = {"durability": "transient_local", "depth": 1}
NAMES = [f"joint_a{i}" for i in range(1, 7)]
STEPS = 121  # 4 mm at 4 m/min, every 0.5 ms


@dataclasses.dataclass
class Message:
    topic: str
    data: bytes
    stamp: int


def cell_text(method: str = "linear", iterations: int = 1) -> str:
    return CELL.format(method=method, iterations=iterations)


@functools.cache
def cell_of(method: str = "linear", iterations: int = 1):
    import tempfile

    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory, "cell.yaml")
        file.write_text(cell_text(method, iterations))
        return read_cell(file)


def diagnostics(node: str, values: dict[str, str]) -> Message:
    """One diagnostic status of a node."""
    array = encode.Builder().header(0, "").pack("I", 1).pack("B", 0).string(node).string("").string("")
    array.pack("I", len(values))
    for key, value in values.items():
        array.string(key).string(value)
    return Message("diagnostics", array.done().data, 0)


def reference_data(run) -> bytes:
    return encode.trajectory_bytes(run.frame, "tool0", run.time_ns, run.position, run.quaternion, run.velocity).data


@functools.cache
def one_pass(method: str = "linear", iterations: int = 1, passes: int = 1) -> tuple[Message, ...]:
    """What the four nodes publish in some passes, in the order of causes."""
    cell = cell_of(method, iterations)
    state = compensator(cell, cell.target())
    found = [*_published(cell, state.reference)]
    for _ in range(passes):
        record = []
        found += _exchange(cell, state.reference, record)
        stamps, positions, wrenches = (np.array(column) for column in zip(*record, strict=True))
        state.revise(pass_record(cell, stamps, positions, wrenches))
        found += _published(cell, state.reference)
    return tuple(found)


def _published(cell, reference):
    joints = encode.joint_trajectory_bytes("base_link", NAMES, reference.time_ns, commanded_joints(cell, reference))
    return Message("reference_trajectory", reference_data(reference), 0), Message("joint_trajectory", joints.data, 0)


def _exchange(cell, reference, record: list):
    robot = RobotSide(cell.arm_model(reference), cell.clock, reference, cell.exchange.iterations)
    cut, step, thinned = CuttingSide(cell.cut(), cell.clock), 0, cell.thinned_steps()
    course = cell.joints_at(robot.course[::thinned], robot.orientation[::thinned])
    while not robot.done:
        stamp, tool = robot.awaited_ns, robot.tool
        pose = encode.pose_bytes(stamp, "workpiece", tool, robot.orientation_now)
        yield Message("tool_pose", pose.data, stamp)
        wrench = cut.answer(stamp, tool)
        yield Message("wrench", encode.vectors_bytes(stamp, "workpiece", wrench).data, stamp)
        deflection = robot.answer(stamp, wrench)
        if deflection is None:
            continue
        record.append((stamp, tool, wrench))
        yield Message("deflection", encode.vectors_bytes(stamp, "workpiece", deflection).data, stamp)
        if step % thinned == 0:
            joints = encode.joint_state_bytes(stamp, NAMES, course[step // thinned])
            yield Message("joint_states", joints.data, stamp)
        step += 1
    yield Message("workpiece", _workpiece(cell, cut, stamp), stamp)


def _workpiece(cell, cut, stamp: int) -> bytes:
    """Percent of the stock's height that is left, every 0.2 mm."""
    stock, thinning = cell.stock, round(0.2e-3 / cell.stock.grid_step)
    height = cut.cut.heights(thinning=thinning)[2]
    left = np.rint(100 * (1 - (stock.max[2] - height) / (stock.max[2] - stock.min[2])))
    return encode.map_bytes(stamp, "workpiece", thinning * stock.grid_step, stock.min, left.astype(np.int8)).data


TYPES = {"tool_pose": POSE, "wrench": WRENCH, "deflection": TWIST, "joint_states": JOINTS,
         "reference_trajectory": REFERENCE, "joint_trajectory": PROGRAM,
         "workpiece": "nav_msgs/msg/OccupancyGrid", "diagnostics": "diagnostic_msgs/msg/DiagnosticArray"}  # fmt: skip


def write(directory, messages, *, namespaces=("",), attachments=None, cell: str | None = None) -> Path:
    """A recording of messages, published in each namespace alike; returns its directory."""
    kept = {"cell.yaml": cell_text() if cell is None else cell} if attachments is None else attachments
    with BagWriter(directory, attachments=kept, metadata={"seed": "1"}) as writer:
        for namespace in namespaces:
            for name, kind in TYPES.items():
                writer.add_topic(
                    f"{namespace}/{name}", kind, [LATCHED] if "trajectory" in name or name == "workpiece" else [{}]
                )
        for i, message in enumerate(messages):
            for namespace in namespaces:
                writer.write(f"{namespace}/{message.topic}", message.data, 10**9 + i)
            if i % 50 == 49:
                writer.flush()
    return Path(directory)


def changed(messages, topic: str, index: int, change) -> list[Message]:
    """The messages with ``change(bytes) -> bytes`` done to one; None leaves it out."""
    found, count = [], -1
    for message in messages:
        count += message.topic == topic
        if message.topic == topic and count == index:
            data = change(message.data)
            if data is not None:
                found.append(dataclasses.replace(message, data=data))
        else:
            found.append(message)
    return found


def flip(offset: int, bit: int = 0):
    def change(data: bytes) -> bytes:
        other = bytearray(data)
        other[offset] ^= 1 << bit
        return bytes(other)

    return change


def force_offset(axis: int) -> int:
    """Where a wrench's force stands: behind 4 bytes, a stamp, "workpiece" with its length, aligned to 8."""
    return 4 + 8 + 4 + 10 + 2 + 8 * axis - (4 + 8 + 4 + 10 + 2 - 4) % 8


def raw(directory) -> list[tuple[str, bytes]]:
    with Recording(directory) as recording:
        return [(m.topic, m.data) for m in recording.messages()]


def shipped(name: str) -> str:
    return str(find_file(name))
