"""The lag of the motors from a test move: commanded and measured motion along one direction.

    y = a + b t + g x(t - T),   x'' + 2 zeta w x' + w^2 x = w^2 c      a, b: place and drift, g: scale

c is the commanded and y the measured motion. a, b and g are linear and are eliminated [Golub1973]; w, zeta and T follow
by least squares. The intervals contain the correlation of the residuals: s^2 grows by 1 + 2 sum rho_k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.column import column
from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.base.table import read_table
from kr270_milling.path.trajectory import TOOL_DOWN, Trajectory
from kr270_milling.physics.motion.imperfections import Imperfections, second_order
from kr270_milling.recordings.messages.cdr import FIXED
from kr270_milling.studies.identification.doubts import Doubt
from kr270_milling.studies.identification.intervals import half_interval
from kr270_milling.studies.identification.signals import even_stamps, pose_series, read_topic, resampled

FINE = 0.5e-3  #: [s], longest step of the integration; samples are farther apart


@dataclass(frozen=True, eq=False)
class Move:
    """A test move, evenly sampled."""

    step: float  #: [s]
    commanded: np.ndarray  #: (n,), in any unit
    measured: np.ndarray  #: (n,), in the same unit
    note: str = ""  #: sentence about the stamps


@dataclass(frozen=True)
class Servo:
    """The identified lag, with half widths of the 95 % intervals; a half width of 0: assumed."""

    frequency: float = column("frequency_hz")
    frequency_half: float = column("frequency_hz_half_width")
    damping: float = column("damping_ratio")
    damping_half: float = column("damping_ratio_half_width")
    delay: float = column("dead_time_ms", 1e3)
    delay_half: float = column("dead_time_ms_half_width", 1e3)
    gain: float = column("gain")
    unexplained: float = column("unexplained")  #: share of the motion that the lag does not explain
    explained: np.ndarray = column("")  #: motion that the lag explains, (n,)

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest frequency [Hz]."""
        return max(0.1, self.frequency - self.frequency_half), min(1000.0, self.frequency + self.frequency_half)


