"""Messages for viewers of other people, as bytes: transforms, markers and paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kr270_milling.path.trajectory import Trajectory
from kr270_milling.recordings.messages.codec import named, serialise, time_fields

__all__ = [
    "ARROW",
    "LINE_STRIP",
    "MARKERS",
    "PATH",
    "TRANSFORMS",
    "Marker",
    "markers_bytes",
    "path_bytes",
    "transforms_bytes",
]

TRANSFORMS = "tf2_msgs/msg/TFMessage"
MARKERS = "visualization_msgs/msg/MarkerArray"
PATH = "nav_msgs/msg/Path"
PATH_POINTS = 500  #: points of a path, evenly in time, beside at most as many of its knots
ARROW, LINE_STRIP = 0, 4  #: visualization_msgs/msg/Marker.type


@dataclass(frozen=True, eq=False)
class Marker:
    """A line strip or an arrow from the first point to the second."""

    name: str  #: its name space
    frame: str
    kind: int  #: ARROW or LINE_STRIP
    width: float  #: width of the line, or of the shaft [m]
    points: np.ndarray  #: [m], (n, 3)
    colours: np.ndarray  #: red, green, blue, alpha from 0 to 1, (n, 4) or (4,) for the whole


def transforms_bytes(stamp_ns: int, frames: Sequence[tuple[str, str, np.ndarray, np.ndarray]]) -> bytes:
    """Return a TFMessage in which every frame has the same stamp.

    frames: parent, child, position in the parent's frame (3,) [m] and quaternion x, y, z, w there (4,).
    """
    rows = []
    for parent, child, position, quaternion in frames:
        header = {"stamp": time_fields(stamp_ns), "frame_id": parent}
        transform = {"translation": named("xyz", position), "rotation": named("xyzw", quaternion)}
        rows.append({"header": header, "child_frame_id": child, "transform": transform})
    return serialise(TRANSFORMS, {"transforms": rows})


def path_bytes(run: Trajectory) -> bytes:
    """A Path along a trajectory, in its frame; every pose has the stamp of its time from the start."""
    knots = run.time_ns[:: -(-len(run) // PATH_POINTS)]
    times = np.union1d(knots, np.linspace(0, run.duration_ns, PATH_POINTS).astype(np.int64))
    turns = run.quaternion[np.searchsorted(run.time_ns, times, side="right") - 1]  # of the knot before
    poses = [
        {
            "header": {"stamp": time_fields(ns), "frame_id": run.frame},
            "pose": {"position": named("xyz", place), "orientation": named("xyzw", turn)},
        }
        for ns, place, turn in zip(times.tolist(), run.sample(times), turns, strict=True)
    ]
    return serialise(PATH, {"header": {"frame_id": run.frame}, "poses": poses})


def markers_bytes(stamp_ns: int, markers: Sequence[Marker]) -> bytes:
    """A MarkerArray; every marker replaces the one of its name that was there before."""
    return serialise(MARKERS, {"markers": [_marker(stamp_ns, marker) for marker in markers]})


def _marker(stamp_ns: int, marker: Marker) -> dict:
    single = marker.colours.ndim == 1
    fields = {
        "header": {"stamp": time_fields(stamp_ns), "frame_id": marker.frame},
        "ns": marker.name,
        "type": marker.kind,
        "pose": {"orientation": {"w": 1.0}},
        "scale": {"x": marker.width, "y": 2 * marker.width * (marker.kind == ARROW), "z": 0.0},
        "points": marker.points,
        "color": named("rgba", marker.colours if single else np.ones(4)),
    }
    if not single:
        fields["colors"] = marker.colours
    return fields
