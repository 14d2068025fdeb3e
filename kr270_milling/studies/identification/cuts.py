"""Cuts whose mean forces were measured: a table of feeds, depths and widths, forces in it or in recordings.

Forces of a recording are tared in an idle stretch and turned into workpiece axes.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.base.frames import rotation_from_abc
from kr270_milling.base.table import Table, read_table
from kr270_milling.physics.cutting.tool import Tool
from kr270_milling.physics.robot.loads import GRAVITY
from kr270_milling.studies.identification.signals import read_topic

FORCES = ("fx_n", "fy_n", "fz_n")
CUT = ("feed_per_tooth_mm", "depth_mm", "width_mm")
RECORDED = ("recording", "start_s", "stop_s", "tare_start_s", "tare_stop_s")
COLUMNS = (*CUT, "mode", *FORCES, "sigma_n", *RECORDED, "note")


@dataclass(frozen=True, eq=False)
class Sensor:
    """Place of a force sensor, and its reading without a cut."""

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
class CutMeasurements:
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

    def take(self, rows) -> CutMeasurements:
        """Some of the cuts."""
        arrays = ("feed_per_tooth", "depth", "entry", "exit", "force", "sigma")
        return dataclasses.replace(self, **{name: getattr(self, name)[rows] for name in arrays})

    @property
    def feeds(self) -> int:
        """Number of different feeds per tooth."""
        return len(np.unique(np.round(self.feed_per_tooth, 9)))


def engagement_angles(mode, width, diameter: float) -> tuple[np.ndarray, np.ndarray]:
    """Entry and exit angles [rad], (n,), of a tooth, from the feed direction in the sense of rotation.

    The chip thickness is h = f_z cos(phi). Up-milling begins at phi = -90 deg with h = 0 and ends where the width is
    used up, sin(phi) = 2 width / diameter - 1; down-milling is its mirror image.

    mode: slot, up or down, (n,); width: (n,).
    """
    mode, limit = np.asarray(mode), np.arcsin(np.clip(2.0 * width / diameter - 1.0, -1.0, 1.0))
    return np.where(mode == "down", -limit, -np.pi / 2), np.where(mode == "up", limit, np.pi / 2)


def read_cuts(path, tool: Tool, sensor: Sensor) -> CutMeasurements:
    """A CSV file of cuts, one a row; the columns are COLUMNS. Raises InputError.

    A row without forces names a recording (beside the file) and the seconds of the cut in it.
    """
    table = read_table(path, COLUMNS, (*CUT[:2], "mode"))
    feed, depth = (1e-3 * table.number(name) for name in CUT[:2])
    meant = (feed > 0.0) & (feed < 0.1) & (depth > 0.0) & (depth < 1.0)
    table.refuse(~meant, "feed per tooth and depth must be above 0 and in mm")
    mode, width = np.array(table.texts("mode")), 1e-3 * table.number("width_mm", np.nan)
    slot = mode == "slot"
    width = np.where(slot & np.isnan(width), tool.diameter, width)
    directions = ("slot", "up", "down")
    table.refuse(~np.isin(mode, directions), f"the mode must be one of {', '.join(directions)}")
    most = f"at most the tool's diameter, {1e3 * tool.diameter:g} mm"
    table.refuse(~((width > 0.0) & (width <= tool.diameter * (1.0 + 1e-6))), f"the width must be above 0 and {most}")
    table.refuse(slot & (width < 0.99 * tool.diameter), "the width must be the tool's diameter in a slot")
    force, sigma = _forces(table, sensor, tool.spindle_speed)
    known = bool(np.isfinite(sigma).all())
    table.refuse(known & (sigma <= 0.0), "sigma_n must be above 0")
    angles = engagement_angles(mode, width, tool.diameter)
    return CutMeasurements(tool, feed, depth, *angles, force, sigma if known else np.ones(len(table)), known)


def _forces(table: Table, sensor: Sensor, spindle_speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Forces (n, 3) and their standard deviations (n,), of the table or else of the recordings that it names."""
    force, sigma = table.numbers(FORCES, np.nan), table.number("sigma_n", np.nan)
    recordings = np.array(table.texts("recording") if "recording" in table else [""] * len(table))
    start, stop, tare, tared = (table.number(name, np.nan) for name in RECORDED[1:])
    table.refuse((recordings == "") & ~np.isfinite(force[:, :2]).all(1), "has neither fx_n and fy_n nor a recording")
    table.refuse((recordings != "") & ~(start < stop), "start_s must be before stop_s for a recording")
    for row in np.flatnonzero(recordings != ""):
        idle = (tare[row], tared[row]) if np.isfinite(tare[row] + tared[row]) else sensor.tare
        file, window = Path(table.path).parent / recordings[row], (start[row], stop[row])
        force[row], own = recorded_mean_force(file, dataclasses.replace(sensor, tare=idle), window, spindle_speed)
        sigma[row] = own if np.isnan(sigma[row]) else sigma[row]
    return force, sigma


def force_series(path, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Seconds after the first message, (n,), and forces in workpiece axes as the sensor has them, (n, 3) [N]."""
    time, values = read_topic(path, sensor.topic, ("geometry_msgs/msg/WrenchStamped",))
    sign = -1.0 if sensor.on_part else 1.0
    return time - time[0], sign * values[:, :3] @ sensor.rotation.T


def recorded_mean_force(
    path, sensor: Sensor, window: tuple[float, float], spindle_speed: float
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
    return each.mean(0) - _idle(path, sensor, time, force), float(max(spread, 1e-6))


def _idle(path, sensor: Sensor, time, force) -> np.ndarray:
    """Reading of the sensor without a cut, (3,) [N]."""
    if sensor.tare is None:
        return sensor.mass * GRAVITY * sensor.down * (-1.0 if sensor.on_part else 1.0)
    start, stop = sensor.tare
    idle = (time >= start) & (time < stop)
    if not idle.any():
        raise RecordingError(path, f"has no message in the idle stretch {start:g} to {stop:g} s")
    return force[idle].mean(0)
