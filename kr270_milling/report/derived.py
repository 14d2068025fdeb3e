"""What the figures show and a pass does not hold by itself: micro-step forces, slot walls, spectra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.cutting import Cut, Tool

__all__ = ["Walls", "amplitude_spectrum", "micro_step_forces", "moving_mean", "slot_walls", "thinned_spectrum"]


@dataclass(frozen=True, eq=False)
class Walls:
    """The two walls of a slot along x, left is +y."""

    x: np.ndarray  #: [m], (n,)
    left: np.ndarray  #: y of the wall [m], (n,)
    right: np.ndarray  #: [m], (n,)


def micro_step_forces(cut: Cut, tool: np.ndarray, micro_steps: int) -> np.ndarray:
    """Force [N], (n * micro_steps, 3), of every micro-step of a pass, by sweeping a fresh workpiece once more.

    tool: the positions (n + 1, 3) [m] that the cut was given, micro_steps: from one to the next.
    """
    periods = len(tool) - 1
    forces = np.zeros((periods, micro_steps, 3))
    for n in range(periods):
        cut.sweep(tool[n], tool[n + 1], n * micro_steps, micro_steps, forces[n])
    return forces.reshape(-1, 3)


def moving_mean(values: np.ndarray, window: int) -> np.ndarray:
    """Centred mean over ``window`` rows of values (n,), over what there is of them at the ends."""
    half = max(1, window) // 2
    total = np.concatenate([[0.0], np.cumsum(values)])
    low = np.maximum(np.arange(values.size) - half, 0)
    high = np.minimum(np.arange(values.size) + max(1, window) - half, values.size)
    return (total[high] - total[low]) / (high - low)


def slot_walls(time: np.ndarray, actual: np.ndarray, tool: Tool) -> Walls:
    """Walls that the teeth leave when the tool centre (n, 3) [m] moves along +x; time (n,) [s].

    Each tooth cuts the wall deepest when it passes +y or -y; what stays between two marks is a cusp of about
    f_z^2 / 8R. Points: every mark and every cusp.
    """
    marks = {side: _marks(time, actual, tool, side) for side in (1.0, -1.0)}
    x = marks[1.0][0]
    x = np.sort(np.concatenate([x, 0.5 * (x[1:] + x[:-1])]))
    left, right = (side * _outermost(x, *marks[side]) for side in (1.0, -1.0))
    return Walls(x, left, right)


def _marks(time: np.ndarray, actual: np.ndarray, tool: Tool, side: float) -> tuple[np.ndarray, ...]:
    """x, side * y of the centre and the radius [m] at each passage of a tooth by +y (side 1) or -y (-1)."""
    passages, radii = [], []
    for angle, radius in zip(tool.angles, tool.radii, strict=True):
        turn = (side * tool.sense * np.pi / 2 - angle) % (2 * np.pi)
        when = np.arange(turn / tool.spindle_speed, time[-1], 2 * np.pi / tool.spindle_speed)
        passages.append(when[when >= time[0]])
        radii.append(np.full(passages[-1].size, radius))
    when = np.concatenate(passages)
    order = np.argsort(when, kind="stable")
    when = when[order]
    x, y = np.interp(when, time, actual[:, 0]), np.interp(when, time, actual[:, 1])
    return x, side * y, np.concatenate(radii)[order]


def _outermost(x: np.ndarray, centre_x: np.ndarray, centre_y: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(n,): the farthest reach at each x of the teeth that passed nearby."""
    reach = np.full(x.size, -np.inf)
    if not centre_x.size:
        return reach
    nearest = np.clip(np.searchsorted(centre_x, x), 0, centre_x.size - 1)
    for offset in range(-4, 5):
        k = np.clip(nearest + offset, 0, centre_x.size - 1)
        squared = radius[k] ** 2 - (x - centre_x[k]) ** 2
        reach = np.maximum(reach, np.where(squared > 0, centre_y[k] + np.sqrt(np.maximum(squared, 0.0)), -np.inf))
    return reach


def amplitude_spectrum(values: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and single-sided amplitudes of values (n,) sampled every ``step`` [s].

    The mean is removed, the window is Hann's. A sine of amplitude a at a frequency of the list shows as a.
    """
    centred = values - values.mean()
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(values.size) / values.size)
    amplitude = np.abs(np.fft.rfft(centred * window)) * 2.0 / max(window.sum(), 1e-300)
    return np.fft.rfftfreq(values.size, step)[1:], amplitude[1:]


def thinned_spectrum(
    frequency: np.ndarray, amplitude: np.ndarray, high: float, bins: int = 500
) -> tuple[np.ndarray, np.ndarray]:
    """Up to ``high`` [Hz], the largest amplitude of each bin of a logarithmic axis: no line of the spectrum is lost."""
    inside = frequency <= high
    frequency, amplitude = frequency[inside], amplitude[inside]
    if frequency.size <= bins:
        return frequency, amplitude
    place = np.log(frequency / frequency[0]) / np.log(frequency[-1] / frequency[0])
    number = np.minimum((place * bins).astype(int), bins - 1)
    order = np.lexsort((-amplitude, number))
    first = order[np.unique(number[order], return_index=True)[1]]
    return frequency[first], amplitude[first]
