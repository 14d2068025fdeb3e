"""The target of a pass from a recording: a nav_msgs/Path, or a MultiDOFJointTrajectory with its times.

A Path contains positions. The stamps of its poses determine the feed; ``feed_rate`` does if all stamps are equal. The
orientations are used if tcp z points into the part. If z points straight up in all of them, as in empty orientations
and in headings of planners, they do not describe a tool, and the tool is vertical.
"""

from __future__ import annotations

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.base.frames import OLD_TOOL, TOOL, WORKPIECE
from kr270_milling.base.units import SECOND
from kr270_milling.path.timing import TimedPath
from kr270_milling.path.toolpath import REACH, Toolpath
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory, TrajectoryError
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import TRAJECTORY, TrajectoryRecord, read_trajectory
from kr270_milling.recordings.messages.definitions import deserialise

PATH = "nav_msgs/msg/Path"


def read_recorded(path, topic: str = "", feed: float = 0.0) -> Toolpath | TimedPath:
    """Read the one path or trajectory of a recording, or that on ``topic``; feed [m/s]: for a Path without times.

    Raises RecordingError if there is none, if there are several, or if it cannot be run.
    """
    with Recording(path) as recording:
        fits = {name: t.type for name, t in recording.topics().items() if t.type in (PATH, TRAJECTORY) and t.count}
        listed = ", ".join(f"{name} ({kind})" for name, kind in fits.items())
        if topic and topic not in fits:
            raise RecordingError(path, f"has no path on path.topic {topic!r}, but on: {listed or 'no topic'}")
        if not topic and len(fits) != 1:
            several = f"several topics have a path, name one as path.topic: {listed}"
            raise RecordingError(path, several if fits else f"has no {PATH} and no {TRAJECTORY}")
        topic = topic or next(iter(fits))
        try:
            data = b""
            for message in recording.messages([topic]):
                data = data or message.data
                if message.data[12:] != data[12:]:  # a repeated message may differ only in its stamp
                    raise ValueError("has several different paths; a recording must have one")
            if recording.topics()[topic].encoding != "cdr":
                raise ValueError("has no message that can be read")
            if fits[topic] == TRAJECTORY:
                return _timed(read_trajectory(data))
            frames, time, position, quaternion = read_path(data)
            _expect_frame(frames[0], *filter(None, frames[1:]))  # an empty frame is the frame of the message
            chosen = _moving(position)
            feeds = np.append(0.0, _feeds(time, position, chosen[1:], feed))
            return _blocks(chosen, position, _orientations(quaternion), feeds, np.zeros(len(chosen)))
        except (ValueError, TrajectoryError) as error:
            reason = getattr(error, "reason", error)
            point = getattr(error, "index", None)
            where = "" if point is None else f"point {point + 1}: "
            raise RecordingError(path, f"{topic}: {where}{reason}") from error


def read_path(data: bytes) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]:
    """Read one serialised nav_msgs/Path with n poses; raises ValueError for other bytes.

    Returns the frame of the message and those of its poses, each once; stamps [ns], (n,) int64; positions [m], (n, 3);
    quaternions x y z w, (n, 4).
    """
    message = deserialise(PATH, data)
    headers = [pose.header for pose in message.poses]
    frames = dict.fromkeys([message.header.frame_id, *(header.frame_id for header in headers)])
    time = np.array([header.stamp.sec * SECOND + header.stamp.nanosec for header in headers], np.int64)
    places = [(pose.pose.position, pose.pose.orientation) for pose in message.poses]
    position = np.array([(p.x, p.y, p.z) for p, _ in places]).reshape(-1, 3)
    return tuple(frames), time, position, np.array([(q.x, q.y, q.z, q.w) for _, q in places]).reshape(-1, 4)


def _feeds(time: np.ndarray, position: np.ndarray, moves: np.ndarray, feed_rate: float) -> np.ndarray:
    """Feed [m/s], (n - 1,), from each pose to the next."""
    step = np.diff(time)
    if not step.any():
        if not feed_rate > 0.0:
            raise ValueError("its poses all have one stamp, so they give no feed; set path.feed_rate_m_per_min")
        return np.full(step.size, feed_rate)
    bad = (step < 0) | ((step == 0) & moves)
    if bad.any():
        k = int(np.argmax(bad))
        raise ValueError(f"pose {k + 2} needs a later stamp than the pose before")
    length = np.linalg.norm(np.diff(position, axis=0), axis=1)
    feed = length / np.maximum(step, 1) * 1e9
    if not np.max(feed) <= REACH:
        k = int(np.argmax(feed))
        raise ValueError(f"by its stamps the tool would go to pose {k + 2} at {feed[k]:.3g} m/s")
    # six digits: stamps are whole nanoseconds and would turn one feed into many
    unit = 10.0 ** (np.floor(np.log10(np.where(feed > 0, feed, 1.0))) - 5)
    return np.round(feed / unit) * unit


