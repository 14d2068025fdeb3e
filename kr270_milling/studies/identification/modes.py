"""Modes from a ring-down or an impact: a rational fit of all channels, and the logarithmic decrement as its check.

A free vibration is a sum of poles, y(t) = sum_k R_k exp(s_k t); its transform is the rational function
sum_k R_k / (s - s_k). The matrix pencil method [Hua1990] finds the poles from the shift of the Hankel matrix of the
samples, reduced to its n strongest singular values: f = |s| / 2 pi, zeta = -Re(s) / |s|. The residues R_k follow by
linear least squares; their ratios between channels are the mode's shape. Of an impact, the response is first divided by
the hammer's force in the frequency domain and turned back to an impulse response.

Logarithmic decrement: ln of the envelope of the band around the mode falls by zeta omega each second, where
the envelope is that of the analytic signal (Hilbert).

Mass-normalised shapes, as ``dynamics.modes`` wants them: a mode of shape phi answers an impulse along d with
phi phi_d sin(omega_d t) exp(-zeta omega t) / omega_d; its residues are R = phi phi_d / (2 i omega_d). With a hammer the
drive point gives phi_d^2 = 2 i omega_d R_d, and the others follow. Velocities and accelerations have s R and s^2 R.
A force channel that is late by tau makes of R the residue R exp(s tau): the phase of 2 i omega_d R_d, which is 0, grows
by omega_d tau with the frequency. Another quantity turns all phases by 90 or 180 degrees.
Without a hammer only the direction psi of phi = alpha psi is known. The static compliance of the arm is the sum over
its modes, C = sum alpha_k^2 psi_k psi_k^T / omega_k^2, which gives alpha_k^2 >= 0 by least squares over the components
that were measured.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from scipy import signal
from scipy.optimize import nnls

from kr270_milling.base.column import column, computed
from kr270_milling.base.errors import InputError, ModelError
from kr270_milling.cell.arm import PlacedArm
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.robot import compliance, equilibrium, rotate_matrix
from kr270_milling.studies.identification.signals import AXES, Signals

POWER = {"displacement": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True, eq=False)
class Mode:
    """A mode of a linear machine."""

    pole: complex  #: s_k [1/s]
    residues: np.ndarray  #: R_k of each channel, complex (channels,)
    clear: float  #: size of the residues over their standard deviation
    #: share of the energy of all modes
    share: float = column("share_of_energy", unit="%", scale=100.0, digits=1, short="energy")
    #: damping ratio by the logarithmic decrement; NaN where another mode is too near
    decrement: float = column("damping_ratio_log_decrement", unit="%", scale=100.0, digits=2, short="by decrement")
    #: half widths of the 95 % intervals of frequency [Hz] and damping ratio, for noise that is white
    half_widths: tuple[float, float] = (math.nan, math.nan)

    @computed("frequency_hz", unit="Hz", digits=3, short="frequency")
    def frequency(self) -> float:
        """Undamped [Hz]."""
        return float(np.abs(self.pole) / (2 * np.pi))

    @computed("ci95_frequency_hz", unit="Hz", digits=3, short="95 % ±")
    def frequency_half_width(self) -> float:
        return self.half_widths[0]

    @computed("damping_ratio", unit="%", scale=100.0, digits=2, short="damping")
    def damping_ratio(self) -> float:
        return float(-self.pole.real / np.abs(self.pole))

    @computed("ci95_damping_ratio", unit="%", scale=100.0, digits=2, short="95 % ±")
    def damping_half_width(self) -> float:
        return self.half_widths[1]

    @property
    def confirmed(self) -> bool:
        """Return whether the logarithmic decrement gives about the same damping ratio."""
        together = 0.2  # relative difference of both damping ratios up to which they confirm each other
        return bool(abs(self.decrement / self.damping_ratio - 1.0) < together)

    @property
    def shape(self) -> np.ndarray:
        """Amplitudes of the channels, (channels,), the largest is 1."""
        return np.real(self.residues / self.residues[np.argmax(np.abs(self.residues))])


def split_modes(signals: Signals, low: float, high: float, most: int = 6) -> tuple[list[Mode], list[Mode]]:
    """The modes between two frequencies [Hz], the lowest first, and the faint ones that may be noise.

    Raises ModelError where there is no mode.
    """
    visible = 8.0  # standard deviations; a pole that follows noise reaches about 4
    data = signals.values - signals.values[-max(1, len(signals.values) // 10) :].mean(0)
    if signals.force is not None:
        data = impulse_response(signals, signals.force)
    data, step = _thinned(data, signals.step, high)
    poles = _poles(data, step, 2 * most + 2)
    frequency, damping = np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)
    most_damped = 0.5
    shown = (frequency > low) & (frequency < high) & (poles.imag > 0) & (damping > 0.0) & (damping < most_damped)
    residues, spread = _residues(data, step, poles)
    energy = np.sum(np.abs(residues) ** 2, 1) / np.maximum(2 * np.abs(poles.real), 1e-12)
    clear = np.sqrt(np.sum(np.abs(residues) ** 2, 1) / np.maximum(np.sum(spread**2, 1), 1e-300))
    rounding = 1e-6  # share of the energy below which a pole is rounding
    shown &= energy > rounding * energy[shown].max(initial=0.0)
    if not shown.any():
        reason = f"nothing rings between {low:g} and {high:g} Hz with a damping ratio below {most_damped}"
        raise ModelError(reason)
    faint_share = 0.02  # share of the strongest mode's energy below which a mode must exceed the noise by CLEAR
    strong = shown & ((energy > faint_share * energy[shown].max()) | (clear > visible))
    order = np.flatnonzero(strong)[np.argsort(frequency[strong])][:most]
    faint = [k for k in np.flatnonzero(shown)[np.argsort(frequency[shown])] if k not in order]
    total = float(energy[shown].sum())
    poles, half_widths = _refined(data, step, poles, order)
    modes = []
    for k in (*order, *faint):
        others = np.abs(frequency[order[order != k]] - frequency[k])  # a faint pole does not disturb the decrement
        room = others.min() if others.size else frequency[k]
        largest = data[:, np.argmax(np.abs(residues[k]))]
        band = min(0.5 * frequency[k], 0.45 * room)
        decrement = log_decrement(largest, step, float(frequency[k]), band, float(damping[k]))
        share = float(energy[k] / total)
        widths = half_widths.get(int(k), (math.nan, math.nan))
        modes.append(Mode(complex(poles[k]), residues[k], float(clear[k]), share, decrement, widths))
    return modes[: len(order)], modes[len(order) :]


def free_decay(signals: Signals, low: float, high: float) -> Signals:
    """Leave out the quiet samples before a ring-down, whose step is no free vibration; a force needs no such cut."""
    if signals.force is not None:
        return signals
    edges = [low, min(high, 0.45 / signals.step)]
    if edges[0] >= edges[1]:
        return signals
    data = signal.sosfiltfilt(signal.butter(2, edges, "bandpass", fs=1 / signals.step, output="sos"), signals.values,
                              axis=0, padlen=0)  # fmt: skip
    size = np.linalg.norm(data / np.maximum(np.abs(data).max(0), 1e-300), axis=1)
    quiet = 0.2  # share of the largest motion in the band, below which no ring-down is assumed to run
    start = int(np.argmax(size > quiet * size.max())) * signals.step
    power = np.sum(np.abs(np.fft.rfft(data, axis=0)) ** 2, axis=1)
    if start * int(np.argmax(power)) < 0.25 * len(data) * signals.step:  # a quarter of the strongest period
        return signals
    start = int(np.argmax(size)) * signals.step
    note = f"the first {start:.4g} s are left out: the ring-down begins there (pre-trigger)"
    cut = signals.window(start, None)
    return dataclasses.replace(cut, notes=(*cut.notes, note))


def impulse_response(signals: Signals, force: np.ndarray) -> np.ndarray:
    """Response over force (n,) [N] in the frequency domain (H_1), back in time: (n, channels), per N s.

    What the hammer excites by less than a thousandth of its largest does not count.
    """
    n = 2 * len(signals.values)
    push = np.fft.rfft(force - np.median(force), n)[:, None]
    response = np.fft.rfft(signals.values - np.median(signals.values, axis=0), n, axis=0)
    power = np.abs(push) ** 2
    ratio = response * np.conj(push) / (power + 1e-6 * power.max())
    return np.fft.irfft(ratio, n, axis=0)[: len(signals.values)] / signals.step


def _thinned(data: np.ndarray, step: float, high: float) -> tuple[np.ndarray, float]:
    """Fewer samples of what lies below ``high``; a sound mode needs some five samples a period."""
    factor = int(max(1, min(np.floor(1 / (5 * high * step)), len(data) // 64)))
    while factor > 1:
        part = min(factor, 10)
        data = signal.decimate(data, part, axis=0, ftype="fir")
        step, factor = step * part, factor // part
    most_samples = 1200  # samples of the pencil; longer series are thinned after a low-pass
    return data[:most_samples], step


def _poles(data: np.ndarray, step: float, order: int) -> np.ndarray:
    """Poles of all channels together, (k,) [1/s]."""
    n = len(data)
    pencil = n // 3
    hankel = np.concatenate([np.lib.stride_tricks.sliding_window_view(c, n - pencil) for c in data.T], 1)
    square, right = np.linalg.eigh(hankel @ hankel.T)  # the right singular vectors of the transpose, ten times as fast
    noise_share = 1e-3  # share of the strongest singular value: below is noise
    count = min(order, int(np.count_nonzero(square > noise_share**2 * square[-1])))
    basis = right[:, : -count - 1 : -1]
    shift = np.linalg.lstsq(basis[:-1], basis[1:], rcond=None)[0]
    with np.errstate(divide="ignore"):
        return np.log(np.linalg.eigvals(shift).astype(complex)) / step


def _residues(data: np.ndarray, step: float, poles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R_k of each channel and their standard deviations, (k, channels).

    Poles that grow count from the end, so that no number overflows.
    """
    time = step * np.arange(len(data))[:, None]
    late = np.where(poles.real > 0.0, time[-1], 0.0)
    basis = np.exp(poles * (time - late))
    residues = np.linalg.lstsq(basis, data.astype(complex), rcond=None)[0]
    left = np.sum(np.abs(data - basis @ residues) ** 2, axis=0) / max(1, len(data) - len(poles))
    inverse = np.linalg.pinv(basis.conj().T @ basis)
    return residues, np.sqrt(np.maximum(np.diag(inverse).real, 0.0)[:, None] * left)


