"""Recomputing recordings: of a plain exchange, of changed ones, and of one made by the real nodes."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pass_recording as made
import pytest

from kr270_milling.errors import ConfigError, MillingError
from kr270_milling.recompensate import compensate
from kr270_milling.recompute import recompute
from kr270_milling.recording.errors import RecordingError

pytestmark = made.needs_messages
STEPS = 121  # 4 mm at 4 m/min, every 0.5 ms
needs_ros = pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="rclpy is not installed")


def flip(offset: int, bit: int = 0):
    def change(data: bytes) -> bytes:
        other = bytearray(data)
        other[offset] ^= 1 << bit
        return bytes(other)

    return change


def force_offset(axis: int) -> int:
    """Where a wrench's force stands: behind 4 bytes, a stamp, "workpiece" with its length, aligned to 8."""
    return 4 + 8 + 4 + 10 + 2 + 8 * axis - (4 + 8 + 4 + 10 + 2 - 4) % 8


def test_a_recorded_exchange_is_recomputed_to_the_last_bit_on_every_channel(tmp_path):
    found = recompute(made.write(tmp_path / "r", made.one_pass()))
    assert found.verdict == "identical" and found.first is None and not found.stops
    counts = {topic: c.compared for topic, c in found.channels.items()}
    assert counts == {"/tool_pose": STEPS, "/wrench": STEPS, "/deflection": STEPS, "/joint_states": 7,
                      "/reference_trajectory": 2, "/joint_trajectory": 2, "/workpiece": 1}  # fmt: skip
    assert all(c.waiting == c.missing == c.given == 0 for c in found.channels.values())


