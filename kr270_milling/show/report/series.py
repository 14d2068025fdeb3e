"""Every series of every pass as CSV, and the reference trajectories."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from kr270_milling.base.files import write_files
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.path.trajectory import Trajectory, write_csv
from kr270_milling.physics.motion.milling_pass import PassResult
from kr270_milling.physics.motion.scores import path_deviation


def deviation_of(result: PassResult, target: Trajectory) -> np.ndarray:
    """Path deviation of a pass [m], (n,), perpendicular to the feed of the target."""
    return path_deviation(result.actual, result.target, target.sample_velocity(result.time_ns))


def file_names(names: Sequence[str]) -> list[str]:
    """Return a harmless and different file name stem for each pass name."""
    stems: list[str] = []
    for name in names:
        stem = unique = re.sub(r"[^A-Za-z0-9-]+", "_", name)[:60].strip("_") or "pass"
        number = 2
        while unique.lower() in (s.lower() for s in stems):
            unique, number = f"{stem}_{number}", number + 1
        stems.append(unique)
    return stems


def write_series(directory, arm: PlacedArm, target: Trajectory, passes: Sequence[ScoredPass]) -> list[Path]:
    """Write ``<pass>.csv`` (every series) and ``<pass>_reference.csv`` (its knots, with joint angles) of each pass.

    target: the programmed trajectory.

    Returns the paths, first those of the series. Each file appears whole or not at all.
    """
    place = Path(directory)
    series, references = [], []
    for stem, scored in zip(file_names([p.name for p in passes]), passes, strict=True):
        series.append(place / f"{stem}.csv")
        write_files({series[-1]: series_lines(scored.result, target)})
        references.append(place / f"{stem}_reference.csv")
        write_csv(references[-1], scored.reference, arm.joints(scored.reference))
    return series + references


def series_columns(result: PassResult, target: Trajectory) -> dict[str, np.ndarray]:
    """Return every series of a pass, (n,), by its name, which ends in the unit.

    pose_correction: of the predicted tool pose.
    """
    vectors = {
        "target_{}_mm": 1e3 * result.target,
        "reference_{}_mm": 1e3 * result.reference,
        "tool_{}_mm": 1e3 * result.tool,
        "actual_{}_mm": 1e3 * result.actual,
        "deflection_{}_um": 1e6 * result.deflection[:, :3],
        "deflection_r{}_deg": np.degrees(result.deflection[:, 3:]),
        "force_{}_n": result.wrench[:, :3],
        "moment_{}_n_m": result.wrench[:, 3:],
    }
    series = {"time_s": result.time}
    for name, rows in vectors.items():
        series |= {name.format(axis): column for axis, column in zip("xyz", rows.T, strict=True)}
    deviation, correction = 1e6 * deviation_of(result, target), 1e6 * result.correction
    return {**series, "path_deviation_um": deviation, "pose_correction_um": correction}


def series_lines(result: PassResult, target: Trajectory) -> Iterator[str]:
    """The lines of the CSV file of a pass: nine decimals of the time, thirteen digits of every other number."""
    series = series_columns(result, target)
    yield ",".join(series) + "\n"
    line = ",".join(["%.9f", *["%.13g"] * (len(series) - 1)]) + "\n"
    for row in np.column_stack(list(series.values())).tolist():
        yield line % tuple(row)