def _refined(
    data: np.ndarray, step: float, poles: np.ndarray, modes: np.ndarray
) -> tuple[np.ndarray, dict[int, tuple[float, float]]]:
    """Least squares poles of the modes, and half widths of the 95 % intervals of their frequencies and damping ratios.

    y = sum R_k exp(s_k t) is linearised in s_k and R_k; the first step of Gauss and Newton from the pencil's poles is
    taken where the residual falls. A change of pole k is w . residual with real residuals of variance sigma^2, so
    d ln|s| = Re(s* ds) / |s|^2 and the like have the variance sigma^2 sum (Re ...)^2.
    """
    time = step * np.arange(len(data))
    index, mirrored = np.asarray(modes, int), [int(np.argmin(np.abs(poles - poles[k].conj()))) for k in modes]
    moved, changes = poles.copy(), np.zeros((0, data.size), complex)
    spread = np.zeros(data.size)
    for last in (False, True):
        late = np.where(moved.real > 0.0, time[-1], 0.0)
        basis = np.exp(moved * (time[:, None] - late))
        residues = np.linalg.lstsq(basis, data.astype(complex), rcond=None)[0]
        left = (data - basis @ residues).real
        inverse = np.linalg.pinv(basis)
        both = np.concatenate([index, mirrored])
        slopes = np.stack([time[:, None] * basis[:, [k]] * residues[k] for k in both], -1)  # (n, channels, poles)
        slopes = slopes - np.tensordot(basis, np.tensordot(inverse, slopes, 1), 1)
        changes = np.linalg.pinv(slopes.reshape(-1, len(both)))[: len(index)]
        if not last:
            before, delta = float(np.sum(left**2)), changes @ left.ravel()
            tried = poles.copy()
            tried[index] += delta
            tried[mirrored] = tried[index].conj()
            after = np.exp(tried * (time[:, None] - np.where(tried.real > 0.0, time[-1], 0.0)))
            rest = data - after @ np.linalg.lstsq(after, data.astype(complex), rcond=None)[0]
            moved = tried if float(np.sum(np.abs(rest) ** 2)) <= before else poles
        freedom = max(1, len(time) - 2 * len(both))
        spread = np.tile(np.sqrt(np.sum(left**2, axis=0) / freedom), len(time))
    widths = {}
    for k, change in zip(index.tolist(), changes, strict=True):
        s, size = moved[k], abs(moved[k])
        frequency = (s.conjugate() * change).real / size
        damping = -change.real / size + s.real * frequency / size**2
        sigma = [float(np.sqrt(np.sum((row * spread) ** 2))) for row in (frequency / (2 * np.pi), damping)]
        widths[k] = (1.96 * sigma[0], 1.96 * sigma[1])
    return moved, widths