@pytest.mark.parametrize("bit", [0, 51])
def test_one_flipped_mantissa_bit_of_a_wrench_is_named_exactly(tmp_path, bit):
    index, at = 60, force_offset(1)
    messages = made.changed(made.one_pass(), "wrench", index, flip(at + bit // 8, bit % 8))
    before = [m for m in made.one_pass() if m.topic == "wrench"][index].data
    after = [m for m in messages if m.topic == "wrench"][index].data
    first = recompute(made.write(tmp_path / "r", messages)).first
    assert (first.topic, first.index, first.stamp_ns) == ("/wrench", index, index * 500_000)
    assert first.field == "wrench.force.y"
    assert struct.pack("<d", first.recorded) == after[at : at + 8]
    assert struct.pack("<d", first.recomputed) == before[at : at + 8]
    assert first.recorded != first.recomputed


def test_a_changed_output_that_feeds_nothing_leaves_the_other_channels_identical(tmp_path):
    messages = made.changed(made.one_pass(), "deflection", 33, flip(force_offset(2)))
    found = recompute(made.write(tmp_path / "r", messages))
    assert found.verdict == "different" and found.first.topic == "/deflection" and found.first.index == 33
    assert found.first.field == "twist.linear.z"
    assert {t: c.differing for t, c in found.channels.items() if c.differing} == {"/deflection": 1}


def test_bytes_between_the_fields_do_not_count(tmp_path):
    pad = 4 + 8 + 4 + 10  # behind "workpiece" and its NUL
    messages = made.changed(made.one_pass(), "tool_pose", 5, flip(pad))
    assert messages != list(made.one_pass())
    assert recompute(made.write(tmp_path / "r", messages)).verdict == "identical"


def test_a_changed_map_of_the_workpiece_is_found(tmp_path):
    messages = made.changed(made.one_pass(), "workpiece", 0, flip(-2000))
    found = recompute(made.write(tmp_path / "r", messages))
    assert found.first.topic == "/workpiece" and found.first.field.startswith("data[")


def test_a_map_that_is_latched_from_the_pass_before_is_not_compared_with_this_one(tmp_path):
    messages = made.changed(made.one_pass(), "workpiece", 0, flip(-2000))
    latched = [m for m in messages if m.topic == "workpiece"]
    found = recompute(made.write(tmp_path / "r", [*latched, *made.one_pass()]))
    assert found.verdict == "identical"
    assert (found.channels["/workpiece"].given, found.channels["/workpiece"].compared) == (1, 1)


def test_a_changed_revised_reference_is_found(tmp_path):
    messages = made.changed(made.one_pass(), "reference_trajectory", 1, flip(-1 - 100))
    found = recompute(made.write(tmp_path / "r", messages))
    assert found.first.topic == "/reference_trajectory" and found.first.index == 1
    assert found.first.field.startswith("points[")


@pytest.mark.parametrize("topic, who", [("wrench", "wrench"), ("tool_pose", "tool pose")])
def test_a_missing_input_stops_the_recompute_at_its_stamp(tmp_path, topic, who):
    messages = made.changed(made.one_pass(), topic, 40, lambda data: None)
    found = recompute(made.write(tmp_path / "r", messages))
    assert found.verdict == "incomplete" and found.first is None
    assert [(s.stamp_ns, f"the {who} of this time" in s.reason) for s in found.stops] == [(40 * 500_000, True)]
    output = "/deflection" if topic == "wrench" else "/wrench"
    assert found.channels[output].compared == 40


def test_a_missing_output_is_counted_and_nothing_stops(tmp_path):
    messages = made.changed(made.one_pass(), "deflection", 40, lambda data: None)
    found = recompute(made.write(tmp_path / "r", messages))
    assert found.verdict == "identical"
    assert (found.channels["/deflection"].missing, found.channels["/deflection"].compared) == (1, STEPS - 1)


def test_a_pass_that_began_before_the_recording_is_not_guessed(tmp_path):
    messages = [m for m in made.one_pass() if m.stamp > 5_000_000 or "trajectory" in m.topic]
    found = recompute(made.write(tmp_path / "r", messages))
    assert found.verdict == "incomplete"
    assert all("middle of a pass" in s.reason for s in found.stops) and len(found.stops) == 2


def test_a_repeated_pose_and_its_repeated_answer_are_a_retry(tmp_path):
    messages = list(made.one_pass())
    at = next(i for i, m in enumerate(messages) if m.topic == "wrench" and m.stamp == 10_000_000)
    messages[at + 1 : at + 1] = messages[at - 1 : at + 1]
    found = recompute(made.write(tmp_path / "r", messages))
    assert found.verdict == "identical" and found.channels["/tool_pose"].repeated == 1
    assert found.channels["/wrench"].compared + found.channels["/wrench"].repeated == STEPS + 1


def test_an_iterated_exchange_is_recomputed_iteration_by_iteration(tmp_path):
    messages = made.one_pass("linear", 2)
    found = recompute(made.write(tmp_path / "r", messages, cell=made.cell_text("linear", 2)))
    assert found.verdict == "identical"
    assert found.channels["/wrench"].compared == 1 + 2 * (STEPS - 1)
    assert found.channels["/deflection"].compared == STEPS


@pytest.mark.parametrize("method", ["linear", "spline", "mirror", "learned"])
def test_several_passes_in_one_file_are_told_apart(tmp_path, method):
    found = recompute(made.write(tmp_path / "r", made.one_pass(method, 1, 3), cell=made.cell_text(method)))
    assert found.verdict == "identical", (found.first, found.stops)
    assert found.channels["/wrench"].compared == 3 * STEPS
    assert found.channels["/reference_trajectory"].compared == 4


@pytest.mark.parametrize("method", ["linear", "spline", "mirror"])
def test_a_pass_along_a_revised_reference_needs_no_earlier_pass(tmp_path, method):
    messages = made.one_pass(method, 1, 2)
    start = [i for i, m in enumerate(messages) if m.topic == "reference_trajectory"][1]
    found = recompute(made.write(tmp_path / "r", messages[start:], cell=made.cell_text(method)))
    assert found.verdict == "identical", (found.first, found.stops)
    reference = found.channels["/reference_trajectory"]
    assert (reference.given, reference.compared) == (1, 1)
    assert found.channels["/joint_trajectory"].compared == 2


def later_pass_of_learned(errors: list[float] | None, finished: bool = False) -> list:
    """The second pass of "learned" with what its compensator told in /diagnostics before it."""
    messages = list(made.one_pass("learned", 1, 2))
    start = [i for i, m in enumerate(messages) if m.topic == "reference_trajectory"][1]
    if errors is None:
        return messages[start:]
    told = {"method": "learned", "finished": str(finished), "remaining_error_um": " ".join(map(repr, errors))}
    return [made.diagnostics("/trajectory_compensator", told), *messages[start:]]


@pytest.mark.parametrize(
    "errors, finished, verdict",
    [
        ([48.6], False, "identical"),  # it goes on to learn, as the pass was better than the one before
        (None, False, "incomplete"),  # nobody tells how good the passes before were
        ([1e-9], False, "incomplete"),  # an earlier pass was better, whose reference is not in the file
    ],
)
def test_learned_is_decided_only_where_the_file_tells_enough(tmp_path, errors, finished, verdict):
    messages = later_pass_of_learned(errors, finished)
    found = recompute(made.write(tmp_path / "r", messages, cell=made.cell_text("learned")))
    assert found.verdict == verdict and found.first is None
    assert found.channels["/wrench"].compared == STEPS
    assert found.channels["/reference_trajectory"].compared == (verdict == "identical")
    assert all("earlier pass" in s.reason or "before this one" in s.reason for s in found.stops)


def test_learned_keeps_its_reference_when_it_has_finished(tmp_path):
    messages = later_pass_of_learned([48.6], finished=True)
    kept = next(m for m in messages if m.topic == "reference_trajectory").data
    messages = made.changed(messages, "reference_trajectory", 1, lambda data: kept)
    messages = made.changed(messages, "joint_trajectory", 1, lambda data: next(
        m.data for m in messages if m.topic == "joint_trajectory"))  # fmt: skip
    found = recompute(made.write(tmp_path / "r", messages, cell=made.cell_text("learned")))
    assert found.verdict == "identical" and found.channels["/reference_trajectory"].compared == 1


def test_two_robots_in_two_namespaces_are_recomputed_side_by_side(tmp_path):
    found = recompute(made.write(tmp_path / "r", made.one_pass(), namespaces=("/left", "/cell/right")))
    assert found.verdict == "identical"
    assert {t.rpartition("/")[0] for t in found.channels} == {"/left", "/cell/right"}
    assert found.channels["/cell/right/wrench"].compared == STEPS


def test_a_recording_that_was_cut_off_is_compared_up_to_its_end(tmp_path):
    whole = made.write(tmp_path / "r", made.one_pass()) / "r.mcap"
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 4])
    found = recompute(cut)
    assert found.cut_off and found.verdict == "identical"
    assert 0 < found.channels["/wrench"].compared < STEPS


