"""Force of a rigid tool against closed forms and quadratures of (26) to (29) that are written here."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from cuttings import ALUMINIUM, LAWS, PAPER_LAW
from scipy.integrate import quad

from kr270_milling.physics.cutting import AL7075_T6, Cut, Cutting, Stock, Tool

FEED = 0.125e-3  # [m] per tooth
DEPTH = 1e-3  # [m]


def paper_tool(**kwargs):
    return Tool(**{"diameter": 20e-3, "teeth": 4, "spindle_speed": 8000 * 2 * np.pi / 60, **kwargs})


def engaged(tool=None, cutting=None, low=-12e-3, high=12e-3, degrees=1.0, grid_step=10e-6):
    """A cut with the tool on y = 0, fully engaged in material from y = low to high; where it is, micro-steps so far."""
    stock = Stock(min=np.array([0.0, low, -5e-3]), max=np.array([20e-3, high, 0.0]), grid_step=grid_step)
    cut = Cut(tool or paper_tool(), cutting or PAPER_LAW, stock, np.radians(degrees))
    start, end = np.array([-10.1e-3, 0.0, -DEPTH]), np.array([-10.1e-3 + 48 * 4 * FEED / 2, 0.0, -DEPTH])
    cut.sweep(start, end, 0, 24 * cut.params.steps)
    return cut, end, 24 * cut.params.steps


def mean_force(cut, here, first, revolutions=4):
    feed = np.array([4 * FEED, 0.0, 0.0])
    return cut.sweep(here, here + revolutions * feed, first, revolutions * cut.params.steps)[:2]


def fractional(h):
    """(26) with k_0 for one millimetre of depth, (28): tangential and radial force [N] at DEPTH."""
    u = max(h, 0.0) / 18e-6
    tangential = 5e6 * 18e-6 * (u + 0.1 * u * u) / (1 + u) * DEPTH / 1e-3
    return tangential, 0.3 * tangential


def linear_edge(h):
    return ((600.46e6 * h + 17.9e3) * DEPTH, (180.96e6 * h + 20.42e3) * DEPTH) if h > 0 else (0.0, 0.0)


def quadrature(law, entry, exit, chip=lambda phi: FEED * np.cos(phi)):
    """Mean of (29) over a revolution of four equal teeth that cut from phi = entry to exit."""

    def component(phi, which):
        tangential, radial = law(chip(phi))
        x = -radial * np.cos(phi) + tangential * np.sin(phi)
        return x if which == 0 else radial * np.sin(phi) + tangential * np.cos(phi)

    return np.array([quad(component, entry, exit, args=(k,), limit=200)[0] * 4 / (2 * np.pi) for k in (0, 1)])


def surface(phi, teeth_radii, pitches, i):
    """Distance from the tool centre to the material's edge in the direction of tooth i at phi, before it cuts.

    The paths of the teeth ahead are points; each is looked up by its direction as seen from the present centre.
    """
    drift = 4 * FEED / (2 * np.pi)  # centre's way [m/rad]
    edge, lag = 0.0, 0.0
    for ahead in range(1, len(pitches) + 1):
        lag += pitches[(i + ahead - 1) % len(pitches)]
        psi = phi + np.linspace(-0.2, 0.2, 4001)
        x = -drift * (phi + lag - psi) + teeth_radii[(i + ahead) % len(pitches)] * np.cos(psi)
        y = teeth_radii[(i + ahead) % len(pitches)] * np.sin(psi)  # mirrored: counted in the sense of rotation
        edge = max(edge, np.interp(phi, np.arctan2(y, x), np.hypot(x, y)))
    return edge


@functools.cache
def exact_chip(phi, radii=(10e-3,) * 4, pitches=(np.pi / 2,) * 4, i=0):
    """A / (R dphi): the line of tooth i turns about its centre and drifts with it; dphi as seen from where it was."""
    rho, radius = surface(phi, radii, pitches, i), radii[i]
    drift = 4 * FEED / (2 * np.pi)
    return max(0.0, (radius**2 - rho**2) / 2 - drift * np.sin(phi) * (radius - rho)) / (radius - drift * np.sin(phi))


def test_rigid_slot_has_the_mean_force_of_the_fractional_law():
    expected = np.array([-44.39, 147.98])  # [N], 1 mm deep; and by the quadrature of this file
    assert quadrature(fractional, -np.pi / 2, np.pi / 2) == pytest.approx(expected, abs=0.01)
    assert mean_force(*engaged()) == pytest.approx(expected, rel=1e-2)  # but for terms of f_z / R
    exact = quadrature(fractional, -np.pi / 2 - 0.02, np.pi / 2 + 0.02, exact_chip)
    assert mean_force(*engaged()) == pytest.approx(exact, rel=3e-4)


def test_rigid_slot_has_the_mean_force_of_the_linear_edge_law():
    n, a = 4, 1.0  # teeth, depth [mm]; K in N/mm^2 and N/mm, f_z = 0.125 mm
    expected = [-n * a / 4 * 180.96 * 0.125 - n * a / np.pi * 20.42, n * a / 4 * 600.46 * 0.125 + n * a / np.pi * 17.9]
    drift = n * 0.125 / (2 * np.pi) / 10.0  # of the centre a radian, per R: h = f_z cos(phi) (1 + drift sin(phi)) ...
    expected[0] += n * a / (2 * np.pi) * 600.46 * 0.125 * drift * 2 / 3  # ... with the integral of cos sin^2, 2 / 3
    assert mean_force(*engaged(cutting=ALUMINIUM)) == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize(
    "low, high, entry, exit", [(-12e-3, 0.0, 0.0, np.pi / 2), (0.0, 12e-3, -np.pi / 2, 0.0)], ids=["down", "up"]
)
@pytest.mark.parametrize("law, name", [(fractional, "fractional"), (linear_edge, "linear_edge")])
def test_half_immersion_agrees_with_the_quadrature(low, high, entry, exit, law, name):
    found = mean_force(*engaged(cutting=LAWS[name], low=low, high=high))
    simple = quadrature(law, entry, exit)
    # h = f_z cos(phi) leaves out terms of f_z / R, which a half immersion does not average away
    assert found == pytest.approx(simple, abs=1e-2 * np.linalg.norm(simple))
    # the chip ends f_z / (2 R) past the quarter turn
    entry, exit = (entry, exit + 0.02) if low < 0 else (entry - 0.02, exit)
    phi = np.linspace(entry, exit, 751)[1:] - (exit - entry) / 1500
    forces = []
    for angle in phi:
        tangential, radial = law(exact_chip(angle))
        forces.append([-radial * np.cos(angle) + tangential * np.sin(angle)])
        forces[-1].append(radial * np.sin(angle) + tangential * np.cos(angle))
    exact = np.mean(forces, 0) * 4 * (exit - entry) / (2 * np.pi)
    # the edge force sets in with the first node: it misses about 1 deg of chips far thinner than one
    slack = 2e-3 if law is fractional else 7e-3
    assert found == pytest.approx(exact, abs=slack * np.linalg.norm(exact))


def test_runout_and_unequal_pitch_agree_with_the_quadrature():
    pitches = np.radians([80.0, 97.0, 88.0, 95.0])
    radii = 10e-3 + 1e-6 * np.array([12.0, -20.0, 5.0, 0.0])
    cut, here, first = engaged(paper_tool(pitch=pitches, runout=radii - 10e-3))
    found = mean_force(cut, here, first)
    phi = np.radians(np.arange(-91.75, 92.0, 0.5))
    total = np.zeros(2)
    for i in range(4):
        chips = np.array([exact_chip(angle, tuple(radii), tuple(pitches), i) for angle in phi])
        assert cut.state.chips[i] == pytest.approx(chips.max(), abs=10e-6)  # a node
        for angle, h in zip(phi, chips, strict=True):
            tangential, radial = fractional(h)
            total[0] += -radial * np.cos(angle) + tangential * np.sin(angle)
            total[1] += radial * np.sin(angle) + tangential * np.cos(angle)
    exact = total * np.radians(0.5) / (2 * np.pi)
    assert found == pytest.approx(exact, abs=3e-3 * np.linalg.norm(exact))
    assert np.ptp(cut.state.chips) > 20e-6


def test_counterclockwise_rotation_mirrors_the_cut():
    right, left = np.zeros((720, 3)), np.zeros((720, 3))
    for rotation, forces in (("clockwise", right), ("counterclockwise", left)):
        cut, here, first = engaged(paper_tool(rotation=rotation), low=-12e-3, high=12e-3)
        cut.sweep(here, here + [8 * FEED, 0.0, 0.0], first, 720, forces)
    assert left[:, 0] == pytest.approx(right[:, 0], rel=1e-6, abs=1e-6)
    assert left[:, 1] == pytest.approx(-right[:, 1], rel=1e-6, abs=1e-6)
    assert np.abs(right[:, 1]).max() > 100.0


def test_loss_of_contact_gives_exactly_zero():
    """A tool that backs off meets only ground that it has cleared."""
    cut, here, first = engaged()
    cut.sweep(here, here, first, 360)
    back = here - [2e-3, 0.0, 0.0]
    assert np.array_equal(cut.sweep(here, back, first + 360, 1440), np.zeros(6))
    assert np.array_equal(cut.sweep(back, here, first + 1800, 1440), np.zeros(6))
    assert cut.torque == 0.0 and not cut.state.chips.any()


def test_a_dwelling_tool_stops_cutting_after_one_pitch():
    cut, here, first = engaged()
    forces = np.zeros((360, 3))
    cut.sweep(here, here, first, 360, forces)
    assert forces[:89].any() and not forces[91:].any()


def test_tooth_out_of_cut_feels_no_force():
    """One tooth in a slot: no force while it stands behind the tool's axis."""
    cut, here, first = engaged(paper_tool(teeth=1))
    forces = np.zeros((360, 3))
    cut.sweep(here, here + [4 * FEED, 0.0, 0.0], first, 360, forces)
    assert not forces[95:265].any()
    assert forces[:85].any(1).all() and forces[275:].any(1).all()