def _orientations(quaternion: np.ndarray) -> np.ndarray:
    """Orientations of tcp, (n, 4); those of a vertical tool if the poses do not describe a tool."""
    if not np.isfinite(quaternion).all():
        raise ValueError("an orientation is not finite")
    x, y, z, w = quaternion.T
    if np.all(np.hypot(x, y) <= 1e-9):  # mere headings
        return np.tile(TOOL_DOWN, (len(quaternion), 1))
    length = np.linalg.norm(quaternion, axis=1)
    other = ~(np.abs(length - 1.0) < 1e-3)
    if other.any():
        raise ValueError(f"the orientation of pose {int(np.argmax(other)) + 1} does not have length 1")
    up = w**2 + z**2 - x**2 - y**2 > 0.0  # z component of the z axis
    if up.any():
        raise ValueError(
            f"at pose {int(np.argmax(up)) + 1} the z axis of tcp, along the spindle away from "
            "the flange, points out of the part"
        )
    return quaternion / length[:, None]


def _timed(record: TrajectoryRecord) -> TimedPath:
    """Return a trajectory as a tool path: a block from knot to knot, curved as the velocities at its ends require."""
    _expect_frame(record.frame_id)
    if record.names not in ((TOOL,), (OLD_TOOL,)):
        raise ValueError(f"is a trajectory of {', '.join(record.names) or 'nothing'}, not of {TOOL}")
    chosen, velocity = _moving(record.position[:, 0]), record.velocity[:, 0, :3]
    none = np.isnan(velocity).all()
    run = Trajectory(record.time, record.position[:, 0], record.quaternion[:, 0], None if none else velocity)
    length = np.linalg.norm(np.diff(run.position, axis=0), axis=1)
    feed = np.append(0.0, length / np.diff(run.time_ns) * 1e9)
    bend = np.append(0.0, np.zeros(length.size) if run.velocity is None else _bends(run, run.velocity))
    path = _blocks(chosen, run.position, run.quaternion, feed, bend)
    ends = np.cumsum(path.block_length)[np.cumsum(chosen) - 1]
    return TimedPath(path, run, path.block_at(ends), ends, timed_by_source=True)


def _bends(run: Trajectory, velocity: np.ndarray) -> np.ndarray:
    """Curvature [1/m] in the xy plane, (n - 1,), of the arc that turns as the velocity from knot to knot."""
    plane = velocity[:, :2]
    cross = plane[:-1, 0] * plane[1:, 1] - plane[:-1, 1] * plane[1:, 0]
    turn = np.arctan2(cross, np.sum(plane[:-1] * plane[1:], axis=1))
    chord = np.hypot(*np.diff(run.position[:, :2], axis=0).T)
    sharp = (np.abs(turn) > np.pi / 2) | (chord == 0)  # a corner or a stop
    return np.where(sharp, 0.0, 2 * np.sin(turn / 2) / np.where(chord > 0, chord, 1.0))


def _blocks(
    chosen: np.ndarray, position: np.ndarray, quaternion: np.ndarray, feed: np.ndarray, bend: np.ndarray
) -> Toolpath:
    """Return the blocks between chosen points; feed [m/s] and curvature [1/m] are those up to each point."""
    none = np.zeros(np.count_nonzero(chosen))
    return Toolpath(
        position=position[chosen],
        feed=feed[chosen],
        rapid=none,
        line=none,
        feature=none,
        features=("",),
        curvature=bend[chosen],
        spindle_speed=none,
        quaternion=quaternion[chosen],
    )


def _expect_frame(*frames: str) -> None:
    other = [frame for frame in frames if frame != WORKPIECE]
    if other:
        raise ValueError(f"the frame is {other[0][:40]!r}, but must be {WORKPIECE}")


def _moving(position: np.ndarray) -> np.ndarray:
    """Mark the first point and each point that differs from the point before, (n, 3) -> (n,)."""
    far = ~(np.abs(position).max(axis=1, initial=0.0) <= REACH)  # NaN is far
    if far.any():
        raise ValueError(f"point {int(np.argmax(far)) + 1} is more than {REACH:g} m away or not a number; wrong unit?")
    chosen = np.any(np.diff(position, axis=0, prepend=np.inf) != 0, axis=1)
    if np.count_nonzero(chosen) < 2:
        raise ValueError("the path never moves")
    return chosen