def test_messages_of_other_topics_may_come_before_their_causes(tmp_path):
    messages = list(made.one_pass())
    late = messages.pop(0)  # a recorder that heard the latched reference after the pass had begun
    messages.insert(30, late)
    assert recompute(made.write(tmp_path / "r", messages)).verdict == "identical"


@pytest.mark.parametrize(
    "attached, sentence",
    [
        ({}, "no parameter file attached"),
        ({"a.yaml": "", "b.yaml": ""}, "has a.yaml, b.yaml attached"),
        ({"cell.yaml": "nonsense"}, "must have the form"),
        ({"cell.yaml": made.cell_text().replace("paper.yaml", "/etc/hostname")}, "which is not attached"),
        ({"cell.yaml": made.cell_text("sideways")}, "compensation.method"),
    ],
)
def test_a_recording_without_a_usable_cell_is_refused_in_one_sentence(tmp_path, attached, sentence):
    directory = made.write(tmp_path / "r", made.one_pass()[:20], attachments=attached)
    with pytest.raises((RecordingError, ConfigError), match=sentence) as error:
        recompute(directory)
    assert "\n" not in str(error.value) and "r.mcap" in str(error.value)


def test_the_attached_files_are_used_and_not_the_shipped_ones(tmp_path):
    paper = Path(made.shipped("paper.yaml")).read_text()
    attached = {"cell.yaml": made.cell_text(), "paper.yaml": paper.replace("teeth: 4", "teeth: 2")}
    found = recompute(made.write(tmp_path / "r", made.one_pass(), attachments=attached))
    assert found.verdict == "different" and found.first.topic == "/wrench"


def test_a_recording_of_something_else_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="holds no tool_pose"):
        recompute(made.write(tmp_path / "r", [], cell=made.cell_text()))


@pytest.mark.parametrize("method", ["linear", "spline", "mirror"])
def test_the_compensator_makes_of_a_recording_what_was_published(tmp_path, method):
    messages = made.one_pass(method)
    (revised,) = compensate(made.write(tmp_path / "r", messages, cell=made.cell_text(method)))
    published = [m.data for m in messages if m.topic == "reference_trajectory"]
    assert revised.published is True and revised.method == method
    assert made.reference_data(revised.reference) == published[1] != published[0]


