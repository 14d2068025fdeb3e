"""messages.scene: what viewers are given follows from the topics of the graph."""

import contextlib

import numpy as np
import pytest
from samples import pass_recording as made

from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.base.samples import JointSample, PoseSample, Text
from kr270_milling.cell.models import path_of
from kr270_milling.exchange.scene import OUTPUTS, Scene
from kr270_milling.physics.robot import forward
from kr270_milling.physics.robot.urdf import urdf
from kr270_milling.recordings.messages.codec import to_bytes
from kr270_milling.recordings.messages.definitions import deserialise

pytestmark = made.needs_messages


@pytest.fixture(scope="module")
def cell():
    return made.cell_of()


def placed(cell, joints) -> dict[str, np.ndarray]:
    """Every frame on base_link, by chaining the transforms that a viewer gets."""
    scene = Scene()
    description = Text(urdf(cell.arm, cell.mount, cell.tool.radius, cell.workpiece.pose))
    result = list(scene.take("robot_description", to_bytes(description)))
    names, gripper = [f"joint_{i}" for i in range(1, 7)], JointSample(0, ("finger",), np.array([0.1]))
    assert not list(scene.take("joint_states", to_bytes(gripper)))
    turned = JointSample(0, ("finger", *names[::-1]), np.array([0.1, *joints[::-1]]))  # in another order
    result += scene.take("joint_states", to_bytes(turned))
    frames = {"base_link": np.eye(4)}
    waiting = [t for topic, data in result for t in deserialise(OUTPUTS[topic], data).transforms]
    while waiting:
        one = waiting.pop(0)
        if one.header.frame_id not in frames:
            waiting.append(one)
            continue
        t, r = one.transform.translation, one.transform.rotation
        step = np.eye(4)
        step[:3, :3] = rotation_from_quaternion(np.array([r.x, r.y, r.z, r.w]))
        step[:3, 3] = t.x, t.y, t.z
        frames[one.child_frame_id] = frames[one.header.frame_id] @ step
    return frames


def test_the_transforms_put_every_frame_where_the_kinematics_does(cell):
    for joints in np.random.default_rng(5).uniform(-1.2, 1.2, (4, 6)):
        frames, ours = placed(cell, joints), forward(cell.arm, cell.mount, joints)
        for name, pose in (("flange", ours.flange), ("tcp", ours.tool), ("workpiece", cell.workpiece.pose)):
            np.testing.assert_allclose(frames[name][:3, 3], pose.position, atol=1e-8)
            np.testing.assert_allclose(frames[name][:3, :3], pose.rotation, atol=1e-8)


def test_a_long_path_stays_small_and_is_coloured_by_its_error(cell):
    scene, target = Scene(), path_of(cell).target
    list(scene.take("target_trajectory", to_bytes(target)))
    shift, upright = np.array([0.0, 200e-6, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])
    for k in range(450):
        stamp = k * 40_000_000
        position = target.sample(stamp) + (shift if k > 225 else 0.0)
        result = list(scene.take("tool_pose", to_bytes(PoseSample(stamp, "workpiece", position, upright))))
    (markers,) = (deserialise(OUTPUTS[topic], data).markers for topic, data in result)
    (path,) = (marker for marker in markers if marker.ns == "path")
    assert 100 <= len(path.points) <= 200 and len(path.colors) == len(path.points)
    assert path.colors[0].r < 0.1 and path.colors[-1].r > 0.85  # from no error to the end of the scale


@pytest.mark.parametrize(
    "text", ["<robot/>", "<robot", "", "<robot><joint/></robot>", "<robot><link name='a'/></robot>"]
)
def test_a_description_of_something_else_gives_no_moving_frames_and_noise_is_refused(text):
    with contextlib.suppress(ValueError):
        result = list(Scene().take("robot_description", to_bytes(Text(text))))
        assert not [t for topic, data in result for t in deserialise(OUTPUTS[topic], data).transforms]
    with pytest.raises(ValueError, match="CDR|not"):
        list(Scene().take("robot_description", b"noise"))
