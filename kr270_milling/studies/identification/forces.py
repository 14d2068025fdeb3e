"""Force coefficients from mean forces over a revolution [Altintas2012, section 2.8], for any immersion and any law.

A law that is linear in its coefficients has a design matrix; weighted linear least squares over all cuts give them.
Other laws are fitted by non-linear least squares to F_x and F_y, and their axial coefficients, in which F_z is linear,
to F_z. With z out of the part, the axial force has the sign s = -1 where it pulls the tool toward the part (as
``cutting`` has it), +1 where it pushes the tool into its holder; the linear coefficients then are positive, as
published ones are. A helix does not change means over whole revolutions.

The cuts come from a table of feeds, depths and widths, with forces in it or in recordings. Forces of a recording are
tared in an idle stretch and turned into workpiece axes.
"""

from __future__ import annotations

import contextlib
import dataclasses
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from kr270_milling.base.column import computed
from kr270_milling.base.errors import MillingError, ParameterError, RecordingError
from kr270_milling.base.frames import rotation_from_abc
from kr270_milling.base.record import specs
from kr270_milling.base.table import Table, read_table
from kr270_milling.physics.cutting import LAWS, ForceLaw
from kr270_milling.physics.cutting.tool import Tool
from kr270_milling.physics.robot.loads import GRAVITY
from kr270_milling.studies.identification.intervals import MixedUpError, half_interval, scatter, solve
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


FIRST = "linear_edge"
TOWARD_PART, INTO_HOLDER = -1.0, 1.0  #: s of F_z


class OneFeedError(MillingError):
    """The cuts do not identify the coefficients."""

    def __init__(self, feeds: int, cuts: int, least: int = 2):
        self.feeds, self.cuts = feeds, cuts
        what = "one feed per tooth" if feeds == 1 else f"{feeds} feeds per tooth"
        super().__init__(
            f"{cuts} cuts at {what} do not identify the coefficients: the law needs at least {least} feeds, and "
            "tangential and radial coefficients two force components"
        )


@dataclass(frozen=True, eq=False)
class LawFit:
    """Coefficients of one force law; NaN: not measured, infinite half widths: not identified.

    The coefficients have the order and the SI units of the law's record.
    """

    law: str
    cuts: CutMeasurements
    values: np.ndarray  #: (p,)
    half_widths: np.ndarray  #: half widths of their 95 % intervals, (p,)
    modelled: np.ndarray  #: mean forces [N], (n, 3)
    axial: float = TOWARD_PART  #: s of F_z, from the sign of what was measured

    @property
    def residuals(self) -> np.ndarray:
        """Measured less modelled [N], (n, 3)."""
        return self.cuts.force - self.modelled

    @property
    def lateral_rms(self) -> float:
        """Root mean square of the residuals of F_x and F_y [N]."""
        return float(np.sqrt(np.nanmean(self.residuals[:, :2] ** 2)))

    @property
    def residual_rms(self) -> float:
        """Root mean square of the minimised residuals [N]: F_x and F_y alone for a law with a separate axial fit."""
        linear = LAWS[self.law].design(self.cuts) is not None
        return float(np.sqrt(np.nanmean(self.residuals**2))) if linear else self.lateral_rms

    @computed("*")
    def _coefficients(self) -> dict:
        """Values and half widths in units of the parameter file."""
        keys = LAWS[self.law].result_keys()
        scale = np.array([spec.scale for spec in specs(LAWS[self.law])])
        values, widths = (
            dict(zip(keys, (numbers / scale).tolist(), strict=True)) for numbers in (self.values, self.half_widths)
        )
        return {**values, "ci95": widths}


def fit_forces(law: str, cuts: CutMeasurements) -> LawFit:
    """The coefficients of a force law, a name in ``LAWS``; raises OneFeedError.

    The axial coefficients only where fz was measured in two cuts at least.
    """
    design = LAWS[law].design(cuts)
    return _fit_curved(law, cuts) if design is None else _fit_linear(law, cuts, design)