def test_another_method_may_be_asked_of_a_recording(tmp_path):
    directory = made.write(tmp_path / "r", made.one_pass("linear"))
    (revised,) = compensate(directory, "spline")
    expected = [m.data for m in made.one_pass("spline") if m.topic == "reference_trajectory"][1]
    assert revised.published is None and made.reference_data(revised.reference) == expected


def test_a_broken_off_pass_gives_no_revision(tmp_path):
    directory = made.write(tmp_path / "r", made.one_pass()[:100])
    with pytest.raises(RecordingError, match="no complete pass"):
        compensate(directory)


class Graph:
    """The real nodes as processes of one domain; the log of each is a file."""

    def __init__(self, directory: Path):
        self.directory, self.running = directory, {}
        environment = {**os.environ, "ROS_DOMAIN_ID": str(60 + os.getpid() % 40), "ROS_LOG_DIR": str(directory)}
        environment["PYTHONPATH"] = str(Path(__file__).resolve().parent.parent)
        environment["FASTRTPS_DEFAULT_PROFILES_FILE"] = made.shipped("fastdds.xml")
        self.environment = environment

    def start(self, node: str, *arguments: str) -> None:
        command = [sys.executable, "-m", f"kr270_milling.nodes.{node}", "--ros-args", *arguments]
        with open(self.directory / node, "wb") as log:
            self.running[node] = subprocess.Popen(command, env=self.environment, stdout=log, stderr=log)

    def wait_for(self, node: str, text: str, limit: float = 60.0) -> None:
        end = time.monotonic() + limit
        while text not in (log := (self.directory / node).read_text(errors="replace")):
            assert time.monotonic() < end and self.running[node].poll() is None, f"{node}: {log}"
            time.sleep(0.02)

    def stop(self) -> dict[str, int]:
        for process in self.running.values():
            process.send_signal(signal.SIGINT)
        return {node: process.wait(20) for node, process in self.running.items()}


@pytest.fixture(scope="session")
def of_nodes(tmp_path_factory) -> Path:
    """A pass of the four real nodes, recorded; the directory of the recording."""
    directory = tmp_path_factory.mktemp("nodes")
    cell = directory / "cell.yaml"
    cell.write_text(made.cell_text())
    parameters = ["--params-file", str(cell)]
    made.one_pass()  # compiles what the nodes load
    graph = Graph(directory)
    try:
        graph.start("recorder", "-p", f"directory:={directory / 'r'}", "-p", f"attach:={cell}")
        graph.wait_for("recorder", "recording to")
        graph.start("trajectory_compensator", *parameters)
        graph.start("cutting_process", *parameters, "-p", "autostart:=true")
        graph.wait_for("cutting_process", "waiting for the tool")
        graph.wait_for("trajectory_compensator", "the target itself")
        graph.start("compliant_robot", *parameters, "-p", "autostart:=true", "-p", "pace:=0.1")
        graph.wait_for("trajectory_compensator", "revised after pass 1")
        time.sleep(0.3)  # the recorder hears the last of it
    finally:
        codes = graph.stop()
    assert set(codes.values()) == {0}
    return directory / "r"


@needs_ros
def test_a_recording_of_the_real_nodes_is_bit_identical_on_every_channel(of_nodes):
    found = recompute(of_nodes)
    assert found.verdict == "identical", (found.first, found.stops)
    compared = {topic: c.compared for topic, c in found.channels.items()}
    assert {t: compared[t] for t in ("/tool_pose", "/wrench", "/deflection")} == {
        "/tool_pose": STEPS, "/wrench": STEPS, "/deflection": STEPS}  # fmt: skip
    assert compared["/joint_states"] == compared["/clock"] == 7
    assert compared["/reference_trajectory"] == compared["/joint_trajectory"] == 2
    assert compared["/robot_description"] == 1
    assert all(c.differing == c.missing == c.waiting == 0 for c in found.channels.values())


@needs_ros
def test_the_compensator_makes_of_a_recording_what_the_live_node_published(of_nodes):
    (revised,) = compensate(of_nodes)
    assert revised.published is True and revised.method == "linear"


@needs_ros
def test_the_real_nodes_publish_what_the_plain_exchange_gives(of_nodes):
    heard = [data for topic, data in made.raw(of_nodes) if topic == "/wrench"]
    assert heard == [m.data for m in made.one_pass() if m.topic == "wrench"]


