"""A robot and a force sensor with their own clocks: wall-clock stamps, jitter, losses, an untared sensor."""

import numpy as np
from scipy.spatial.transform import Rotation

from kr270_milling.base.samples import PoseSample, WrenchSample

WALL = 1_700_000_000_123_456_789  # [ns]
PERIOD, JITTER, SENSOR = 4_000_000, 500_000, 1_000_000  # [ns]
LOST = 0.02  # share of the poses
STANDING = 300_000_000  # [ns] before and after the motion
DOWN = np.array([1.0, 0.0, 0.0, 0.0])
#: a sensor above a spindle of 25 kg, off the axis and turned; its offset [N, N m]
PLACED = ("sensor.frame=ft_sensor", "sensor.xyz_mm=[10, -20, 80]", "sensor.abc_deg=[30, 5, -3]", "sensor.mass_kg=25",
          "sensor.mass_centre_mm=[3, 5, 150]")  # fmt: skip
OFFSET = np.array([120.0, -35.0, 60.0, 4.0, -2.0, 1.5])


def readings(cell, wrench: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Return what the sensor of a cell reads, (n, 6), for wrenches at the tip in workpiece axes (n, 6)."""
    place, mount = cell.sensor, cell.mount
    tip = Rotation.from_quat(quaternion)
    flange = tip * Rotation.from_euler("ZYX", mount.abc).inv()
    tool0 = flange * Rotation.from_euler("Y", 90, degrees=True)
    axes = tool0 * Rotation.from_euler("ZYX", place.abc)
    lever = tool0.apply(place.xyz.copy()) - flange.apply(mount.xyz.copy())  # from the tip to the sensor, workpiece axes
    down = Rotation.from_euler("ZYX", cell.workpiece.abc).inv().apply([0.0, 0.0, -9.80665 * place.mass])
    weight = np.concatenate([axes.inv().apply(down), np.cross(place.mass_centre, axes.inv().apply(down))])
    moment = wrench[:, 3:] - np.cross(lever, wrench[:, :3])
    return np.column_stack([axes.inv().apply(wrench[:, :3]), axes.inv().apply(moment)]) + weight + OFFSET


def foreign_pass(result, number: int, noise: float = 0.0, cell=None, start: int = 0) -> list[PoseSample | WrenchSample]:
    """Return the messages of a simulated pass as this cell publishes them, by stamp; noise [m]: of the poses.

    cell: with an untared sensor; without, the wrenches are in the workpiece frame. start: stamp of the pass [ns].
    """
    random = np.random.default_rng(number)
    end, start = int(result.time_ns[-1]) + STANDING, start or WALL + number * 10**10
    posed = np.arange(-STANDING, end, PERIOD)
    posed = (posed + random.integers(-JITTER, JITTER, posed.size))[random.random(posed.size) > LOST]
    place = np.column_stack([np.interp(posed, result.time_ns, axis) for axis in result.tool.T])
    place += random.normal(0.0, noise, place.shape)
    sensed = np.arange(-STANDING, end, SENSOR)
    force = np.column_stack([np.interp(sensed, result.time_ns, a, left=0.0, right=0.0) for a in result.wrench.T])
    frame = "workpiece" if cell is None else cell.sensor.frame
    force = force if cell is None else readings(cell, force, DOWN)
    poses = [PoseSample(start + ns, "workpiece", row, DOWN) for ns, row in zip(posed.tolist(), place, strict=True)]
    wrenches = [WrenchSample(start + ns, frame, row) for ns, row in zip(sensed.tolist(), force, strict=True)]
    return sorted([*poses, *wrenches], key=lambda sample: sample.stamp)
