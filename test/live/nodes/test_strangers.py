"""Messages of strangers on every topic: each is survived, counted and named, and the pass after them is the same."""

import random
import time

import numpy as np
import pytest
from budget import budget

pytest.importorskip("rclpy")

from kr270_milling.base.samples import JointSample, PoseSample, Text, WrenchSample
from kr270_milling.cell.jobs import compensator, record_of
from kr270_milling.cell.models import path_of
from kr270_milling.live.nodes.compliant_robot import CompliantRobot
from kr270_milling.live.nodes.cutting_process import CuttingProcess
from kr270_milling.live.nodes.recorder import Recorder
from kr270_milling.live.nodes.trajectory_compensator import TrajectoryCompensator
from kr270_milling.live.ros import topics
from kr270_milling.live.ros.readiness import is_recorded
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.codec import serialise, to_bytes
from kr270_milling.recordings.messages.topics import COMPENSATOR, CUT, RECORDER, ROBOT

MESSAGES = 10_000  # a fifth of it in the suite
NUMBERS = (0.0, -1.0, float("nan"), float("inf"), -float("inf"), 1e300, 1e9, 5e-324)
TURN = np.array([1.0, 0.0, 0.0, 0.0])
DEEP = "[" * 100_000
KEYS = ("state", "reads", "records", "left_out", "reference", "recording", "waiting_for", "subscribers of /x")
TEXTS = (
    "",
    DEEP,
    "<robot/>",
    "<robot><link/><joint><child/></joint></robot>",
    "\0",
    "../..",
    "x" * 1_000_000,
    "<" * 999,
)


def numbers(rng: random.Random, count: int) -> np.ndarray:
    return np.array([rng.choice((*NUMBERS, rng.gauss(0.0, 10.0))) for _ in range(count)])


def stamp(rng: random.Random) -> int:
    return rng.choice((0, 1, 500_000, 2**31 * 10**9 - 1, rng.randrange(2**60)))


def frame(rng: random.Random) -> str:
    return rng.choice(("", "map", "workpiece", "tcp", "x" * 70_000, "\u00e4"))


def joint_state(rng: random.Random) -> bytes:
    ours = tuple(f"joint_{number}" for number in range(6, 0, -1))
    names = rng.choice((("finger",), ("joint_1",) * 9, (), ours, ("", "a") * 500))
    return to_bytes(JointSample(stamp(rng), names, numbers(rng, rng.choice((0, 1, len(names), 2000)))))


def trajectory(rng: random.Random, cell) -> bytes:
    """A trajectory that cannot be run: another frame, values that are not finite, out of reach, for years."""
    target, data = path_of(cell).target, to_bytes(path_of(cell).target)
    kind = rng.randrange(4)
    if kind == 0:
        return data.replace(b"workpiece", b"elsewhere")
    if kind == 1:
        return data[: rng.randrange(len(data))]
    if kind == 2:
        return to_bytes(target.with_position(target.position + [0.0, 0.0, rng.choice((9.0, -50.0))]))
    return data.replace(np.float64(target.position[1, 0]).tobytes(), np.float64(rng.choice(NUMBERS[2:6])).tobytes())


def report(rng: random.Random) -> bytes:
    """A report under the name of one of our nodes."""
    values = [{"key": key, "value": rng.choice((*TEXTS[:6], "active", "/a, /b"))} for key in rng.sample(KEYS, 4)]
    name = f"/{rng.choice((ROBOT, CUT, COMPENSATOR, RECORDER))}"
    status = [{"level": rng.randrange(4), "name": name, "message": rng.choice(TEXTS[:6]), "values": values}]
    return serialise("diagnostic_msgs/msg/DiagnosticArray", {"status": status})


def noise(rng: random.Random, data: bytes) -> bytes:
    """Bytes that are no message: random, cut, longer, or with a changed byte."""
    kind, at = rng.randrange(4), rng.randrange(max(len(data), 1))
    if kind == 0:
        return rng.choice((b"", b"\0", b"\0\1\0\0")) + rng.randbytes(rng.randrange(200))
    if kind == 1:
        return data[:at]
    return data + rng.randbytes(9) if kind == 2 else data[:at] + rng.randbytes(1) + data[at + 1 :]


