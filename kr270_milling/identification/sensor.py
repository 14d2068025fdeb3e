"""Mean forces out of the recording of a force sensor: tared in an idle stretch, turned into workpiece axes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kr270_milling.bag.reader import Recording
from kr270_milling.base.errors import RecordingError
from kr270_milling.base.frames import rotation_from_abc
from kr270_milling.messages.series import series
from kr270_milling.robot.loads import GRAVITY

__all__ = ["Sensor", "force_series", "mean_force", "pose_series", "read_topic", "turn_of"]

WRENCH = "geometry_msgs/msg/WrenchStamped"
POSE = "geometry_msgs/msg/PoseStamped"


@dataclass(frozen=True, eq=False)
class Sensor:
    """Where a force sensor sits and what it reads without a cut."""

    topic: str = "wrench"  #: full name, or its last part where only one topic ends so
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))  #: sensor axes -> workpiece axes
    on_part: bool = False  #: under the part it feels the opposite of what the tool feels
    tare: tuple[float, float] | None = None  #: [s] of an idle stretch, after the first message
    mass: float = 0.0  #: [kg] that hangs on the sensor; its weight is taken off where there is no tare
    down: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))  #: workpiece axes


def turn_of(abc) -> np.ndarray:
    """Sensor axes -> workpiece axes from the angles A, B, C [deg] of a command line; None: they are the same."""
    return np.eye(3) if abc is None else rotation_from_abc(np.radians(abc))


def read_topic(path, name: str, kinds) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of the stamps (n,), ascending, and the numbers (n, columns) of a topic of one of these types.

    name: full, or the last part where only one topic ends so. Raises RecordingError.
    """
    with Recording(path) as recording:
        topics = recording.topics()
        found = [name] if name in topics else [topic for topic in topics if topic.rpartition("/")[2] == name]
        if len(found) != 1:
            what = f"has several topics {name} ({', '.join(found)})" if found else f"has no topic {name}"
            raise RecordingError(recording.path, f"{what}; it holds {', '.join(sorted(topics)) or 'nothing'}")
        if topics[found[0]].type not in kinds:
            what = f"{found[0]} is of type {topics[found[0]].type}, not {' or '.join(sorted(kinds))}"
            raise RecordingError(recording.path, what)
        read = series(recording, found[0])
    if len(read.stamp) < 2:
        raise RecordingError(path, f"{found[0]} has no two messages")
    stamp, first = np.unique(read.stamp, return_index=True)
    return stamp * 1e-9, read.values[first]


def force_series(path, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Seconds after the first message, (n,), and forces in workpiece axes as the sensor has them, (n, 3) [N]."""
    time, values = read_topic(path, sensor.topic, (WRENCH,))
    sign = -1.0 if sensor.on_part else 1.0
    return time - time[0], sign * values[:, :3] @ sensor.rotation.T


def pose_series(path, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of the stamps, (n,), and places [m], (n, 3)."""
    time, values = read_topic(path, topic, (POSE,))
    return time, values[:, :3]


def mean_force(
    path, sensor: Sensor, window: tuple[float, float], spindle_speed: float, tare: tuple[float, float] | None = None
) -> tuple[np.ndarray, float]:
    """Mean force on the tool over the whole revolutions of a window [s], (3,) [N], and its standard deviation [N].

    The deviation comes from the means of the single revolutions. Raises RecordingError.
    """
    time, force = force_series(path, sensor)
    turn = 2 * np.pi / spindle_speed
    turns = int(np.floor((window[1] - window[0]) / turn + 1e-6))
    inside = (time >= window[0]) & (time < window[0] + turns * turn)
    if turns < 2 or inside.sum() < 8 * turns or window[1] > time[-1] + turn:
        reason = f"{window[0]:g} to {window[1]:g} s holds {turns} revolutions and {int(inside.sum())} messages"
        raise RecordingError(path, f"{reason}; it lasts {time[-1]:.4g} s, and a mean needs 2 revolutions of 8 messages")
    number = ((time[inside] - window[0]) / turn).astype(int)
    each = np.stack([np.bincount(number, column) for column in force[inside].T], -1) / np.bincount(number)[:, None]
    spread = np.sqrt(np.mean(each.var(0, ddof=1)) / len(each))
    return each.mean(0) - _idle(path, sensor, time, force, tare or sensor.tare), float(max(spread, 1e-6))


def _idle(path, sensor: Sensor, time, force, stretch) -> np.ndarray:
    """What the sensor shows without a cut, (3,) [N]."""
    if stretch is None:
        return sensor.mass * GRAVITY * sensor.down * (-1.0 if sensor.on_part else 1.0)
    idle = (time >= stretch[0]) & (time < stretch[1])
    if not idle.any():
        raise RecordingError(path, f"has no message in the idle stretch {stretch[0]:g} to {stretch[1]:g} s")
    return force[idle].mean(0)
