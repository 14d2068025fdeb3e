"""Recordings of a short pass for tests: made message by message without a ROS graph, and changed afterwards."""

import argparse
import dataclasses
import functools
import importlib.util
import struct
from pathlib import Path

import pytest
from samples.recording_samples import GRID, JOINTS, PATH, POSE, TEXT, TWIST, WRENCH, profile

from kr270_milling.base.arguments import PLAY
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell import cell_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.compensator import CompensatorProtocol
from kr270_milling.exchange.cut import CutProtocol
from kr270_milling.exchange.replay.recompute import recompute
from kr270_milling.exchange.robot import RobotProtocol
from kr270_milling.recordings.bag.reader import Recording, playback, span
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.recordings.messages.topics import TOPICS

needs_messages = pytest.mark.skipif(
    importlib.util.find_spec("geometry_msgs") is None, reason="the message definitions of ROS are not installed"
)
STATE = "diagnostic_msgs/msg/DiagnosticStatus"
LATCHED = profile(1, "TRANSIENT_LOCAL")
LATCHED_TOPICS = {topic.name for topic in TOPICS if topic.latched}
LATCHED_FIRST = 2  # state and reference, which the compensator publishes together
STEPS = 121  # 4 mm at 4 m/min, every 0.5 ms


@dataclasses.dataclass
class Message:
    topic: str
    data: bytes
    stamp: int


@functools.cache
def cell_of(method: str = "linear", iterations: int = 1, every: int = 1):
    sets = ("path.length_mm=4", "stock.grid_step_um=20", "cutting.chip_angle=previous_centre", "cutting.moments=true",
            f"compensation.method={method}", f"exchange.iterations={iterations}", f"publish.every={every}")  # fmt: skip
    return read_cell(find_file("paper.yaml"), sets)


@functools.cache
def cell_text(method: str = "linear", iterations: int = 1, every: int = 1) -> str:
    return cell_file.cell_text(cell_of(method, iterations, every))


def one_pass(
    method: str = "linear", iterations: int = 1, passes: int = 1, every: int = 1, begin: int = 0
) -> tuple[Message, ...]:  # fmt: skip
    """The messages of the nodes' protocols in some passes of one file, in the order of causes; begin: of the first."""
    latched, *ran = passes_of(method, ("r/r.mcap",) * passes, iterations, every, begin=begin)
    return (*latched, *(message for one in ran for message in one))


def files_of(method: str, names: tuple[str, ...], plant=None) -> list[list[Message]]:
    """The messages of each pass where every pass has a file NAME/NAME.mcap, with those that are latched before it."""
    parts = passes_of(method, tuple(f"{name}/{name}.mcap" for name in names), 1, 1, plant)
    return [[*before[-LATCHED_FIRST:], *part] for before, part in zip(parts, parts[1:], strict=False)]


@functools.cache
def passes_of(
    method: str, files: tuple[str, ...], iterations: int = 1, every: int = 1, plant=None, begin: int = 0
) -> list[list[Message]]:
    """The messages before the first pass, and in each pass; plant: of robot and cut."""
    cell = cell_of(method, iterations, every)
    cuts = plant or cell
    robot, cut = RobotProtocol(cuts), CutProtocol(cuts)
    compensator = CompensatorProtocol(cell, plant, now=lambda: begin)
    parts = [messages(compensator.begin(path_of(cell).target))]
    for file in files:
        parts.append(_exchange(robot, cut, compensator, file))
    return parts


def target_of_user(target) -> list[Message]:
    """A pass along a target that the user publishes."""
    compensator = CompensatorProtocol(cell_of())
    published = [Message("target_trajectory", to_bytes(target), 0), *messages(compensator.begin(target))]
    return [*published, *pass_along(compensator, "r/r.mcap")]


def pass_along(compensator, file: str) -> list[Message]:
    """A pass of the linear cell along the reference of a compensator, recorded to a file."""
    return _exchange(RobotProtocol(cell_of()), CutProtocol(cell_of()), compensator, file)


def messages(outputs) -> list[Message]:
    return [Message(topic, to_bytes(record), getattr(record, "stamp", 0)) for topic, record in outputs]