@needs_ros
def test_a_killed_recorders_file_is_recomputed_as_far_as_it_goes(of_nodes, tmp_path):
    file = next(of_nodes.glob("*.mcap"))
    cut = tmp_path / "cut.mcap"
    shutil.copy(file, cut)
    with open(cut, "r+b") as stream:
        stream.truncate(int(file.stat().st_size * 0.6))
    found = recompute(cut)
    assert found.cut_off and found.verdict == "identical" and found.channels["/wrench"].compared > 0


@needs_ros
def test_the_bytes_made_here_are_those_of_the_middlewares_serialiser():
    from geometry_msgs.msg import PoseStamped, TwistStamped
    from nav_msgs.msg import OccupancyGrid
    from rclpy.serialization import deserialize_message, serialize_message
    from rosgraph_msgs.msg import Clock
    from std_msgs.msg import String

    from kr270_milling.recording import encode
    from kr270_milling.ros import messages
    from kr270_milling.trajectory.trajectory import Trajectory

    def same(message, encoded: encode.Encoded) -> bool:
        """The serialiser leaves rubbish between the fields and behind the last one."""
        kind, wire = type(message), serialize_message(message)
        whole = encode.Encoded(encoded.data, encoded.pads).same(wire[: len(encoded.data)])
        return whole and deserialize_message(encoded.data, kind) == deserialize_message(wire, kind)

    random = np.random.default_rng(7).normal(size=40)
    line = Trajectory.straight_line([0.0, 0.0, 0.1], [1.0, 0.0, 0.0], 0.01, 0.05, 0.05)
    curve = Trajectory.spline(np.arange(5) * 40_000_000, random[:15].reshape(5, 3))
    stamp, removed = 3_000_000_001, np.abs(np.sin(random[:28])).reshape(7, 4)
    cells = np.rint(100 * (1 - removed)).astype(np.int8)
    pairs = [
        (messages.pose_to_msg(stamp, random[:3], random[3:7]),
         encode.pose_bytes(stamp, "workpiece", random[:3], random[3:7])),
        (messages.wrench_to_msg(stamp, random[:6]), encode.vectors_bytes(stamp, "workpiece", random[:6])),
        (messages.twist_to_msg(stamp, random[:6]), encode.vectors_bytes(stamp, "workpiece", random[:6])),
        (messages.joint_state_to_msg(stamp, random[:6]), encode.joint_state_bytes(stamp, made.NAMES, random[:6])),
        (Clock(clock=messages.stamp_from_ns(stamp)), encode.clock_bytes(stamp)),
        (String(data="fräsen"), encode.string_bytes("fräsen")),
        (messages.joint_trajectory_to_msg(curve, random[:30].reshape(5, 6)),
         encode.joint_trajectory_bytes("base_link", made.NAMES, curve.time_ns, random[:30].reshape(5, 6))),
        (messages.workpiece_to_msg(stamp, removed, random[:3], 2e-4),
         encode.map_bytes(stamp, "workpiece", 2e-4, random[:3], cells)),
    ]  # fmt: skip
    for run in (line, curve):
        encoded = encode.trajectory_bytes(run.frame, "tool0", run.time_ns, run.position, run.quaternion, run.velocity)
        pairs.append((messages.trajectory_to_msg(run), encoded))
    assert [same(message, encoded) for message, encoded in pairs] == [True] * len(pairs)
    assert {PoseStamped, TwistStamped, OccupancyGrid} <= {type(message) for message, _ in pairs}


@pytest.mark.parametrize("seed", range(30))
def test_messages_with_any_content_end_in_a_verdict_or_a_sentence(tmp_path, seed):
    random = np.random.default_rng(seed)
    messages = list(made.one_pass()[:60]) + [m for m in made.one_pass()[60:] if "trajectory" in m.topic]
    for _ in range(3):
        at = int(random.integers(len(messages)))
        data = bytearray(messages[at].data)
        where = int(random.integers(len(data)))
        if random.random() < 0.3:
            del data[where:]
        else:
            data[where : where + 8] = random.bytes(8)[: len(data) - where]
        messages[at] = made.Message(messages[at].topic, bytes(data), 0)
    directory = made.write(tmp_path / "r", messages)
    for job in (recompute, compensate):
        with contextlib.suppress(MillingError):
            job(directory)