def contradicting_cut(cuts: CutMeasurements, share: float) -> int | None:
    """Return the cut without which the linear-edge law leaves least, if the residual falls below this share."""
    fewest_left = 4
    if len(cuts) <= fewest_left:
        return None
    left = {}
    for row in range(len(cuts)):
        with contextlib.suppress(OneFeedError):
            left[row] = fit_forces(FIRST, cuts.take(np.arange(len(cuts)) != row)).lateral_rms
    worst = min(left, key=left.__getitem__, default=None)
    return None if worst is None or left[worst] > share * fit_forces(FIRST, cuts).lateral_rms else worst


def agreeing_cuts(cuts: CutMeasurements) -> np.ndarray:
    """Return the cuts that a robust fit keeps, (n,) bool: those without which the others do not agree much better."""
    agreeing = np.arange(len(cuts))
    leaves = 0.5  # a cut is left out if the residual of the others falls below this share
    while agreeing.size > len(cuts) // 2 and (worst := contradicting_cut(cuts.take(agreeing), leaves)) is not None:
        agreeing = np.delete(agreeing, worst)
    return np.isin(np.arange(len(cuts)), agreeing)


def fit_all(cuts: CutMeasurements, needed: str) -> list[LawFit]:
    """Fits of all laws that the cuts identify, the linear-edge law first, as published coefficients are of that law.

    Raises OneFeedError where the linear-edge law or the ``needed`` law cannot be fitted.
    """
    fits = [fit_forces(FIRST, cuts)]
    for law in [name for name in LAWS if name not in (FIRST, needed)]:
        with contextlib.suppress(OneFeedError):
            fits.append(fit_forces(law, cuts))
    return fits if needed == FIRST else [*fits, fit_forces(needed, cuts)]


def _fit_linear(law: str, cuts: CutMeasurements, design: np.ndarray) -> LawFit:
    """Linear least squares; the sign of the axial force is that of the measured F_z."""
    sign = INTO_HOLDER if np.nansum(cuts.force[:, 2]) > 0.0 else TOWARD_PART
    design = design * np.array([1.0, 1.0, sign / TOWARD_PART])[:, None]
    axial = _axial_columns(LAWS[law])
    values, widths = np.full(axial.size, np.nan), np.full(axial.size, np.nan)
    for axes, columns in (((0, 1), ~axial), ((2,), axial)):
        used = np.isfinite(cuts.force[:, axes])
        if axes == (2,) and used.sum() < 2:
            continue
        weight = np.broadcast_to(cuts.sigma[:, None], used.shape)[used]
        a = design[:, axes][:, :, columns][used] / weight[:, None]
        try:
            values[columns], widths[columns] = solve(a, cuts.force[:, axes][used] / weight, cuts.sigma_known)
        except MixedUpError:
            raise OneFeedError(cuts.feeds, len(cuts), LAWS[law].least_feeds) from None
    return LawFit(law, cuts, values, widths, design @ np.nan_to_num(values), sign)