def _exchange(robot, cut, compensator, file: str) -> list[Message]:
    """A pass on a fresh workpiece; robot and cut receive the reference with its start."""
    compensator.recording = file
    robot.reference = compensator.active.reference.starting_at(compensator.inbox.start_ns)
    cut.reference(robot.reference)
    cut.configure()
    sent, revised, outputs = [], [], robot.start()
    while outputs:
        sent += messages(output for output in outputs if output[0] != "clock")
        poses = [record for topic, record in outputs if topic == "tool_pose"]
        outputs = []
        for pose in poses:
            revised += compensator.pose(pose)
            answer = cut.pose(pose)
            sent += messages(answer)
            revised += compensator.wrench(answer[0][1])
            outputs += robot.wrench(answer[0][1])
    return sent + messages([("workpiece", cut.map_of_part())]) + messages(revised)


TYPES = {"tool_pose": POSE, "wrench": WRENCH, "deflection": TWIST, "joint_states": JOINTS, "robot_description": TEXT,
         "reference_trajectory": PATH, "target_trajectory": PATH, "workpiece": GRID,
         "compensator_state": STATE}  # fmt: skip


def write(
    directory, messages, *, namespaces=("",), attachments=None, cell: str | None = None, spacing: int = 1
) -> Path:
    """A recording of messages, published in each namespace alike; returns its directory.

    spacing [ns]: from the receipt of a message to that of the next.
    """
    attached = {"cell.yaml": cell_text() if cell is None else cell} if attachments is None else attachments
    with BagWriter(directory, attachments=attached, metadata={"seed": "1"}) as writer:
        for namespace in namespaces:
            for name, kind in TYPES.items():
                writer.add_topic(f"{namespace}/{name}", kind, [LATCHED] if name in LATCHED_TOPICS else ())
        for i, message in enumerate(messages):
            for namespace in namespaces:
                writer.write(f"{namespace}/{message.topic}", message.data, 10**9 + spacing * i)
            if i % 50 == 49:
                writer.flush()
    return Path(directory)


def changed(messages, topic: str, index: int, change) -> list[Message]:
    """The messages with ``change(bytes) -> bytes`` done to one; None leaves it out."""
    result, count = [], -1
    for message in messages:
        count += message.topic == topic
        if message.topic == topic and count == index:
            data = change(message.data)
            if data is not None:
                result.append(dataclasses.replace(message, data=data))
        else:
            result.append(message)
    return result


def without(topic: str, index: int, messages=None) -> list[Message]:
    return changed(one_pass() if messages is None else messages, topic, index, lambda data: None)


def recomputed(directory, messages, **options):
    """What a recompute of a recording of these messages gives."""
    return recompute(write(directory, messages, **options))


def flip(offset: int, bit: int = 0):
    def change(data: bytes) -> bytes:
        other = bytearray(data)
        other[offset] ^= 1 << bit
        return bytes(other)

    return change


def later(message: Message, stamp: int) -> Message:
    head = struct.pack("<iI", stamp // 10**9, stamp % 10**9)
    return dataclasses.replace(message, data=message.data[:4] + head + message.data[12:], stamp=stamp)


def force_offset(axis: int) -> int:
    """The offset of a wrench's force: after 4 bytes, a stamp, "workpiece" with its length, aligned to 8."""
    return 28 + 8 * axis


def options(*words: str) -> argparse.Namespace:
    """Of a playback, from the words of a command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("file")
    for names, keywords in PLAY:
        parser.add_argument(*names, **keywords)
    return parser.parse_args(list(words))


def played(bag, *words: str) -> list:
    """The messages of a playback in their order."""
    chosen = options(str(bag), *words)
    with Recording(bag) as recording:
        topics = set(chosen.topics or recording.topics())
        start, end = span(recording, chosen.start_offset, chosen.playback_duration)
        return list(playback(recording, topics, start, end))


def raw(directory) -> list[tuple[str, bytes]]:
    with Recording(directory) as recording:
        return [(m.topic, m.data) for m in recording.messages()]
