"""Every series of every pass as CSV, and the reference trajectories."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from kr270_milling.base.files import write_files
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.jobs import ScoredPass
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.path.trajectory_csv import write_csv
from kr270_milling.physics.motion.milling_pass import PassResult
from kr270_milling.physics.motion.scores import path_deviation

#: the unit is in the name: s, mm, um, deg, N; times have nine decimals. pose_correction: of the predicted tool pose
COLUMNS = (
    "time_s",
    *(f"{kind}_{axis}_mm" for kind in ("target", "reference", "tool", "actual") for axis in "xyz"),
    *(f"deflection_{axis}_um" for axis in "xyz"),
    *(f"deflection_r{axis}_deg" for axis in "xyz"),
    *(f"force_{axis}_n" for axis in "xyz"),
    *(f"moment_{axis}_n_m" for axis in "xyz"),
    "path_deviation_um",
    "pose_correction_um",
)


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
    place.mkdir(parents=True, exist_ok=True)
    series, references = [], []
    for stem, scored in zip(file_names([p.name for p in passes]), passes, strict=True):
        series.append(place / f"{stem}.csv")
        write_files({series[-1]: series_lines(scored.result, target)})
        references.append(place / f"{stem}_reference.csv")
        write_csv(references[-1], scored.reference, arm.joints(scored.reference))
    return series + references


def series_rows(result: PassResult, target: Trajectory) -> np.ndarray:
    """The columns behind the time, (n, 28)."""
    return np.column_stack(
        [
            1e3 * result.target,
            1e3 * result.reference,
            1e3 * result.tool,
            1e3 * result.actual,
            1e6 * result.deflection[:, :3],
            np.degrees(result.deflection[:, 3:]),
            result.wrench,
            1e6 * deviation_of(result, target),
            1e6 * result.correction,
        ]
    )


def series_lines(result: PassResult, target: Trajectory) -> Iterator[str]:
    """The lines of the CSV file of a pass: thirteen digits of every number."""
    yield ",".join(COLUMNS) + "\n"
    line = ",".join(["%.9f", *["%.13g"] * (len(COLUMNS) - 1)]) + "\n"
    for row in np.column_stack([result.time, series_rows(result, target)]).tolist():
        yield line % tuple(row)
