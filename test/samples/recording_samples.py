"""Messages of every type in the topic table, serialised by rosbags, for the other tests of recordings."""

import contextlib
import functools
import resource
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import QosDurability, QosHistory, QosLiveliness, QosReliability
from rosbags.typesys import Stores, get_typestore

from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.definitions import definition

STORE = get_typestore(Stores.ROS2_JAZZY)
PERIOD = 500_000  # [ns], the default exchange period

POSE, WRENCH, TWIST = (f"geometry_msgs/msg/{name}Stamped" for name in ("Pose", "Wrench", "Twist"))
JOINTS, GRID, TEXT = "sensor_msgs/msg/JointState", "nav_msgs/msg/OccupancyGrid", "std_msgs/msg/String"
PATH, JOINT_PATH = (f"trajectory_msgs/msg/{name}" for name in ("MultiDOFJointTrajectory", "JointTrajectory"))
DIAGNOSTICS, CLOCK = "diagnostic_msgs/msg/DiagnosticArray", "rosgraph_msgs/msg/Clock"

TOPICS = {
    "/target_trajectory": PATH,
    "/joint_trajectory": JOINT_PATH,
    "/tool_pose": POSE,
    "/wrench": WRENCH,
    "/deflection": TWIST,
    "/joint_states": JOINTS,
    "/workpiece": GRID,
    "/robot_description": TEXT,
    "/diagnostics": DIAGNOSTICS,
    "/clock": CLOCK,
}


def profile(depth: int = 10, durability: str = "VOLATILE"):
    """A reliable profile with the attributes of rclpy's."""
    keys = ("deadline", "lifespan", "liveliness_lease_duration")
    always = dict.fromkeys(keys, SimpleNamespace(nanoseconds=2**63 - 1))
    return SimpleNamespace(history=QosHistory.KEEP_LAST, depth=depth, reliability=QosReliability.RELIABLE,
                           durability=QosDurability[durability], liveliness=QosLiveliness.AUTOMATIC,
                           avoid_ros_namespace_conventions=False, **always)  # fmt: skip


def make(type_name: str, *args):
    return STORE.types[type_name](*args)


def time(nanoseconds: int, kind: str = "Time"):
    return make(f"builtin_interfaces/msg/{kind}", *divmod(nanoseconds, 10**9))


def header(stamp: int, frame: str = "base_link"):
    return make("std_msgs/msg/Header", time(stamp), frame)


def vector(values, kind: str = "Vector3"):
    return make(f"geometry_msgs/msg/{kind}", *map(float, values))


def pose(stamp: int, values, frame: str = "base_link"):
    inner = make("geometry_msgs/msg/Pose", vector(values[:3], "Point"), vector(values[3:], "Quaternion"))
    return make(POSE, header(stamp, frame), inner)


def wrench(stamp: int, values, frame: str = "workpiece"):
    return make(WRENCH, header(stamp, frame), make("geometry_msgs/msg/Wrench", vector(values[:3]), vector(values[3:])))


def twist(stamp: int, values, frame: str = "workpiece"):
    return make(TWIST, header(stamp, frame), make("geometry_msgs/msg/Twist", vector(values[:3]), vector(values[3:])))


def joints(stamp: int, position, velocity=(), effort=(), names=None):
    names = names or [f"joint_{i + 1}" for i in range(len(position))]
    return make(JOINTS, header(stamp, ""), names, *(np.array(v, float) for v in (position, velocity, effort)))


def path(stamp: int, times, positions, quaternions, velocities=None, names=("tcp",)):
    """positions (p, j, 3), quaternions (p, j, 4), velocities (p, j, 6) or None."""
    points = []
    for i, at in enumerate(times):
        places = zip(positions[i], quaternions[i], strict=True)
        transforms = [make("geometry_msgs/msg/Transform", vector(p), vector(q, "Quaternion")) for p, q in places]
        twists = [] if velocities is None else velocities[i]
        speeds = [make("geometry_msgs/msg/Twist", vector(v[:3]), vector(v[3:])) for v in twists]
        lasting = time(at, "Duration")
        points.append(make("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint", transforms, speeds, [], lasting))
    return make(PATH, header(stamp, "workpiece"), list(names), points)


