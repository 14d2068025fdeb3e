"""Modes from ring-downs and impacts of machines that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import eigh

from kr270_milling.base.errors import InputError
from kr270_milling.studies.identification.modes import NoModeError, by_compliance, by_hammer, find_modes
from kr270_milling.studies.identification.signals import Signals, read_signals

#: a milling robot as measured: 7.07 Hz (3.7 %), 10.3 Hz (2.2 %), 16.0 Hz (2.3 %) [shared facts of the project]
MEASURED = [(7.07, 0.037, [1.0, 0.2, 0.0]), (10.3, 0.022, [0.3, 1.0, 0.1]), (16.0, 0.023, [0.0, 0.4, 1.0])]


def ring_down(modes=MEASURED, noise=0.0, n=4000, step=5e-4) -> Signals:
    """Closed form: sum of exp(-zeta omega t) cos(omega_d t + phase)."""
    t = np.arange(n) * step
    y = np.zeros((n, 3))
    for f, zeta, shape in modes:
        omega = 2 * np.pi * f
        y += np.outer(np.exp(-zeta * omega * t) * np.cos(omega * np.sqrt(1 - zeta**2) * t + 0.3), shape)
    return Signals(step, y + noise * np.random.default_rng(2).normal(size=y.shape), ("x", "y", "z"))


@pytest.mark.parametrize(("noise", "rel"), [(0.0, 5e-4), (0.01, 5e-3), (0.05, 0.03)])
def test_a_ring_down_gives_frequencies_damping_and_shapes(noise, rel):
    result = find_modes(ring_down(noise=noise), 2.0, 50.0)
    assert [m.frequency for m in result] == pytest.approx([f for f, _, _ in MEASURED], rel=rel / 10 + 1e-5)
    assert [m.damping_ratio for m in result] == pytest.approx([z for _, z, _ in MEASURED], rel=rel)
    for mode, (_, _, shape) in zip(result, MEASURED, strict=True):
        assert mode.shape == pytest.approx(shape, abs=rel + 1e-3)


def test_the_decrement_confirms_the_rational_fit():
    for mode in find_modes(ring_down(noise=0.01), 2.0, 50.0):
        assert mode.decrement == pytest.approx(mode.damping_ratio, rel=0.1)


def test_an_impact_is_divided_by_the_hammer():
    n, step = 8000, 2.5e-4
    t = np.arange(n) * step
    hammer = np.where((t > 0.05) & (t < 0.054), 1000 * np.sin(np.pi * (t - 0.05) / 0.004), 0.0)
    response = np.zeros((n, 2))
    for f, zeta, shape in ((9.8, 0.05, [1.0, 0.3]), (11.9, 0.05, [-0.4, 1.0])):
        omega = 2 * np.pi * f
        impulse = np.exp(-zeta * omega * t) * np.sin(omega * np.sqrt(1 - zeta**2) * t)
        response += np.outer(np.convolve(hammer, impulse)[:n] * step, shape)
    response += 0.005 * np.abs(response).max() * np.random.default_rng(1).normal(size=response.shape)
    first, second = find_modes(Signals(step, response, ("x", "y"), hammer), 2.0, 60.0)
    assert (first.frequency, second.frequency) == (pytest.approx(9.8, rel=1e-3), pytest.approx(11.9, rel=1e-3))
    assert (first.damping_ratio, second.damping_ratio) == (pytest.approx(0.05, rel=0.01),) * 2
    assert first.shape == pytest.approx([1.0, 0.3], abs=5e-3) and second.shape == pytest.approx([-0.4, 1.0], abs=5e-3)


def test_noise_and_a_creep_do_not_ring():
    creep = Signals(1e-3, np.linspace(1.0, 0.0, 500)[:, None] ** 2, ("x",))
    with pytest.raises(NoModeError, match="nothing rings"):
        find_modes(creep, 5.0, 50.0)


def test_tables_are_read_and_refused_with_a_sentence(tmp_path):
    file = tmp_path / "ring.csv"
    ring = ring_down(n=400, step=5e-3)
    rows = [f"{i * ring.step},{x},{y},{z}" for i, (x, y, z) in enumerate(ring.values.tolist())]
    file.write_text("time_s,x,y,z\n" + "\n".join(rows) + "\n")
    assert read_signals(file).values == pytest.approx(ring.values, abs=1e-12)
    with pytest.raises(InputError, match="holds 5 samples"):
        read_signals(file).window(0.0, 0.025)
    file.write_text("time_s,x\n" + "\n".join(f"{t},0" for t in [*range(20), 500]) + "\n")
    with pytest.raises(InputError, match="has a gap"):
        read_signals(file)
    file.write_text("time_s,force_n\n0,1\n")
    with pytest.raises(InputError, match="none of the columns"):
        read_signals(file)


def test_a_uff_file_is_read(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    file, ring = tmp_path / "ring.uff", ring_down(n=400, step=5e-3)
    writer = pyuff.UFF(str(file))
    for i in range(3):
        data = {
            "type": 58, "func_type": 1, "rsp_node": 1, "rsp_dir": i + 1, "ref_node": 1, "ref_dir": 1,
            "data": ring.values[:, i], "x": np.arange(400) * ring.step, "abscissa_spacing": 1,
            "orddenom_spec_data_type": 0,
        }  # fmt: skip
        writer.write_sets(data, "add")
    read = read_signals(file)
    assert read.names == ("x", "y", "z") and read.values == pytest.approx(ring.values, abs=1e-9)


def test_a_hammer_scales_the_shapes_by_the_masses():
    """Two degrees of freedom with masses 500 and 300 kg at x and y; shapes of M and K by eigh, phi^T M phi = 1."""
    mass, stiff = np.diag([500.0, 300.0]), np.array([[2.2e6, -0.4e6], [-0.4e6, 1.6e6]])
    squared, phi = eigh(stiff, mass)
    n, step = 8000, 2.5e-4
    t = np.arange(n) * step
    hammer = np.where(t < 0.004, 2000 * np.sin(np.pi * t / 0.004), 0.0)
    response = np.zeros((n, 2))
    for omega, shape in zip(np.sqrt(squared), phi.T, strict=True):
        damped = omega * np.sqrt(1 - 0.03**2)
        impulse = shape[0] * np.exp(-0.03 * omega * t) * np.sin(damped * t) / damped
        response += np.outer(np.convolve(hammer, impulse)[:n] * step, shape)
    signals = Signals(step, response, ("x", "y"), hammer)
    shapes = by_hammer(find_modes(signals, 2.0, 60.0), signals, "x")
    for shape, true in zip(shapes, phi.T, strict=True):
        assert shape[:2] * np.sign(shape[0]) == pytest.approx(true * np.sign(true[0]), rel=0.02)
    accelerations = Signals(step, np.gradient(np.gradient(response, step, axis=0), step, axis=0), ("x", "y"), hammer)
    again = by_hammer(find_modes(accelerations, 2.0, 60.0), accelerations, "x", "acceleration")
    assert np.abs(again[:, :2]) == pytest.approx(np.abs(phi.T), rel=0.05)


def test_the_static_compliance_scales_the_shapes_where_there_was_no_hammer():
    """C = sum phi phi^T / omega^2 is the inverse of K."""
    mass, stiff = np.diag([500.0, 300.0]), np.array([[2.2e6, -0.4e6], [-0.4e6, 1.6e6]])
    squared, phi = eigh(stiff, mass)
    rings = [(w / (2 * np.pi), 0.03, [*(5.0 * v), 0.0]) for w, v in zip(np.sqrt(squared), phi.T, strict=True)]
    signals = ring_down(rings)
    soft = np.zeros((6, 6))
    soft[:2, :2] = np.linalg.inv(stiff)
    shapes = by_compliance(find_modes(signals, 2.0, 50.0), signals, soft)
    assert np.abs(shapes[:, :2]) == pytest.approx(np.abs(phi.T), rel=5e-3)
