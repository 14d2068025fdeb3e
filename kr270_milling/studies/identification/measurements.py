"""Load tests of an arm: a tracker measures how far a test load moves a reflector."""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.base.table import Table, read_table, write_table
from kr270_milling.physics.robot.arm import Arm, Mount
from kr270_milling.physics.robot.loads import GRAVITY

JOINTS = tuple(f"a{j}_deg" for j in range(1, 7))
WRENCH = ("fx_n", "fy_n", "fz_n", "mx_n_m", "my_n_m", "mz_n_m")
MASS = ("mass_kg", "mass_centre_x_mm", "mass_centre_y_mm", "mass_centre_z_mm")
SHIFT = ("dx_mm", "dy_mm", "dz_mm")
TILT = ("rx_mrad", "ry_mrad", "rz_mrad")
SIGMA = ("sigma_um", "sigma_mrad")
LOAD = ("load_x_mm", "load_y_mm", "load_z_mm")
REFLECTOR = ("reflector_x_mm", "reflector_y_mm", "reflector_z_mm")
COLUMNS = (*JOINTS, *WRENCH, *MASS, *LOAD, *REFLECTOR, *SHIFT, *TILT, *SIGMA, "note")


@dataclass(frozen=True, eq=False)
class Measurements:
    """n load tests. Base axes unless the name says otherwise; NaN: not measured."""

    q: np.ndarray  #: joint angles that the controller holds [rad], (n, 6)
    wrench: np.ndarray  #: test load, at ``application`` [N, N m], (n, 6)
    application: np.ndarray  #: where the load acts, flange frame [m], (n, 3)
    reflector: np.ndarray  #: flange frame [m], (n, 3)
    displacement: np.ndarray  #: translation and rotation vector of the reflector by the load [m, rad], (n, 6)
    sigma: np.ndarray  #: standard deviation of each of them [m, rad], (n, 6); relative ones if not ``sigma_known``
    sigma_known: bool

    def __len__(self) -> int:
        return len(self.q)

    def take(self, rows) -> Measurements:
        """Some of the rows."""
        arrays = ("q", "wrench", "application", "reflector", "displacement", "sigma")
        return dataclasses.replace(self, **{name: getattr(self, name)[rows] for name in arrays})


def unmeasured(q: np.ndarray, force: np.ndarray, point: np.ndarray, sigma: float) -> Measurements:
    """Tests without a result: forces [N], (n, 3), at a point (3,) of the flange [m], where the reflector is, too."""
    n = len(q)
    wrench, place = np.hstack([force, np.zeros((n, 3))]), np.tile(point, (n, 1))
    return Measurements(q, wrench, place, place, np.full((n, 6), np.nan), np.full((n, 6), sigma), True)


def read_measurements(path, arm: Arm, mount: Mount) -> Measurements:
    """A CSV file of load tests, one a row; the columns are COLUMNS. Raises InputError."""
    table = read_table(path, COLUMNS, (*JOINTS, *SHIFT))
    angles = table.numbers(JOINTS)
    if len(angles) > 1 and np.abs(angles).max() <= 2 * np.pi:
        raise InputError(table.path, "all joint angles are within +-6.28: radians in the columns of degrees?")
    q = np.radians(angles)
    inside = (q >= arm.joint_lower - 1e-9) & (q <= arm.joint_upper + 1e-9)
    table.refuse(~inside.all(1), "the posture is outside of the joint limits of the arm")
    wrench, application = _loads(table, mount)
    reflector = _point(table, REFLECTOR, mount.xyz)
    shift = 1e-3 * table.numbers(SHIFT)
    farthest = 0.2  # [m] that a load test moves a reflector at most; more is a wrong unit
    table.refuse(np.abs(shift).max(1) > farthest, f"a load moved the arm by more than {farthest} m")
    tilt = 1e-3 * table.numbers(TILT, np.nan)
    sigma, known = _sigma(table)
    return Measurements(q, wrench, application, reflector, np.hstack([shift, tilt]), sigma, known)


def _given(table: Table, names) -> np.ndarray:
    """(n,): rows that have any of the columns."""
    return np.isfinite(table.numbers(names, np.nan)).any(1)


def _point(table: Table, names, default: np.ndarray) -> np.ndarray:
    """[m], (n, 3), ``default`` in rows that have none of the columns."""
    return np.where(_given(table, names)[:, None], 1e-3 * table.numbers(names, 0.0), default)


def _loads(table: Table, mount: Mount) -> tuple[np.ndarray, np.ndarray]:
    """Wrench (n, 6), base axes, and the point where it acts (n, 3), flange frame; a mass hangs in its centre."""
    forced, weighed = _given(table, WRENCH), _given(table, MASS[:1])
    table.refuse(forced & weighed, "has both a wrench and a mass")
    table.refuse(~forced & ~weighed, "has neither a wrench nor a mass_kg")
    mass = table.number("mass_kg", 0.0)
    table.refuse(weighed & ~(mass > 0.0), "mass_kg must be above 0")
    wrench = np.where(forced[:, None], table.numbers(WRENCH, 0.0), 0.0)
    wrench[weighed, 2] = -GRAVITY * mass[weighed]
    table.refuse(~wrench.any(1), "the load is zero")
    point = _point(table, LOAD, mount.xyz)
    return wrench, np.where(weighed[:, None], _point(table, MASS[1:], point), point)


def _sigma(table: Table) -> tuple[np.ndarray, bool]:
    """(n, 6) [m, rad] and whether the file states them in all rows."""
    known = "sigma_um" in table
    shift = 1e-6 * table.number("sigma_um", None if known else 1.0)
    tilt = 1e-3 * table.number("sigma_mrad", np.nan)
    # three reflectors 0.2 m apart: sigma of a rotation = sqrt(2) sigma of a position / 0.2 m [1/m]
    rotation_per_shift = np.sqrt(2.0) / 0.2
    tilt = np.where(np.isfinite(tilt), tilt, rotation_per_shift * shift)
    table.refuse(~((shift > 0.0) & (tilt > 0.0)), "a standard deviation must be above 0")
    return np.stack([shift] * 3 + [tilt] * 3, -1), known


def write_measurements(path, measured: Measurements, notes=(), remarks=None) -> None:
    """Write the same file; loads are wrenches, an empty value is not measured."""
    shift, tilt = np.hsplit(measured.displacement, 2)
    columns = {
        JOINTS: np.degrees(measured.q),
        WRENCH: measured.wrench,
        LOAD: 1e3 * measured.application,
        REFLECTOR: 1e3 * measured.reflector,
        SHIFT: 1e3 * shift,
        SIGMA[:1]: 1e6 * measured.sigma[:, :1],
    }
    if np.isfinite(tilt).any():
        columns |= {TILT: 1e3 * tilt, SIGMA[1:]: 1e3 * measured.sigma[:, 3:4]}
    numbers = np.hstack(list(columns.values())).tolist()
    texts = [[f"{v:.9g}" if np.isfinite(v) else "" for v in row] for row in numbers]
    rows = [[*row, remark] for row, remark in zip(texts, remarks or [""] * len(texts), strict=True)]
    write_table(path, [*itertools.chain(*columns), "note"], rows, notes)
