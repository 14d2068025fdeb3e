"""What ``identify damping`` says: numbers for JSON, a parameter file to include, pictures."""

from __future__ import annotations

import numpy as np

from kr270_milling.identification.modes import Mode
from kr270_milling.identification.outcome import Outcome, points
from kr270_milling.identification.signals import Signals

__all__ = ["mode_outcome"]

TOGETHER = 0.2  #: relative difference of both damping ratios up to which they confirm each other


COLUMNS = ("mode", "[Hz]", "damping [%]", "by decrement", "energy [%]", "shape x y z rx ry rz")


def mode_outcome(modes: list[Mode], signals: Signals, shapes: np.ndarray | None, title: str) -> Outcome:
    """Everything that ``identify damping`` says; shapes: mass-normalised ones, (n, 6), if there are any."""
    result = _as_dict(modes, signals, shapes)
    said = [f"{result['duration_s']:.3g} s at {result['samples_per_s']:.4g} samples a second"]
    if not all(mode["confirmed"] for mode in result["modes"]):
        said.append("the decrement does not confirm each damping ratio: modes are near each other, or ring too briefly")
    if shapes is None:
        said.append("the shapes are not scaled: a hammer (--hammer) or the compliance of a cell (--cell) does it")
    rows = []
    for i, mode in enumerate(result["modes"], 1):
        ratios = [f"{100 * mode[key]:.2f}" for key in ("damping_ratio", "damping_ratio_log_decrement")]
        shape = " ".join(f"{v:.2f}" for v in mode["shape"])
        rows.append([str(i), f"{mode['frequency_hz']:.3f}", *ratios, f"{100 * mode['share_of_energy']:.0f}", shape])
    use = "name this file in `includes`, or copy what you need"
    sections = _include_sections(modes, shapes)
    return Outcome("modes", title, result, [(title, COLUMNS, rows)], said, lambda: _figures(signals), sections, use)


def _as_dict(modes: list[Mode], signals: Signals, shapes: np.ndarray | None) -> dict:
    """For JSON; shapes: mass-normalised ones, (n, 6)."""
    rows = [
        {
            "frequency_hz": mode.frequency,
            "damping_ratio": mode.damping_ratio,
            "damping_ratio_log_decrement": mode.decrement,
            "confirmed": bool(abs(mode.decrement / mode.damping_ratio - 1.0) < TOGETHER),
            "shape": signals.along_axes(mode.shape).tolist(),
            "share_of_energy": mode.share,
        }
        for mode in modes
    ]
    for row, shape in zip(rows, () if shapes is None else shapes.tolist(), strict=False):
        row["mass_normalised_shape"] = shape
    duration = len(signals.values) * signals.step
    return {"modes": rows, "duration_s": duration, "samples_per_s": 1 / signals.step, "channels": list(signals.names)}


def _include_sections(modes: list[Mode], shapes: np.ndarray | None) -> dict:
    """``dynamics.modes`` of a parameter file with mass-normalised shapes (n, 6); without them one damping ratio."""
    if shapes is None:
        mean = sum(mode.share * mode.damping_ratio for mode in modes)
        return {"dynamics": {"damping_ratio": (float(mean), "mean over the modes, by energy")}}
    rows = [
        {
            "frequency_hz": mode.frequency,
            "damping_ratio": (mode.damping_ratio, f"logarithmic decrement {mode.decrement:.3g}"),
            "shape": shape.tolist(),
        }
        for mode, shape in zip(modes, shapes, strict=True)
    ]
    return {"dynamics": {"follow_pose": ("false", "modes are of one posture"), "modes": rows}}


def _figures(signals: Signals) -> list:
    """The signal and its spectrum."""
    time = signals.step * np.arange(len(signals.values))
    data = signals.values - signals.values.mean(0)
    frequency = np.fft.rfftfreq(len(data), signals.step)
    spectrum = np.abs(np.fft.rfft(data, axis=0)) * 2 / len(data)
    thin = slice(None, None, max(1, len(time) // 4000))
    shown = frequency < min(200.0, frequency[-1])
    by_channel = {name: (time[thin], data[thin, i]) for i, name in enumerate(signals.names)}
    spectra = {name: (frequency[shown], spectrum[shown, i]) for i, name in enumerate(signals.names)}
    return [
        points("Signal", "time [s]", "as recorded", by_channel, signals.names),
        points("Spectrum", "frequency [Hz]", "as recorded", spectra, signals.names),
    ]