def _fit_curved(law: str, cuts: CutMeasurements) -> LawFit:
    """Non-linear least squares from the start values of the law."""
    kind, start = LAWS[law], np.array(LAWS[law].start)
    axial = _axial_columns(kind)
    if cuts.feeds < kind.least_feeds or 2 * len(cuts) <= len(start):
        raise OneFeedError(cuts.feeds, len(cuts), kind.least_feeds)
    lower, upper = np.array(kind.searched).T

    def residuals(x):
        modelled = _with(kind, np.clip(x * start, lower, upper)).mean_forces(cuts)
        return ((modelled - cuts.force)[:, :2] / cuts.sigma[:, None]).ravel()

    solved = least_squares(
        residuals, np.ones(len(start)), bounds=(lower / start, upper / start), x_scale="jac", xtol=1e-12, ftol=1e-12
    )
    freedom = 2 * len(cuts) - len(start)
    variance = scatter(2 * solved.cost, freedom, cuts.sigma_known)
    quantile = half_interval(freedom, cuts.sigma_known)
    _, singular, turned = np.linalg.svd(solved.jac, full_matrices=False)
    with np.errstate(divide="ignore"):
        inverse = (turned.T / np.where(singular > 1e-9 * singular[0], singular, 0.0) ** 2) @ turned
    values, widths = np.full(axial.size, np.nan), np.full(axial.size, np.nan)
    values[~axial] = solved.x * start
    widths[~axial] = np.nan_to_num(quantile * np.sqrt(variance * np.diag(inverse)) * start, nan=np.inf, posinf=np.inf)
    values[axial], widths[axial] = _fit_axial(kind, cuts, solved.x * start)
    try:
        law_of_fit = kind(*map(float, np.nan_to_num(values)))
    except ParameterError:  # axial coefficients that no cut has, where F_x and F_y are not those of a cut
        values[axial], widths[axial] = np.nan, np.nan
        law_of_fit = kind(*map(float, np.nan_to_num(values)))
    modelled = law_of_fit.mean_forces(cuts)
    return LawFit(law, cuts, values, widths, modelled)


def _axial_columns(kind: type[ForceLaw]) -> np.ndarray:
    """Coefficients of the axial force, (p,) bool."""
    return np.array([spec.name in kind.axial_names for spec in specs(kind)])


def _with(kind: type[ForceLaw], lateral, **axial: float) -> ForceLaw:
    """A law with its coefficients other than the axial ones, in their order, and with some axial ones."""
    names = [spec.name for spec in specs(kind) if spec.name not in kind.axial_names]
    return kind(**dict(zip(names, map(float, lateral), strict=True)), **(dict.fromkeys(kind.axial_names, 0.0) | axial))


def _fit_axial(kind: type[ForceLaw], cuts: CutMeasurements, lateral) -> tuple[np.ndarray, np.ndarray]:
    """Axial coefficients and half widths by linear least squares: F_z is a sum of coefficients times unit forces."""
    used, count = np.isfinite(cuts.force[:, 2]), len(kind.axial_names)
    if not count or used.sum() < 2:
        return np.full(count, np.nan), np.full(count, np.nan)
    unit = np.stack([_with(kind, lateral, **{name: 1.0}).mean_forces(cuts)[:, 2] for name in kind.axial_names], -1)
    sigma = cuts.sigma[used]
    try:
        return solve(unit[used] / sigma[:, None], cuts.force[used, 2] / sigma, cuts.sigma_known)
    except MixedUpError:
        raise OneFeedError(cuts.feeds, len(cuts), kind.least_feeds) from None


def law_sections(law: str, values, half_widths, axial: float = TOWARD_PART) -> dict:
    """Return the sections of a parameter file: the law with its coefficients, and their uncertainty for the verdict.

    ``uncertainty.force_coefficients`` requires the intervals of all coefficients that the verdict draws; those of the
    axial force follow if they were measured.
    """
    group, relative = {}, {}
    kind = LAWS[law]
    for spec, value, width in zip(specs(kind), values, half_widths, strict=True):
        if np.isnan(value):
            continue
        relative[spec.name] = width / 1.96 / max(abs(value), 1e-300)
        value = value * axial / TOWARD_PART if spec.name in kind.axial_names else max(value, 0.0)
        known = "" if np.isnan(width) else f"95 % +- {width / spec.scale:.3g}"
        group[spec.key] = (float(value / spec.scale), known)
    sections = {"cutting": {"law": law, law: group}}
    drawn = [*kind.scattered, *(kind.axial_names if set(kind.axial_names) <= set(relative) else ())]
    spread = np.array([relative.get(name, np.nan) for name in drawn])
    if np.isfinite(spread).all():
        shown = np.clip(spread, 1e-4, 1.0).tolist()
        sections["uncertainty"] = {"force_coefficients": (shown, "standard deviations from the same fit")}
    return sections
