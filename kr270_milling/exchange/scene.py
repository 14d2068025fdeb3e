"""Messages for viewers such as RViz and Foxglove: transforms, the path coloured by its error, the force, trajectories.

Bytes of the graph's topics in, bytes of ``/tf``, ``/tf_static`` and ``/markers`` out; time is the stamp of messages.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.frames import OLD_TOOL, TOOL, WORKPIECE, quaternion_from_rotation
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.robot.urdf import Link, links_of
from kr270_milling.recordings.messages.cdr import stamp_of
from kr270_milling.recordings.messages.codec import from_bytes, named, serialise, time_fields
from kr270_milling.recordings.messages.topics import TOPICS

#: topic -> type of the derived messages; transforms are global, as viewers expect
OUTPUTS = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/markers": "visualization_msgs/msg/MarkerArray",
}
#: topic that a scene receives, without its namespace -> type
INPUTS = {topic.name: topic.type for topic in TOPICS if topic.scene}
LOW, HIGH = np.array([0.03, 0.31, 0.59, 1.0]), np.array([0.90, 0.35, 0.05, 1.0])  #: colours of no and of full error
LINE_STRIP, ARROW = 4, 0  # visualization_msgs/msg/Marker.type


class Scene:
    """The scene of a robot. ``take`` receives the messages of its topics; it yields topic and bytes of others."""

    def __init__(self):
        self._links: tuple[Link, ...] = ()
        self._target: Trajectory | None = None
        self._start_ns = self._next_ns = 0  # starts of the pass and of the next pass
        self._fresh()
        self._tool_width = 0.02  # [m], of the tip in the description

    def _fresh(self) -> None:
        self._points: list[np.ndarray] = []
        self._errors: list[float] = []
        self._cuts: list[bool] = []
        self._spacing = 1
        self._count = 0
        self._pose_due = self._wrench_due = self._joints_due = 0
        self._force = np.zeros(3)

    def take(self, name: str, data: bytes) -> Iterator[tuple[str, bytes]]:
        """name: of the topic without its namespace. Raises MillingError, ValueError if the bytes are not a message."""
        if name == "robot_description":
            self._links = links_of(from_bytes(INPUTS[name], data).text)
            tips = [link for link in self._links if link.name in (TOOL, OLD_TOOL)]
            tools = [mesh for link in tips for mesh in link.meshes if mesh.colour == "tool"]
            self._tool_width = 2 * float(np.hypot(*tools[0].vertex[:, :2].T).max()) if tools else 0.02
            yield "/tf_static", self._transforms(0, {}, moving=False)
        elif name.endswith("_trajectory"):
            run = from_bytes(INPUTS[name], data)
            if name == "target_trajectory" or self._target is None:
                self._target = run
            if name == "reference_trajectory":
                self._next_ns = run.start_ns
        elif name in ("joint_states", "tool_pose", "wrench"):
            yield from self._of_the_pass(name, data, stamp_of(data) or 0)

    def _of_the_pass(self, name: str, data: bytes, stamp: int) -> Iterator[tuple[str, bytes]]:
        period_ns = 33_333_333  # between two messages, 30 Hz
        if name == "tool_pose" and stamp < self._pose_due - period_ns or self._start_ns < self._next_ns <= stamp:
            self._fresh()  # the next pass
            self._start_ns = self._next_ns
        if name == "joint_states":
            if self._links and stamp >= self._joints_due:
                names = [link.joint for link in self._links if link.joint]
                state = from_bytes(INPUTS[name], data)
                if not {*names} & {*state.names}:
                    return  # of a gripper or of another robot
                joints = dict(zip(names, state.of(names), strict=True))
                self._joints_due = stamp + period_ns
                yield "/tf", self._transforms(stamp, joints, moving=True)
        elif name == "wrench":
            if stamp >= self._wrench_due:
                self._wrench_due = stamp + period_ns
                self._force = from_bytes(INPUTS[name], data).wrench[:3]
        elif stamp >= self._pose_due:
            self._pose_due = stamp + period_ns
            self._add_point(stamp, from_bytes(INPUTS[name], data).position)
            yield "/markers", serialise(OUTPUTS["/markers"], {"markers": self._markers(stamp)})

    def _transforms(self, stamp_ns: int, joints: Mapping[str, float], moving: bool) -> bytes:
        """Return the frames of the moving or of the fixed links, in their parents; joints: name -> [rad]."""
        links = [link for link in self._links if link.parent >= 0 and bool(link.joint) == moving]
        turns = [joints[link.joint] * link.axis if moving else np.zeros(3) for link in links]
        turned = Rotation.from_rotvec(np.reshape(turns, (-1, 3))).as_matrix()
        quaternions = quaternion_from_rotation(np.reshape([link.rotation for link in links], (-1, 3, 3)) @ turned)
        rows = [
            {
                "header": {"stamp": time_fields(stamp_ns), "frame_id": self._links[link.parent].name},
                "child_frame_id": link.name,
                "transform": {"translation": named("xyz", link.xyz), "rotation": named("xyzw", quaternion)},
            }
            for link, quaternion in zip(links, quaternions, strict=True)
        ]
        return serialise(OUTPUTS["/tf"], {"transforms": rows})

    def _add_point(self, stamp: int, position: np.ndarray) -> None:
        self._count += 1
        if self._count % self._spacing:
            return
        error = (
            0.0
            if self._target is None
            else float(np.linalg.norm(position - self._target.sample(stamp - self._start_ns)))
        )
        self._points.append(position)
        self._errors.append(error)
        self._cuts.append(float(np.linalg.norm(self._force)) > 0.1)
        if len(self._points) > 200:  # then every second point is removed
            self._points, self._errors, self._cuts = self._points[::2], self._errors[::2], self._cuts[::2]
            self._spacing *= 2

    def _markers(self, stamp: int) -> list[dict]:
        points = np.array(self._points).reshape(-1, 3)
        share = np.clip(np.array(self._errors) / 100e-6, 0.0, 1.0)[:, None]  # 100 um: the far end of the colours
        cut = points[np.array(self._cuts, bool)]
        markers = []
        if len(points) > 1:
            colours = {"color": named("rgba", np.ones(4)), "colors": LOW + share * (HIGH - LOW)}
            markers.append(_marker(stamp, "path", LINE_STRIP, 1e-3, points, colours))
        if len(cut) > 1:
            grey = {"color": named("rgba", (0.6, 0.65, 0.7, 0.6))}
            markers.append(_marker(stamp, "removed", LINE_STRIP, self._tool_width, cut, grey))
        if len(points):
            ends = np.stack([points[-1], points[-1] + 1e-3 * self._force])  # [m/N]
            green = {"color": named("rgba", (0.0, 0.5, 0.35, 1.0))}
            markers.append(_marker(stamp, "force", ARROW, 4e-3, ends, green))
        return markers


def _marker(stamp: int, name: str, kind: int, width: float, points: np.ndarray, colours: Mapping) -> dict:
    """Return a marker, which replaces the earlier one of its name; width of the line, or of the shaft [m]."""
    return {
        "header": {"stamp": time_fields(stamp), "frame_id": WORKPIECE},
        "ns": name,
        "type": kind,
        "pose": {"orientation": {"w": 1.0}},
        "scale": {"x": width, "y": 2 * width * (kind == ARROW)},
        "points": points,
        **colours,
    }


def path_bytes(run: Trajectory) -> bytes:
    """Return a Path along a trajectory, in its frame; every pose has the stamp of its time from the start."""
    path_points = 500  # points of a path, evenly in time, beside at most as many of its knots
    knots = run.time_ns[:: -(-len(run) // path_points)]
    times = np.union1d(knots, np.linspace(0, run.duration_ns, path_points).astype(np.int64))
    turns = run.quaternion[np.searchsorted(run.time_ns, times, side="right") - 1]  # of the knot before
    poses = [
        {
            "header": {"stamp": time_fields(ns), "frame_id": run.frame},
            "pose": {"position": named("xyz", place), "orientation": named("xyzw", turn)},
        }
        for ns, place, turn in zip(times.tolist(), run.sample(times), turns, strict=True)
    ]
    return serialise("nav_msgs/msg/Path", {"header": {"frame_id": run.frame}, "poses": poses})