def test_move() -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and a motion [m] that shows the lag: two slow pulses, then a sweep of 1 to 25 Hz, with rest around."""
    rate, size = 1.0, 0.3e-3  # [m/s2], [m], largest acceleration and displacement
    step, rest, pulse, sweep = 4e-3, 1.0, 0.5, 6.0  # [s]
    low, high = 1.0, 25.0  # [Hz], assumed: around the lags of heavy arms
    t = np.arange(0.0, 2 * rest + 2 * pulse + sweep, step)
    at = t - rest
    pulses = size * np.sin(np.pi * np.clip(at / pulse, 0.0, 2.0)) ** 2
    at = np.clip(at - 2 * pulse, 0.0, sweep)
    frequency = low * (high / low) ** (at / sweep)
    phase = 2 * np.pi * (frequency - low) * sweep / np.log(high / low)
    faded = np.clip(np.minimum(at, sweep - at) / 0.3, 0.0, 1.0)
    return t, pulses + faded * np.minimum(size, rate / (2 * np.pi * frequency) ** 2) * np.sin(phase)


def moved_along(
    place: np.ndarray, along: np.ndarray, across: np.ndarray, speed: float
) -> tuple[Trajectory, Trajectory]:
    """Return a straight line through a place [m] along a direction (3,), and the same with the test move across."""
    t, shift = test_move()
    time_ns = np.rint(1e9 * t).astype(np.int64)
    line = Trajectory(time_ns, place + np.outer(speed * (t - t.mean()), along), np.array(TOOL_DOWN))
    return line, line.with_position(line.position + np.outer(shift, across))


def read_move(path) -> Move:
    """A CSV table with time_s and a pair of PAIRS, or a recording of the command ``rsi``; raises InputError."""
    pairs = (("commanded_mm", "measured_mm"), ("commanded_deg", "measured_deg"))
    if not str(path).lower().endswith(".csv"):
        return _recorded_move(path)
    table = read_table(path, ("time_s", *(name for pair in pairs for name in pair), "note"), ("time_s",))
    pair = next((pair for pair in pairs if pair[0] in table and pair[1] in table), None)
    if pair is None:
        raise InputError(path, "needs the columns commanded_mm and measured_mm, or commanded_deg and measured_deg", 1)
    time, step, note = even_stamps(path, table.number("time_s"), table.lines)
    commanded, measured = resampled(time, table.numbers(pair), step).T
    return _moving(path, Move(step, commanded, measured, note))


def _recorded_move(path) -> Move:
    """Return correction and tool pose of an RSI recording, across the path; both have the stamps of the robot."""
    time, correction = read_topic(path, "correction", FIXED)
    at, place = pose_series(path, "tool_pose")
    direction = np.linalg.svd(correction[:, :3], full_matrices=False)[2][0]
    commanded = correction[:, :3] @ direction
    moving = np.flatnonzero(commanded)
    if not moving.size:
        raise RecordingError(path, "has no correction")
    rest = 0.3  # [s] before and after the correction
    inside = (time >= time[moving[0]] - rest) & (time <= time[moving[-1]] + rest)
    time, commanded = time[inside], commanded[inside]
    time, step, note = even_stamps(path, time, None)
    measured = np.interp(time, at, place @ direction)
    commanded, measured = resampled(time, np.column_stack([commanded, measured]), step).T
    return _moving(path, Move(step, commanded, measured, note))


def _moving(path, move: Move) -> Move:
    """Return a move that begins at rest; raise InputError for other ones."""
    least, rest = 100, 0.05  # samples; s at the start
    if len(move.commanded) < least:
        raise InputError(path, f"holds {len(move.commanded)} samples, but a test move needs at least {least}")
    size = np.ptp(move.commanded)
    if not size:
        raise InputError(path, "the commanded motion does not move")
    begin = move.commanded[: max(2, round(rest / move.step))]
    if np.ptp(begin) > 0.02 * size:  # assumed
        raise InputError(path, f"moves in its first {rest:g} s: begin the record before the move")
    return move


def _followed(move: Move, numbers: np.ndarray, longest: float = FINE) -> np.ndarray:
    """x(t - T), (n,), without its mean and drift; numbers: log w / (2 pi), log zeta, T. Samples are joined by lines.

    longest: step of the integration [s].
    """
    n, parts = len(move.commanded), max(1, int(np.ceil(move.step / longest)))
    fine = np.arange((n - 1) * parts + 1) / parts
    late = np.interp(fine - numbers[2] / move.step, np.arange(n), move.commanded)
    frequency, damping = np.exp(numbers[:2])
    return _detrended(second_order(late[:, None], frequency, damping, move.step / parts)[::parts, 0])


def _detrended(row: np.ndarray) -> np.ndarray:
    """Row (n,) without its mean and its drift."""
    drift = np.linspace(-1.0, 1.0, row.size)
    return row - row.mean() - drift * np.sum(drift * row) / np.sum(drift * drift)


def fit_servo(move: Move, damping: float | None = None) -> Servo:
    """Fit frequency, damping ratio and dead time; damping: assumed, not fitted."""
    from scipy.optimize import least_squares  # takes longer to import than all else that a command needs

    measured = _detrended(move.measured)
    size = float(np.sqrt(np.sum(measured**2))) or 1.0
    free = np.array([True, damping is None, True])
    low = np.array([np.log(0.1), np.log(0.05), -0.1])
    high = np.array([np.log(min(1000.0, 0.5 / move.step)), np.log(5.0), 1.0])
    ends = 1e-4 * np.eye(3) * np.array([1.0, 1.0, 1.0 / np.exp(high[0])])  # of differences

    def scaled(numbers: np.ndarray, longest: float = FINE) -> np.ndarray:
        followed = _followed(move, numbers, longest)
        return followed * np.sum(followed * measured) / max(float(np.sum(followed**2)), 1e-300)

    def complete(part: np.ndarray) -> np.ndarray:
        numbers = start.copy()
        numbers[free] = part
        return numbers

    tried = []
    for frequency in np.geomspace(1.0, 0.9 * np.exp(high[0]), 10):
        for ratio in (0.4, 1.0) if damping is None else (damping,):
            for delay in (0.0, 10e-3, 40e-3):
                start = np.array([np.log(frequency), np.log(ratio), delay])
                tried.append((float(np.sum((measured - scaled(start, move.step)) ** 2)), tuple(start)))
    start = np.array(min(tried)[1])
    numbers = complete(
        least_squares(
            lambda part: (measured - scaled(complete(part))) / size,
            start[free],
            bounds=(low[free], high[free]),
            x_scale=np.diag(ends)[free] * 1e3,
        ).x
    )
    explained = scaled(numbers)
    left = measured - explained
    slopes = [
        (scaled(numbers + ends[k]) - scaled(numbers - ends[k])) / (2.0 * ends[k, k]) for k in np.flatnonzero(free)
    ]
    columns = np.column_stack(slopes)
    columns -= np.outer(explained, explained @ columns) / max(float(explained @ explained), 1e-300)  # of the scale
    # numbers that are eliminated: a, b, g
    freedom = len(left) - 3 - columns.shape[1]
    length = np.linalg.norm(columns, axis=0)
    inverse = np.linalg.pinv((columns / length).T @ (columns / length))
    variance = float(left @ left) / freedom * _correlation(left) + 1e-24 * size**2
    half = np.zeros(3)
    half[free] = half_interval(freedom, False) * np.sqrt(variance * np.diag(inverse)) / length
    frequency, ratio, delay = np.exp(numbers[0]), np.exp(numbers[1]), numbers[2]
    followed = _followed(move, numbers)
    gain = float(np.sum(followed * measured) / max(float(np.sum(followed**2)), 1e-300))
    return Servo(
        frequency=float(frequency),
        frequency_half=float(frequency * half[0]),
        damping=float(ratio),
        damping_half=float(ratio * half[1]),
        delay=float(delay),
        delay_half=float(half[2]),
        gain=gain,
        unexplained=float(np.sqrt(np.sum(left**2))) / size,
        explained=explained,
    )


def _correlation(left: np.ndarray) -> float:
    """1 + 2 sum rho_k, up to the first negative correlation of the residuals."""
    left = left - left.mean()
    power = np.abs(np.fft.rfft(left, 2 * left.size)) ** 2
    rho = np.fft.irfft(power)[: left.size]
    rho = rho / rho[0] if rho[0] else rho
    negative = np.flatnonzero(rho < 0.0)
    return 1.0 + 2.0 * float(np.sum(rho[1 : negative[0] if negative.size else left.size]))


def identified_servo(move: Move) -> tuple[Servo, list[Doubt]]:
    """Return the lag of a test move; a damping ratio that the move does not show is assumed."""
    servo, doubts = fit_servo(move), [Doubt(move.note)] if move.note else []
    shown = 0.5  # half width of an interval, as share of the value, up to which a number is identified
    if not servo.damping_half < shown * servo.damping:
        servo = fit_servo(move, Imperfections().servo_damping)
        doubts.append(Doubt(f"the move does not show the damping ratio: {servo.damping:g} is assumed"))
    fastest = 0.25 / move.step
    if not servo.frequency_half < shown * servo.frequency:
        text = f"the move does not show the frequency ({servo.frequency:.3g} +- {servo.frequency_half:.2g} Hz)"
        doubts.append(Doubt(f"{text}: move faster, as --plan does", True))
    elif servo.frequency > fastest:
        text = f"the motors follow faster than samples every {1e3 * move.step:.3g} ms show ({fastest:.3g} Hz)"
        doubts.append(Doubt(text, True))
    most_unexplained = 0.25  # share, as of load tests
    if servo.unexplained > most_unexplained:
        text = f"the lag leaves {100 * servo.unexplained:.0f} % of the measured motion unexplained"
        doubts.append(Doubt(f"{text}: is it the same direction, clock and move?", True))
    elif not 0.8 < servo.gain < 1.25:
        text = f"the measured motion is {servo.gain:.3g} times the commanded one: unit, sign or direction?"
        doubts.append(Doubt(text, True))
    late = servo.delay + servo.delay_half
    if late < -0.5e-3:
        text = f"the measured motion is {-1e3 * servo.delay:.3g} ms before the commanded one"
        doubts.append(Doubt(f"{text}: are the columns swapped, or are there two clocks (--other-clock)?", True))
    return servo, doubts


def servo_keys(servo: Servo, same_clock: bool) -> dict:
    """Return the keys of a parameter file; same_clock: both columns have one clock, so that the dead time is known."""
    low, high = servo.range
    ratio = f"95 % +- {servo.damping_half:.2g}" if servo.damping_half else "assumed"
    own: dict = {"servo_damping": (servo.damping, ratio)}
    assumed: dict = {"servo_frequency_hz": ([low, high], f"{servo.frequency:.4g} Hz and its 95 % interval")}
    if same_clock:
        first = max(0.0, servo.delay - servo.delay_half)
        width = max(0.0, servo.delay + servo.delay_half - first)
        own["servo_delay_ms"] = (1e3 * first, "lower limit of the 95 % interval")
        assumed["servo_delay_ms"] = (1e3 * width, "width of the interval")
    return {"imperfections": own, "uncertainty": assumed}