def sample(topic: str, step: int):
    """The message of a topic at a step: numbers that are different everywhere."""
    stamp, kind = step * PERIOD, TOPICS[topic]
    values = step + 0.1 * np.arange(7)
    if kind == PATH:
        return path(stamp, [0, 10**9], values[:6].reshape(2, 1, 3), [[[0, 0, 0, 1]], [[0, 1, 0, 0]]])
    if kind == JOINT_PATH:
        numbers, none = values[:6], values[:0]
        point = make("trajectory_msgs/msg/JointTrajectoryPoint", numbers, none, none, none, time(10**8, "Duration"))
        return make(JOINT_PATH, header(stamp), [f"joint_{i}" for i in range(1, 7)], [point])
    if kind == GRID:
        info = make("nav_msgs/msg/MapMetaData", time(0), 1e-5, 40, 25, pose(0, [*values[:3], 0, 0, 0, 1]).pose)
        return make(GRID, header(stamp), info, (np.arange(1000) % 101).astype(np.int8))
    if kind == TEXT:
        return make(TEXT, f"<robot name='{step}'/>")
    if kind == CLOCK:
        return make(CLOCK, time(stamp))
    if kind == DIAGNOSTICS:
        status = make("diagnostic_msgs/msg/DiagnosticStatus", 1, "cutting_process", "äußerst gut", "",
                      [make("diagnostic_msgs/msg/KeyValue", "correction", str(step))])  # fmt: skip
        return make(DIAGNOSTICS, header(stamp), [status, status])
    return {POSE: pose, WRENCH: wrench, TWIST: twist, JOINTS: joints}[kind](stamp, values[: 7 if kind == POSE else 6])


def raw(message) -> bytes:
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def record(directory, steps: int = 50, topics=tuple(TOPICS), **options) -> list[tuple[str, int, bytes]]:
    """Write every topic ``steps`` times and return what was written: topic, log time and bytes in their order."""
    written = []
    with BagWriter(directory, **options) as writer:
        for topic in topics:
            writer.add_topic(topic, TOPICS[topic], [profile(1, "TRANSIENT_LOCAL")])
        for step in range(steps):
            for topic in topics:
                data = raw(sample(topic, step))
                writer.write(topic, data, 10**18 + step, step * PERIOD)
                written.append((topic, step * PERIOD, data))
    return written


def flipped(data: bytes, at: int, mask: int = 1) -> bytes:
    return data[:at] + bytes([data[at] ^ mask]) + data[at + 1 :]


class Whole(tuple):
    """Bytes and messages of a file; hypothesis prints its arguments, so the text is short."""

    def __repr__(self):
        return "whole"


def write_mcap(path, messages, compression=CompressionType.ZSTD, **options):
    """A file by mcap's writer; messages: (log time, bytes) and perhaps the publish time."""
    with open(path, "wb") as stream:
        writer = Writer(stream, compression=compression, **options)
        writer.start("ros2")
        schema = writer.register_schema(POSE, "ros2msg", definition(POSE).encode())
        channel = writer.register_channel("/tool_pose", "cdr", schema)
        for log_time, data, *publish_time in messages:
            writer.add_message(channel, log_time, data, *(publish_time or [log_time]))
        writer.finish()
    return path


@functools.cache
def whole_recording() -> Whole:
    """Bytes of a small file with several chunks, and its messages."""
    with tempfile.TemporaryDirectory() as folder:
        directory = Path(folder, "a")
        written = record(directory, 40, ["/tool_pose", "/wrench", "/robot_description"],
                         attachments={"cell.yaml": "a: 1\n" * 50}, metadata={"seed": 7}, chunk_size=2000)  # fmt: skip
        return Whole(((directory / "a.mcap").read_bytes(), written))


@contextlib.contextmanager
def full_disk(limit: int):
    """No file of this process can be longer than a limit [bytes]."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def poses(times) -> list[tuple[int, bytes]]:
    return [(int(t), raw(pose(int(t), np.arange(7) + i))) for i, t in enumerate(times)]


def read(path) -> tuple[list[tuple[str, int, bytes]], bool]:
    """Topic, log time and bytes of each message, and whether the file is cut off."""
    with Recording(path) as recording:
        return [(m.topic, m.log_time, m.data) for m in recording.messages()], recording.cut_off
