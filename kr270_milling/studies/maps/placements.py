"""Placements of the part in front of the arm: reach, limits, singularities and predicted static error along a path.

A row is one placement of the workpiece (x, y, z, turn about z), one turn of the tool about its axis and one branch of
the arm. With J(q) the Jacobian of the tool point and c the joint compliances (that of joint 2 with the gravity
compensator's share), the point deflects by C F = J diag(c) J^T F under the cutting force F of each place on the path;
the error is the part of it across the feed. Link weights, which change C by less than 1 %, are left out. The
compensation takes the error away as far as compliances and force coefficients are known: what is left is the error
times sqrt(s_k^2 + s_F^2), one standard deviation of ``uncertainty``.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kr270_milling.base.column import column, columns
from kr270_milling.base.errors import ParameterError
from kr270_milling.base.frames import Pose, abc_from_rotation, rotation_from_abc, rotation_from_quaternion
from kr270_milling.base.parameter_file import merge, override, shipped_directories, write_include
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.cell.paths import CellPath
from kr270_milling.cell.sections import Workpiece
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.motion.milling_pass import PassResult
from kr270_milling.physics.robot import cartesian_mass, jacobian
from kr270_milling.physics.robot.inverse import branches
from kr270_milling.physics.robot.mass import mode_frequencies
from kr270_milling.studies.maps.engine import StudyRows
from kr270_milling.studies.maps.postures import along_path, postures, whole_turns

MOST = 10_000_000  #: placements of a map
BLOCK = 1000  #: placements at a time, some 20 MB of postures
MARGIN = np.radians(0.5)  #: to the joint limits, for what is between the places
DEGREES = 180.0 / math.pi


@dataclass(frozen=True)
class PlacementRow:
    """The shown columns of one row of a map; ``Summary`` maps the columns with a title over x and y."""

    x: float = column("x_mm", 1e3, unit="mm", short="x")
    y: float = column("y_mm", 1e3, unit="mm", short="y")
    z: float = column("z_mm", 1e3, unit="mm", short="z")
    turn: float = column("turn_deg", DEGREES, unit="deg", short="part turn")
    tool_turn: float = column("tool_turn_deg", DEGREES, unit="deg", short="tool turn")
    branch: int = column("branch", digits=0, short="branch")
    error: float = column("error_max_um", 1e6, "error before compensation", "um", digits=2, short="error")
    compensated: float = column(
        "compensated_max_um", 1e6, "error after compensation, one sigma", "um", digits=2, short="compensated"
    )
    lowest_mode: float = column("lowest_mode_hz", 1.0, "lowest mode", "Hz", digits=2, short="lowest mode")
    singularity: float = column("singularity", 1.0, "distance to a singularity", digits=4, short="singularity")


PLACE = {c.key: c.factor for c in columns(PlacementRow)[:5]}
MAPPED = {c.key: c.heading() for c in columns(PlacementRow) if c.title}


@dataclass(frozen=True, eq=False)
class PathPlaces:
    """m places on the path of a cell, workpiece frame."""

    position: np.ndarray  #: position of the tool tip [m], (m, 3)
    rotation: np.ndarray  #: rotation of tcp, (m, 3, 3)
    feed: np.ndarray  #: unit vectors, (m, 3)
    force: np.ndarray  #: mean cutting force on the tool [N], (m, 3)


def grid_axes(workpiece: Workpiece, values: Sequence) -> tuple[np.ndarray, ...]:
    """Return the axes of ``Placements``: x, y, z [m], turn [rad] of the workpiece, turn of the tool [rad].

    values: values of each axis in mm and deg; None: where the workpiece of the cell is, not turned. Raises
    ParameterError for more than 10 million placements.
    """
    here = (*workpiece.xyz, 0.0, 0.0)
    scales = (1e-3, 1e-3, 1e-3, 1.0 / DEGREES, 1.0 / DEGREES)
    axes = tuple(
        np.array([value]) if axis is None else scale * np.asarray(axis, float).reshape(-1)
        for axis, value, scale in zip(values, here, scales, strict=True)
    )
    count = math.prod(len(axis) for axis in axes)
    if not 0 < count <= MOST:
        raise ParameterError("map", count, f"1 to {MOST} placements in all")
    return axes


def path_places(path: CellPath, result: PassResult) -> PathPlaces:
    """Places where the tool cuts in a pass along a path, and others over the whole path for its reach and limits."""
    cutting = np.flatnonzero(result.volume > 0.0)
    most_places = 24  # along the path at which the error of each placement is looked at
    chosen = cutting[np.linspace(0, len(cutting) - 1, most_places).astype(int)]
    quiet_places = 12  # over the whole path, approach and all, for reach and limits
    rest = np.setdiff1d(np.linspace(0, len(result.volume) - 1, quiet_places).astype(int), chosen)
    both = np.union1d(chosen, rest)
    places = places_at(path, result, both)
    places.force[np.isin(both, rest)] = 0.0
    return places


def places_at(path: CellPath, result: PassResult, chosen: np.ndarray) -> PathPlaces:
    """The exchange periods ``chosen`` (m,) of a pass, with the mean force of the revolution there.

    The feed of a resting tool is 0.
    """
    time_ns, target = result.time_ns[chosen], path.target
    feed = target.sample_velocity(time_ns)
    feed = feed / np.maximum(np.linalg.norm(feed, axis=1, keepdims=True), 1e-12)
    window = max(1, round(2.0 * math.pi / path.tool.spindle_speed / path.exchange.period))  # a revolution
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(result.wrench[:, :3], axis=0)])
    first = np.maximum(chosen + 1 - window, 0)
    mean = (total[chosen + 1] - total[first]) / (chosen + 1 - first)[:, None]
    return PathPlaces(target.sample(time_ns), rotation_from_quaternion(target.sample_orientation(time_ns)), feed, mean)


@dataclass(frozen=True, eq=False)
class Placements(StudyRows):
    """A grid of placements, each with 8 rows, one a branch."""

    arm: PlacedArm
    left: float  #: share of an error that compensation leaves, one standard deviation of the models
    places: PathPlaces
    axes: tuple[np.ndarray, ...]  #: x, y, z [m], turn [rad] of the workpiece; turn of the tool about its axis [rad]
    chunk: int = 500  #: placements a file, 8 rows each
    base: Pose = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "base", self.arm.place)

    def __len__(self) -> int:
        return math.prod(len(axis) for axis in self.axes)

    def placements(self, first: int, last: int) -> np.ndarray:
        """x, y, z [m], turn [rad], turn of the tool [rad] of the numbers first to last, (n, 5)."""
        places = np.unravel_index(np.arange(first, last), [len(axis) for axis in self.axes])
        return np.column_stack([axis[i] for axis, i in zip(self.axes, places, strict=True)])

    def columns(self, first: int, last: int) -> dict[str, np.ndarray]:
        chosen = self.placements(first, last)
        parts = [self.rows(part) for part in np.array_split(chosen, -(-len(chosen) // BLOCK))]
        places = np.repeat(chosen * list(PLACE.values()), 8, axis=0).T
        return {
            **dict(zip(PLACE, places, strict=True)),
            "branch": np.tile(np.arange(8), len(chosen)),
            **{name: np.concatenate([part[name] for part in parts]).ravel() for name in parts[0]},
        }

    def rows(self, chosen: np.ndarray) -> dict[str, np.ndarray]:
        """Return the measures of placements (n, 5), each (n, 8): one a branch."""
        placed, places = self.arm, self.places
        turn, tool_turn = about_z(chosen[:, 3]), about_z(chosen[:, 4])
        frame = turn @ self.base.rotation  # workpiece axes in base axes, (n, 3, 3)
        back = np.swapaxes(frame, -1, -2)
        position = chosen[:, None, :3] + places.position @ back
        rotation = frame[:, None] @ places.rotation @ tool_turn[:, None]
        force, feed = places.force @ back, places.feed @ back
        n, m = position.shape[:2]
        place = Pose(position.reshape(-1, 3), rotation.reshape(-1, 3, 3))
        q, deflection = postures(placed.arm, placed.mount, place, force.reshape(-1, 3), placed.dynamics.gravity)
        q, deflection = q.reshape(n, m, 8, 6), deflection.reshape(n, m, 8, 3)
        if tip := placed.tool.lateral_compliance:
            axis = rotation[..., 2]
            lateral = force - np.sum(force * axis, axis=-1, keepdims=True) * axis
            deflection = deflection + tip * lateral[:, :, None]
        size = np.linalg.norm(force, axis=-1)
        within, measures = along_path(placed.arm, q, deflection, feed, size, MARGIN)
        singular, soft, largest, mean = np.moveaxis(measures, -1, 0)
        least_measure = 1e-6  # measure of a posture below which no Jacobian is inverted
        reachable, feasible = np.isfinite(singular), within & (singular > least_measure)
        return {
            "feasible": feasible,
            "reachable": reachable,
            "within_limits": within,
            "singularity": singular,
            "lowest_mode_hz": self.lowest_mode(q[:, m // 2], feasible),
            "compliance_um_per_n": 1e6 * soft,
            "error_max_um": 1e6 * largest,
            "error_mean_um": 1e6 * mean,
            "compensated_max_um": 1e6 * self.left * largest,
            "compensated_mean_um": 1e6 * self.left * mean,
        }

    def lowest_mode(self, q: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Frequency [Hz], (n, 8), of the chosen postures q (n, 8, 6), NaN elsewhere; A5 may have either sign."""
        placed, frequency = self.arm, np.full(q.shape[:2], np.nan)
        arm, mount, measured = placed.arm, placed.mount, placed.dynamics.modes.frequency
        if measured.size:
            frequency[chosen] = measured.min()
            return frequency
        some = chosen[:, ::2] | chosen[:, 1::2]
        if not some.any():
            return frequency
        posture = q[:, ::2][some]  # chosen or not, it is regular: the measures do not see the sign of A5
        turned = jacobian(arm, mount, arm.on_base(posture))
        soft = np.tile(arm.spring_compliance, (len(posture), 1))
        if placed.dynamics.gravity:
            slope = arm.compensator.moment_slope(np.cos(posture[:, 1]), np.sin(posture[:, 1]))
            soft[:, -5] /= 1.0 - soft[:, -5] * slope
        mass = cartesian_mass(arm, mount, posture, placed.dynamics.mass_model)
        lowest = mode_frequencies((turned * soft[:, None]) @ np.swapaxes(turned, -1, -2), mass)[..., 0]
        frequency[:, ::2][some] = lowest
        frequency[:, 1::2][some] = lowest
        return np.where(chosen, frequency, np.nan)


