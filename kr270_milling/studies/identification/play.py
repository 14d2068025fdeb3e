"""Backlash of the joints from push and pull at the tool: readings of a dial gauge along the force.

    d = o_i + c_i f + sum_k u . J_k b_k s_k / 2     reading d, force f, of setup i (posture and axis u)

s_k is the flank of joint k (``physics.motion.backlash``): the sign of its torque of weight and force beyond
friction.
Gravity holds joints on one flank; only a joint whose flank changes shows its backlash b_k. Offset o and compliance c of
each setup are fitted with the b_k, by least squares.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.column import column
from kr270_milling.base.errors import InputError
from kr270_milling.base.table import read_table
from kr270_milling.physics.motion.backlash import flank_after
from kr270_milling.physics.robot.arm import Arm, Mount
from kr270_milling.physics.robot.elastostatics import compliance, equilibrium
from kr270_milling.physics.robot.kinematics import forward, jacobian_at
from kr270_milling.physics.robot.loads import link_loads, load_torque
from kr270_milling.studies.identification.doubts import Doubt
from kr270_milling.studies.identification.intervals import MixedUpError, solve

JOINTS = tuple(f"a{j}_deg" for j in range(1, 7))
AXES = ("x", "y", "z")
ARCSEC = math.pi / 648000  # [rad]


@dataclass(frozen=True, eq=False)
class Pushes:
    """n readings, in the order in which they were taken."""

    q: np.ndarray  #: joint angles [rad], (n, 6)
    axis: np.ndarray  #: of base_link, 0 to 2, (n,)
    force: np.ndarray  #: on the tool point along the axis [N], (n,)
    reading: np.ndarray  #: displacement of the tool point along the axis [m], (n,)
    sigma: np.ndarray  #: [m], (n,); all 0: not stated

    @property
    def setup(self) -> np.ndarray:
        """Number of the setup of each reading, (n,); a setup is a stretch with one posture and axis."""
        rows = np.column_stack([self.q, self.axis])
        return np.cumsum(np.append(0, np.any(np.diff(rows, axis=0), axis=1)))


@dataclass(frozen=True, eq=False)
class Backlash:
    """The identified backlash, with half widths of the 95 % intervals."""

    joints: tuple[int, ...] = column("joints")  #: identified each for itself, from 1; empty: the common multiple
    width: np.ndarray = column("backlash_arcsec", 1.0 / ARCSEC)  #: of all joints [rad], (6,)
    multiple: float = column("multiple")  #: of the arm file, common to all joints
    half: float = column("half_width")  #: half width of the interval, as a share of the width
    residual: float = column("residual_um", 1e6)  #: root mean square [m]
    doubts: tuple[Doubt, ...] = ()


def read_pushes(path) -> Pushes:
    """Read a CSV table: a1_deg to a6_deg, axis (x, y, z), force_n, reading_mm, sigma_um; raises InputError."""
    needed = (*JOINTS, "axis", "force_n", "reading_mm")
    table = read_table(path, (*needed, "sigma_um", "note"), needed)
    axes = np.array(table.texts("axis"))
    table.refuse(~np.isin(axes, AXES), "axis must be x, y or z of base_link")
    reading = 1e-3 * table.number("reading_mm")
    farthest = 10e-3  # [m] of a reading; more is a wrong unit
    table.refuse(np.abs(reading) > farthest, f"reading_mm must be in mm and at most {1e3 * farthest:g}")
    sigma = 1e-6 * table.number("sigma_um", 0.0)
    table.refuse((sigma < 0.0) | ((sigma == 0.0) & (sigma > 0.0).any()), "sigma_um must be above 0 in each row or none")
    pushes = Pushes(
        np.radians(table.numbers(JOINTS)),
        np.array([AXES.index(a) for a in axes]),
        table.number("force_n"),
        reading,
        sigma,
    )
    for number in range(pushes.setup[-1] + 1):
        here = np.flatnonzero(pushes.setup == number)
        if not pushes.force[here].min() < 0.0 < pushes.force[here].max():
            raise InputError(
                path, "needs push and pull, forces above and below 0, in each posture", table.lines[here[0]]
            )
    return pushes


def _columns(arm: Arm, mount: Mount, pushes: Pushes) -> tuple[np.ndarray, np.ndarray]:
    """Columns of the backlash of each joint (n, 6), and the compliance of the arm along the axis [m/N], (n,)."""
    loads, number = link_loads(arm, mount), pushes.setup
    columns, soft = np.zeros((len(pushes.force), 6)), np.zeros(len(pushes.force))
    for setup in range(number[-1] + 1):
        here = np.flatnonzero(number == setup)
        q, axis = pushes.q[here[0]], pushes.axis[here[0]]
        frames = forward(arm, mount, q)
        lever = jacobian_at(frames, frames.tool.position)[axis]
        weight = load_torque(frames, np.zeros(6), loads)
        flank = [flank_after(t, f, 0.0) for t, f in zip(weight, arm.friction_torque, strict=True)]
        for row in here:
            torque = weight + lever * pushes.force[row]
            flank = [flank_after(t, f, s) for t, f, s in zip(torque, arm.friction_torque, flank, strict=True)]
            columns[row] = 0.5 * lever * flank
        soft[here] = compliance(equilibrium(arm, mount, q), arm)[axis, axis]
    return columns, soft


def fit_backlash(arm: Arm, mount: Mount, pushes: Pushes, path: str = "") -> Backlash:
    """Fit the backlash of each joint whose load reverses; where these cannot be separated, their common multiple.

    Raises InputError where no load reverses.
    """
    columns, soft = _columns(arm, mount, pushes)
    number, known = pushes.setup, bool(pushes.sigma.any())
    setups = (number[:, None] == np.arange(number[-1] + 1)).astype(float)
    own = np.hstack([setups, setups * pushes.force[:, None]])
    seen = np.zeros(6, bool)
    for setup in range(number[-1] + 1):
        seen |= np.ptp(columns[number == setup], axis=0) > 0.0
    if not seen.any():
        raise InputError(path, "no load of a joint reverses: push and pull harder, or along another axis")
    weight = 1.0 / pushes.sigma if known else np.ones(len(pushes.force))
    sought = np.flatnonzero(seen)

    def fitted(of_joints: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers and half widths of the columns (n, k), and the compliances of the setups."""
        rows = np.hstack([of_joints, own])
        x, half = solve(weight[:, None] * rows, weight * pushes.reading, known)
        left = pushes.reading - rows @ x
        k = of_joints.shape[1]
        return x[:k], half[:k], np.append(x[k + setups.shape[1] :], np.sqrt(np.mean(left**2)))

    shown = 0.5  # half width of an interval, as share of the value, up to which a number is identified
    joints: tuple[int, ...] = ()
    try:
        width, half, rest = fitted(columns[:, sought])
        if np.all(half < shown * width):
            joints = tuple((sought + 1).tolist())
    except MixedUpError:
        pass
    if joints:
        shares = width / np.where(arm.backlash[sought] > 0.0, arm.backlash[sought], width)
        multiple, share = float(np.mean(shares)), float(np.max(half / width))
        whole = multiple * arm.backlash
        whole[sought] = width
    elif not arm.backlash[sought].any():
        raise InputError(path, "does not separate the joints, and arm.backlash_arcsec is 0: measure more postures")
    else:
        try:
            (multiple,), (half_one,), rest = fitted(columns[:, sought] @ arm.backlash[sought, None])
        except MixedUpError:
            raise InputError(path, "has too few readings: take three forces each way in each posture") from None
        multiple, share = float(multiple), float(half_one / abs(multiple)) if multiple else math.inf
        whole = multiple * arm.backlash
    doubts = _doubts(rest[:-1], soft[np.unique(number, return_index=True)[1]], multiple, share, whole)
    return Backlash(joints, np.maximum(whole, 0.0), multiple, share, float(rest[-1]), tuple(doubts))


def _doubts(measured: np.ndarray, expected: np.ndarray, multiple: float, share: float, width: np.ndarray):
    """Yield doubts about the unit and the sign of the readings, and about the result."""
    factor = float(np.median(measured / expected))
    far = 5.0  # factor on the compliance of the arm file beyond which unit or sign is wrong: assumed
    if not 1.0 / far < factor < far:
        text = f"the readings are {factor:.3g} times those of the arm file: unit or sign of force or reading?"
        yield Doubt(text, True)
    elif multiple <= 0.0 or share > 1.0:
        yield Doubt(f"no backlash is identified: {width.max() / ARCSEC:.3g} arcsec +- {100 * share:.0f} %", True)


def backlash_keys(result: Backlash) -> dict:
    """Return the keys of a parameter file; simulated robots then have the interval of the identified backlash."""
    names = f"joints {', '.join(map(str, result.joints))} each" if result.joints else "common multiple of the arm file"
    share = min(result.half, 1.0)
    return {
        "arm": {"backlash_arcsec": (result.width / ARCSEC, names)},
        "uncertainty": {
            "least_backlash": (1.0 - share, "lower limit of the 95 % interval, as a share"),
            "backlash": 1.0 + share,
        },
    }