def log_decrement(channel: np.ndarray, step: float, frequency: float, band: float, guess: float) -> float:
    """Damping ratio from the envelope of a band around the mode, over two time constants or what there is."""
    edges = np.array([frequency - band, frequency + band]) * 2 * step
    if not (0.0 < edges[0] < edges[1] < 1.0) or band < 3 * guess * frequency:
        return float("nan")
    padded = np.concatenate([np.zeros(len(channel)), channel, np.zeros(len(channel))])
    filtered = signal.sosfiltfilt(signal.butter(2, edges, "bandpass", output="sos"), padded)
    envelope = np.abs(signal.hilbert(filtered))[len(channel) : 2 * len(channel)]
    first = int(np.ceil(0.5 / band / step))
    last = int(min(len(channel) - first, first + 2.0 / max(guess * 2 * np.pi * frequency, 1e-9) / step))
    if last - first < 8:
        return float("nan")
    time = step * np.arange(first, last)
    slope = np.polyfit(time, np.log(np.maximum(envelope[first:last], 1e-300)), 1)[0]
    return float(-slope / (2 * np.pi * frequency))


def check_hammer(modes: list[Mode], signals: Signals, axis: str, quantity: str) -> str:
    """Return a sentence about the phases of the drive point, empty where they are 0; raise InputError.

    axis: of the hammer's force, one of the channels; quantity: of POWER. Signs, another quantity and a force that is
    not sampled with the motion show as phases; the delay is the least that explains all of them.
    """
    if signals.force is None or axis not in signals.names:
        raise InputError("--hammer", f"needs the columns force_n and {axis}: a hammer and the motion where it hits")
    if signals.drive not in ("", axis):
        raise InputError("--hammer", f"is {axis}, but the file states that the hammer hit {signals.drive}")
    if signals.quantity not in ("", quantity):
        raise InputError("--quantity", f"is {quantity}, but the file states {signals.quantity}")
    blow = float(np.abs(signals.force - np.median(signals.force)).max())
    blow_range = 5.0, 5e4  # [N] of a hammer; from the smallest for tool tips to a sledge hammer: assumed
    if not blow_range[0] < blow < blow_range[1]:
        raise InputError(
            "force_n", f"has a blow of {blow:.3g} N, allowed: {blow_range[0]:g} to {blow_range[1]:g} N: another unit?"
        )
    drive = signals.names.index(axis)
    omega = np.array([mode.pole.imag for mode in modes])
    phase = np.angle([2j * mode.residues[drive] / mode.pole ** POWER[quantity] for mode in modes])
    # phase of the drive point without a finding; the shape is off by 1 - sqrt(cos 10 deg) = 0.8 %
    small_phase = math.radians(10)
    sure = np.maximum(small_phase, 3.0 / np.array([mode.clear for mode in modes]))
    if np.all(np.abs(phase) < sure):
        return ""
    listed = ", ".join(f"{np.degrees(a):.0f} deg at {m.frequency:.4g} Hz" for a, m in zip(phase, modes, strict=True))
    shown = f"the phase of the drive point must be 0, but is {listed}"
    most_phase = math.radians(30)  # phase of the drive point; the shape is then off by 7 %
    if np.all(np.abs(phase) < most_phase):
        return f"{shown}: the shapes may be off by {100 - 100 * float(np.sqrt(np.cos(phase)).min()):.0f} % or more"
    turns = {"the signs are wrong": 2} | {f"--quantity is {name}": p - POWER[quantity] for name, p in POWER.items()}
    causes = [text for text, turn in turns.items() if np.all(np.abs(_wrapped(phase - turn * np.pi / 2)) < 3 * sure)]
    tried = np.radians(sorted(range(-360, 361), key=abs)) / omega.max()
    fits = np.all(np.abs(_wrapped(phase[:, None] - np.outer(omega, tried))) < sure[:, None], axis=0)
    if fits.any():
        delay = float(tried[np.argmax(fits)])
        delay += float(omega @ _wrapped(phase - omega * delay) / (omega @ omega))
        causes.append(f"force_n is {1e3 * abs(delay):.2g} ms {'late' if delay > 0.0 else 'early'}")
    cause = " or ".join(causes) or f"force and motion do not begin together, or {axis} is not where the hammer hits"
    raise InputError("--hammer", f"{shown}: {cause}?")