def present_row(grid: Placements, target: Trajectory) -> dict[str, float]:
    """The row of the workpiece where the arm of a grid has it, on the branch of the commanded joints."""
    placed, stamp = grid.arm, np.zeros(1, np.int64)
    here = tuple(np.array([value]) for value in (*placed.place.position.tolist(), 0.0, 0.0))
    rotation = rotation_from_quaternion(target.sample_orientation(stamp))
    joints = placed.joints_along(target, stamp)
    q, _ = branches(placed.arm, placed.mount, placed.place @ Pose(target.sample(stamp), rotation), joints)
    away = np.abs(np.exp(1j * q[0]) - np.exp(1j * joints)).max(axis=-1)
    branch = int(np.nanargmin(away))
    rows = dataclasses.replace(grid, axes=here).columns(0, 1)
    return {name: values[branch].item() for name, values in rows.items()}


def about_z(angle) -> np.ndarray:
    """Turns about z by angles (...) [rad], (..., 3, 3)."""
    return rotation_from_abc(np.asarray(angle)[..., None] * [1.0, 0.0, 0.0])


def moved_cell(placed: PlacedArm, places: PathPlaces, row: dict, posture_key: str) -> dict:
    """Sections of a parameter file for a placement: workpiece, mount, posture; lengths in mm, angles in deg."""
    arm = placed.arm
    origin = np.array([row["x_mm"], row["y_mm"], row["z_mm"]]) * 1e-3
    frame = Pose(origin, about_z(np.radians(row["turn_deg"])) @ placed.place.rotation)
    tool_turn = about_z(np.radians(row["tool_turn_deg"]))
    mount = Pose(placed.mount.pose.position, placed.mount.pose.rotation @ tool_turn.T)
    middle = len(places.position) // 2
    place = frame @ Pose(places.position[middle], places.rotation[middle] @ tool_turn)
    q, _ = branches(arm, placed.mount, place, (arm.joint_lower + arm.joint_upper) / 2)
    hint = q[int(row["branch"])][None]
    whole_turns(hint, arm.joint_lower, arm.joint_upper)
    return {
        "workpiece": place_of(frame, placed.workpiece.at_start_joints),
        "mount": {"abc_deg": _abc(mount)},
        posture_key: _listed(np.degrees(hint[0])),
    }


