"""What the figures show and a pass does not hold by itself: micro-step forces, spectra."""

from __future__ import annotations

import numpy as np

from kr270_milling.cutting import Cut

__all__ = ["amplitude_spectrum", "micro_step_forces", "moving_mean", "thinned_spectrum"]


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
    ones = np.ones(max(1, min(window, values.size)))
    return np.convolve(values, ones, "same") / np.convolve(np.ones(values.size), ones, "same")


def amplitude_spectrum(values: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and single-sided amplitudes of values (n,) sampled every ``step`` [s].

    The mean is removed, the window is Hann's. A sine of amplitude a at a frequency of the list shows as a.
    """
    window = np.hanning(values.size + 1)[:-1]
    amplitude = np.abs(np.fft.rfft((values - values.mean()) * window)) * 2.0 / max(window.sum(), 1e-300)
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
