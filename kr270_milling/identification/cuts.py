"""Cuts whose mean forces were measured: a table of feeds, depths and widths, forces in it or in recordings.

Forces of a recording are tared in an idle stretch and turned into workpiece axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.base.frames import rotation_from_abc
from kr270_milling.base.table import Table, read_table
from kr270_milling.cutting.tool import Tool
from kr270_milling.identification.signals import read_topic
from kr270_milling.robot.loads import GRAVITY

__all__ = ["COLUMNS", "Cuts", "Sensor", "engagement", "force_series", "mean_force", "read_cuts", "turn_of"]

MODES = ("slot", "up", "down")
FORCES = ("fx_n", "fy_n", "fz_n")
CUT = ("feed_per_tooth_mm", "depth_mm", "width_mm")
RECORDED = ("recording", "start_s", "stop_s", "tare_start_s", "tare_stop_s")
COLUMNS = (*CUT, "mode", *FORCES, "sigma_n", *RECORDED, "note")


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


@dataclass(frozen=True, eq=False)
class Cuts:
    """n cuts with one tool at constant feed; forces are means over whole revolutions."""

    tool: Tool
    feed_per_tooth: np.ndarray  #: [m], (n,)
    depth: np.ndarray  #: [m], (n,)
    entry: np.ndarray  #: angle of a tooth where its chip begins [rad], (n,), from the feed, in the sense of rotation
    exit: np.ndarray  #: and where it ends [rad], (n,)
    force: np.ndarray  #: on the tool, workpiece axes with x along the feed [N], (n, 3); NaN: not measured
    sigma: np.ndarray  #: standard deviation of each component [N], (n,); relative ones if not ``sigma_known``
    sigma_known: bool

    def __len__(self) -> int:
        return len(self.depth)

    @property
    def feeds(self) -> int:
        """How many different feeds per tooth there are."""
        return len(np.unique(np.round(self.feed_per_tooth, 9)))


def engagement(mode: str, width: float, diameter: float) -> tuple[float, float]:
    """Entry and exit angle [rad] of a tooth, from the feed direction in the sense of rotation.

    The chip thickness is h = f_z cos(phi). Up-milling begins at phi = -90 deg with h = 0 and ends where the width is
    used up, sin(phi) = 2 width / diameter - 1; down-milling is its mirror image.
    """
    limit = float(np.arcsin(np.clip(2.0 * width / diameter - 1.0, -1.0, 1.0)))
    if mode == "slot":
        return -np.pi / 2, np.pi / 2
    return (-np.pi / 2, limit) if mode == "up" else (-limit, np.pi / 2)


def read_cuts(path, tool: Tool, sensor: Sensor | None = None) -> Cuts:
    """A CSV file of cuts, one a row; the columns are COLUMNS. Raises InputError.

    A row without forces names a recording (beside the file) and the seconds of the cut in it.
    """
    table = read_table(path, COLUMNS, (*CUT[:2], "mode"))
    feed, depth = (1e-3 * table.number(name) for name in CUT[:2])
    slots = np.array(table.texts("mode")) == "slot"
    width = 1e-3 * table.number("width_mm", np.nan)
    width = np.where(slots & np.isnan(width), tool.diameter, width)
    meant = (feed > 0.0) & (feed < 0.1) & (depth > 0.0) & (depth < 1.0)
    table.refuse(~meant, "feed per tooth and depth must be above 0 and in mm")
    angles = [_angles(table, row, float(width[row]), tool.diameter) for row in range(len(table))]
    force, sigma, known = _forces(table, sensor or Sensor(), tool.spindle_speed)
    entry, leave = np.array(angles).T
    return Cuts(tool, feed, depth, entry, leave, force, sigma, known)


def _angles(table: Table, row: int, width: float, diameter: float) -> tuple[float, float]:
    mode, line = table.texts("mode")[row], table.lines[row]
    if mode not in MODES:
        raise InputError(table.path, f"the mode is {mode[:20]!r}, but must be one of {', '.join(MODES)}", line)
    most = diameter * (1.0 + 1e-6)
    if not 0.0 < width <= most or (mode == "slot" and width < 0.99 * diameter):
        right = "the tool's diameter in a slot" if mode == "slot" else "above 0 and at most the tool's diameter"
        reason = f"the width is {1e3 * width:g} mm, but must be {right}, {1e3 * diameter:g} mm"
        raise InputError(table.path, reason, line)
    return engagement(mode, width, diameter)


def _forces(table: Table, sensor: Sensor, spindle_speed: float) -> tuple[np.ndarray, np.ndarray, bool]:
    """Forces (n, 3), their standard deviations (n,), and whether these are known in all rows."""
    force, sigma = table.numbers(FORCES, np.nan), table.number("sigma_n", np.nan)
    recordings = table.texts("recording") if "recording" in table else [""] * len(table)
    start, stop, tare, tared = (table.number(name, np.nan) for name in RECORDED[1:])
    for row, line in enumerate(table.lines):
        if recordings[row]:
            file = Path(table.path).parent / recordings[row]
            stretch = (tare[row], tared[row]) if np.isfinite([tare[row], tared[row]]).all() else None
            if not start[row] < stop[row]:
                raise InputError(table.path, "start_s must be before stop_s for a recording", line)
            force[row], own = mean_force(file, sensor, (start[row], stop[row]), spindle_speed, stretch)
            sigma[row] = own if np.isnan(sigma[row]) else sigma[row]
        elif not np.isfinite(force[row, :2]).all():
            raise InputError(table.path, "has neither fx_n and fy_n nor a recording", line)
    known = bool(np.isfinite(sigma).all())
    table.refuse(known & (sigma <= 0.0), "sigma_n must be above 0")
    return force, sigma if known else np.ones(len(table)), known


def force_series(path, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Seconds after the first message, (n,), and forces in workpiece axes as the sensor has them, (n, 3) [N]."""
    time, values = read_topic(path, sensor.topic, ("geometry_msgs/msg/WrenchStamped",))
    sign = -1.0 if sensor.on_part else 1.0
    return time - time[0], sign * values[:, :3] @ sensor.rotation.T


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