def place_of(frame: Pose, at_start_joints: bool) -> dict:
    """The section ``workpiece`` for a workpiece frame on base_link; at_start_joints: of the cell before."""
    place = {"xyz_mm": _listed(1e3 * frame.position), "abc_deg": _abc(frame)}
    return place | {"at_start_joints": False} if at_start_joints else place


def _abc(pose: Pose) -> list[float]:
    return _listed(np.degrees(abc_from_rotation(pose.rotation)))


def _listed(values: np.ndarray) -> list[float]:
    return [float(f"{v:.9f}") + 0.0 for v in values.tolist()]


class Summary:
    """Summary of all rows, read chunk by chunk so that memory does not grow with the rows."""

    def __init__(self, x: np.ndarray, y: np.ndarray, count: int):
        self.x, self.y, self.count = np.unique(1e3 * x), np.unique(1e3 * y), count
        self.rows = self.feasible = 0
        self.best: list[dict] = []  #: the placements of the smallest largest error, the best branch of each
        #: values of the row with the least error at each x and y, (y, x)
        self.maps = {name: np.full((len(self.y), len(self.x)), np.nan) for name in MAPPED}

    def add(self, table) -> None:
        """Add a chunk, an Arrow table."""
        usable = table.filter(table["feasible"]).sort_by("error_max_um")
        for row in usable.slice(0, 8 * self.count).to_pylist():
            self._enter(row)
        # the least error of a place is entered last, and stays
        column = {name: usable[name].to_numpy()[::-1] for name in ("x_mm", "y_mm", *MAPPED)}
        x, y = np.searchsorted(self.x, column["x_mm"]), np.searchsorted(self.y, column["y_mm"])
        lower = ~(self.maps["error_max_um"][y, x] <= column["error_max_um"])
        for name, shown in self.maps.items():
            shown[y[lower], x[lower]] = column[name][lower]
        self.rows, self.feasible = self.rows + table.num_rows, self.feasible + usable.num_rows

    def _enter(self, row: dict) -> None:
        names = ("x_mm", "y_mm", "z_mm", "turn_deg")
        rivals = [best for best in self.best if all(best[name] == row[name] for name in names)]
        if rivals and rivals[0]["error_max_um"] <= row["error_max_um"]:
            return
        others = [best for best in self.best if best not in rivals]
        self.best = sorted([*others, row], key=lambda best: best["error_max_um"])[: self.count]