def _wrapped(phase: np.ndarray) -> np.ndarray:
    """Phases [rad] in -pi to pi."""
    return (phase + np.pi) % (2 * np.pi) - np.pi


def by_hammer(modes: list[Mode], signals: Signals, axis: str, quantity: str = "displacement") -> np.ndarray:
    """(n, 6) [kg^-1/2]; axis: of the hammer's force, one of the channels; signals in SI units. Raises InputError."""
    check_hammer(modes, signals, axis, quantity)
    drive, shapes = signals.names.index(axis), []
    for mode in modes:
        residues = mode.residues / mode.pole ** POWER[quantity]
        share = 2j * mode.pole.imag * residues
        shapes.append(signals.along_axes(share.real / np.sqrt(float(share[drive].real))))
    return np.array(shapes)


def by_compliance(modes: list[Mode], signals: Signals, soft: np.ndarray) -> np.ndarray:
    """(n, 6) [kg^-1/2]; soft: compliance at the tool tip [m/N, rad/N, ...], (6, 6), in the axes of the signals.

    Raises InputError where a mode has no part in the compliance.
    """
    measured = [AXES.index(name) for name in signals.names if name in AXES[:3]]
    pairs = np.triu_indices(len(measured))
    directions = np.array([signals.along_axes(mode.shape) for mode in modes])
    softness = np.array([np.outer(psi, psi)[np.ix_(measured, measured)][pairs] for psi in directions])
    omega = 2 * np.pi * np.array([mode.frequency for mode in modes])
    target = soft[np.ix_(measured, measured)][pairs]
    squares, _ = nnls((softness / omega[:, None] ** 2).T / np.abs(target).max(), target / np.abs(target).max())
    if not np.all(squares > 0.0):
        lost = modes[int(np.argmin(squares))].frequency
        reason = f"the mode at {lost:.4g} Hz has no part in the compliance there: use a hammer, or --modes"
        raise InputError("--cell", reason)
    return np.sqrt(squares)[:, None] * directions


def tool_compliance(arm: PlacedArm, target: Trajectory) -> np.ndarray:
    """Compliance of the arm at the start of a path, workpiece axes, (6, 6).

    Without that of the tool: its spring moves no mass below the frequencies of the arm, and is no part of its modes.
    """
    bent = equilibrium(arm.arm, arm.mount, arm.joints(target)[0], gravity=arm.dynamics.gravity)
    return rotate_matrix(compliance(bent, arm.arm), arm.place.rotation.T)