def test_a_pattern_of_a_hundred_thousand_brackets_costs_nothing():
    start = time.process_time()
    assert not is_recorded("/tool_pose", [DEEP]) and is_recorded("/tool_pose", [DEEP, "/tool_*"])
    assert time.process_time() - start < 1.0


@pytest.fixture
def sources(world, short_cell):
    """Publishers of a stranger on every topic that a node uses, each with a generator of messages."""
    stranger = world.partner("stranger")
    made = [
        (topics.TARGET_TRAJECTORY, lambda rng: trajectory(rng, short_cell)),
        (topics.REFERENCE_TRAJECTORY, lambda rng: trajectory(rng, short_cell)),
        (topics.TOOL_POSE, lambda rng: to_bytes(PoseSample(stamp(rng), frame(rng), numbers(rng, 3), TURN))),
        (topics.WRENCH, lambda rng: to_bytes(WrenchSample(stamp(rng), frame(rng), numbers(rng, 6)))),
        (topics.JOINT_STATES, joint_state),
        (topics.ROBOT_DESCRIPTION, lambda rng: to_bytes(Text(rng.choice(TEXTS)))),
        (topics.DIAGNOSTICS, report),
    ]
    return stranger, [(stranger.create_publisher(*topic), generate) for topic, generate in made]


def test_messages_of_strangers_are_survived_counted_and_named_and_the_next_pass_is_the_same(
    world, short_cell, ran, tmp_path, sources
):
    """Random, empty, huge, cut and changed messages, wrong names, lengths, frames and values."""
    rng, count, (stranger, publishers) = random.Random(41), budget(MESSAGES), sources
    kinds = {ROBOT: CompliantRobot, CUT: CuttingProcess, COMPENSATOR: TrajectoryCompensator}
    nodes = {name: world.add(kind, cell=short_cell, directory=tmp_path) for name, kind in kinds.items()}
    recorder = nodes[RECORDER] = world.add(Recorder, "-p", f"directory:={tmp_path / 'r'}")
    reports = world.diagnostics(world.partner())
    world.until(lambda: all(publisher.get_subscription_count() for publisher, _ in publishers))
    for number in range(count):
        publisher, generate = rng.choice(publishers)
        data = generate(rng)
        publisher.publish(noise(rng, data) if rng.random() < 0.3 and "trajectory" not in publisher.topic else data)
        for _ in range(3):
            world.executor.spin_once(timeout_sec=0.0)
        if number == count // 2:
            for node in (nodes[CUT], nodes[ROBOT]):
                node.trigger_configure()
                node.trigger_activate()
    world.step(1.0)
    named = {name: set(node.unusable) for name, node in nodes.items()}
    assert [node.failure for node in nodes.values()] == [None] * 4
    assert {"tool_pose", "reference_trajectory"} <= named[CUT] and {"wrench", "reference_trajectory"} <= named[ROBOT]
    assert {"tool_pose", "wrench", "joint_states", "diagnostics", "target_trajectory"} <= named[COMPENSATOR]
    assert {"/robot_description", "/reference_trajectory"} <= named[RECORDER]
    assert not any(node.own_report().level == 2 for name, node in nodes.items() if name in (CUT, RECORDER))
    for name, node in nodes.items():
        assert node.refused >= sum(times for times, _, _ in node.unusable.values()) > 5
        world.until(lambda name=name: any(key.startswith("refused ") for key in reports.last.get(f"/{name}", ())))
    world.remove(stranger)
    for node in (nodes[CUT], nodes[ROBOT]):
        node.trigger_deactivate()
        node.trigger_cleanup()
        node.trigger_configure()
    assert world.request(f"/{COMPENSATOR}/reset").success
    passes = nodes[COMPENSATOR].protocol.passes
    for node in (nodes[CUT], nodes[ROBOT]):
        node.trigger_activate()
    world.until(lambda: nodes[COMPENSATOR].protocol.passes > passes)
    expected = compensator(short_cell, path_of(short_cell).target).revise(record_of(short_cell, ran)).position
    assert np.array_equal(nodes[COMPENSATOR].protocol.active.reference.position, expected)
    assert recorder.close() is None
    with Recording(tmp_path / "r") as recording:
        assert recording.topics()["/tool_pose"].count > ran.time_ns.size