def write_cells(folder, source: Path, settings, grid: Placements, rows: list[dict], posture_key: str) -> list[Path]:
    """A parameter file for each row, which includes ``source`` and moves workpiece, mount and posture."""
    written = []
    for number, row in enumerate(rows, 1):
        note = (f"Placement {number} of the map: largest static error across the feed {row['error_max_um']:.1f} um "
                f"before, {row['compensated_max_um']:.1f} um after compensation (predicted, one sigma)")  # fmt: skip
        written.append(Path(folder) / f"best_{number}.yaml")
        write_placement(written[-1], source, settings, moved_cell(grid.arm, grid.places, row, posture_key), note)
    return written


def write_placement(path: Path, source: Path, settings, changes: dict, note: str) -> None:
    """A parameter file that includes ``source``, with the ``key=value`` texts of the command line and the changes.

    changes: as of ``moved_cell``.
    """
    sections = merge(override({}, settings)[0], changes)
    write_include(path, {"includes": [_included(source, path.parent)], **sections}, [note], digits=12)


def _included(source: Path, folder: Path) -> str:
    """A shipped file by its name, any other as seen from the folder of the new file."""
    if any(source.parent.samefile(place) for place in shipped_directories()):
        return source.name
    return os.path.relpath(source, folder.resolve())