def test_tool_above_or_beside_the_stock_feels_no_force():
    stock = Stock(min=np.array([0.0, 0.0, -5e-3]), max=np.array([20e-3, 20e-3, 0.0]))
    cut = Cut(paper_tool(), PAPER_LAW, stock, np.radians(1.0))
    assert not cut.sweep([-5e-3, 10e-3, 0.0], [25e-3, 10e-3, 1e-3], 0, 3600).any()
    assert not cut.sweep([-5e-3, 35e-3, -1e-3], [25e-3, 35e-3, -1e-3], 3600, 3600).any()
    assert cut.removed_area == 0.0 and cut.tiles == 0


def test_force_is_proportional_to_depth_and_stops_at_the_stock_s_bottom():
    found = []
    for depth in (1e-3, 2e-3, 5e-3, 8e-3):
        stock = Stock(min=np.array([0.0, -12e-3, -5e-3]), max=np.array([20e-3, 12e-3, 0.0]))
        cut = Cut(paper_tool(), PAPER_LAW, stock, np.radians(1.0))
        found.append(cut.sweep([-10e-3, 0, -depth], [-5e-3, 0, -depth], 0, 3600)[:2])
    assert found[1] == pytest.approx(2 * found[0], rel=1e-9)
    assert found[3] == pytest.approx(found[2], rel=1e-12)


def test_torque_is_the_tangential_force_times_the_radius():
    """With a tangential force K_tc h a_p alone, the work of spindle and feed is K_tc times the volume removed."""
    law = AL7075_T6.replace(tangential_edge=0.0, radial_cutting=0.0, radial_edge=0.0)
    cut, here, first = engaged(cutting=Cutting(law="linear_edge", linear_edge=law))
    before = cut.removed_volume
    force = mean_force(cut, here, first)
    energy = cut.torque * 4 * 2 * np.pi - force[0] * 16 * FEED
    assert energy == pytest.approx(600.46e6 * (cut.removed_volume - before), rel=1e-9)
