"""Six components of the wrench: closed forms of the mean, integrals along lagging edges, invariants of the helix."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cuttings import ALUMINIUM, PAPER_LAW
from slot import slot_chip

from kr270_milling.physics.cutting import AL7075_T6, Cut, Cutting, Stock, Tool

TEETH, RADIUS, FEED, DEPTH = 4, 10e-3, 0.05e-3, 8e-3  # [m]; feed per tooth
LAW = AL7075_T6.replace(axial_cutting=220e6, axial_edge=5e3)
AXIAL = Cutting("linear_edge", linear_edge=LAW)
SHARP = Cutting("linear_edge", linear_edge=LAW.replace(tangential_edge=0.0, radial_edge=0.0, axial_edge=0.0))
TURN = 360  # micro-steps
IMMERSIONS = {  # y of the material as shares of R; phi of Altintas, from +y clockwise
    "slot": (-1.2, 1.2, 0.0, np.pi),
    "half up": (0.0, 1.2, 0.0, np.pi / 2),
    "half down": (-1.2, 0.0, np.pi / 2, np.pi),
    "quarter up": (0.5, 1.2, 0.0, np.pi / 3),
    "quarter down": (-1.2, -0.5, 2 * np.pi / 3, np.pi),
}


def tool(helix: float = 0.0, rotation: str = "clockwise") -> Tool:
    return Tool(
        diameter=2 * RADIUS, teeth=TEETH, spindle_speed=800.0, rotation=rotation, helix=math.radians(helix)
    )  # fmt: skip


def engaged(cutting, cutter, low=-1.2, high=1.2):
    """A cut that is fully engaged, where it is, and its next micro-step; fed along +x."""
    stock = Stock(
        min=np.array([0.0, low * RADIUS, -10e-3]), max=np.array([14e-3, high * RADIUS, 0.0]), grid_step=2.5e-6
    )  # fmt: skip
    cut = Cut(cutter, cutting, stock, np.radians(1.0))
    turns = math.ceil(1.1 * RADIUS / FEED / TEETH)
    start = np.array([-RADIUS, 0.0, -DEPTH])
    here = start + [turns * TEETH * FEED, 0.0, 0.0]
    cut.sweep(start, here, 0, turns * TURN)
    return cut, here, turns * TURN


def mean_wrench(cutting, cutter, *wall):
    cut, here, first = engaged(cutting, cutter, *wall)
    return cut.sweep(here, here + [TEETH * FEED, 0.0, 0.0], first, TURN), cut.torque


def altintas(start, end):
    """Mean F_x, F_y, F_a [N], torque [N m] of the linear-edge law, [Altintas, ch. 2]; engaged from phi start to end."""

    def at(phi):
        cos2, sin2 = np.cos(2 * phi), np.sin(2 * phi)
        x = FEED / 4 * (LAW.tangential_cutting * cos2 - LAW.radial_cutting * (2 * phi - sin2))
        x += -LAW.tangential_edge * np.sin(phi) + LAW.radial_edge * np.cos(phi)
        y = FEED / 4 * (LAW.tangential_cutting * (2 * phi - sin2) + LAW.radial_cutting * cos2)
        y += -LAW.tangential_edge * np.cos(phi) - LAW.radial_edge * np.sin(phi)
        a = -LAW.axial_cutting * FEED * np.cos(phi) + LAW.axial_edge * phi
        t = RADIUS * (-LAW.tangential_cutting * FEED * np.cos(phi) + LAW.tangential_edge * phi)
        return np.array([x, y, a, t])

    return TEETH * DEPTH / (2 * np.pi) * (at(end) - at(start))


@pytest.mark.parametrize("helix", [0.0, 30.0])
@pytest.mark.parametrize("name", IMMERSIONS)
def test_mean_forces_are_those_of_the_closed_forms_whatever_the_helix(name, helix):
    low, high, start, end = IMMERSIONS[name]
    wrench, torque = mean_wrench(AXIAL, tool(helix), low, high)
    x, y, a, t = altintas(start, end)
    np.testing.assert_allclose(wrench[:2], [x, y], atol=0.01 * np.hypot(x, y))
    assert wrench[2] == pytest.approx(-a, rel=0.01)
    assert torque == pytest.approx(t, rel=0.01)
    assert wrench[5] == pytest.approx(torque, rel=1e-12)  # teeth turn clockwise: the housing is turned the other way


@pytest.mark.parametrize("rotation, sign", [("clockwise", 1.0), ("counterclockwise", -1.0)])
def test_the_reaction_of_the_spindle_turns_against_the_teeth(rotation, sign):
    wrench, torque = mean_wrench(AXIAL, tool(rotation=rotation))
    assert torque > 0.0 and wrench[5] == pytest.approx(sign * torque, rel=1e-12)


def test_without_helix_the_forces_act_at_half_the_depth_and_at_the_teeth():
    """M_x = -z F_y and M_y = z F_x with z = a_p / 2, without an axial force."""
    wrench, _ = mean_wrench(ALUMINIUM, tool())
    np.testing.assert_allclose(wrench[3:5], DEPTH / 2 * np.array([-wrench[1], wrench[0]]), rtol=1e-4)


def test_an_axial_force_acts_where_the_teeth_are():
    """Teeth of a down-milling tool are at y < 0, those of an up-milling one at y > 0, in material from x = 0 on."""
    for name, side in (("half down", 1.0), ("half up", -1.0)):
        low, high, _, _ = IMMERSIONS[name]
        (with_it, _), (without, _) = (mean_wrench(law, tool(), low, high) for law in (AXIAL, ALUMINIUM))
        extra = with_it - without
        assert side * extra[3] > 0.3 * RADIUS * abs(extra[2])  # y F_z, F_z < 0
        assert extra[4] > 0.3 * RADIUS * abs(extra[2])  # -x F_z
        np.testing.assert_allclose(extra[[0, 1, 5]], 0.0, atol=1e-12)


def edge_integral(cutter, law, phi):
    """F and M about the tip (n, 6) with tooth 0's tip at phi: integrals over the lagging edges, by Gauss' rule."""
    points, weights = np.polynomial.legendre.leggauss(40)
    z, dz = DEPTH * (1 + points) / 2, DEPTH * weights / 2
    teeth = 2 * np.pi / TEETH * np.arange(TEETH)
    angle = phi[:, None, None] + teeth[:, None] - z * np.tan(cutter.helix) / RADIUS
    h = slot_chip(cutter, FEED, angle)
    f_t, f_r = law.force_per_depth(h)
    f_a = law.axial_per_depth(h)
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = -f_r * cosine + f_t * sine, f_r * sine + f_t * cosine  # (29), clockwise
    force = np.stack([x, y, -f_a], -1)
    arm = np.stack([RADIUS * cosine, -RADIUS * sine, np.broadcast_to(z, angle.shape)], -1)
    return np.einsum("ntzk,z->nk", np.concatenate([force, np.cross(arm, force)], -1), dz)


@pytest.mark.parametrize("helix", [0.0, 10.0, 30.0, 45.0])
def test_force_and_moment_of_each_micro_step_are_integrals_along_the_lagging_edges(helix):
    cutter = tool(helix)
    cut, here, first = engaged(SHARP, cutter)
    found = np.zeros((TURN // 2, 6))
    for k in range(len(found)):
        ahead = here + [TEETH * FEED / TURN, 0.0, 0.0]
        found[k] = cut.sweep(here, ahead, first + k, 1)
        here = ahead
    phi = cutter.start_angle + (first + np.arange(len(found)) + 0.5) * np.radians(1.0)
    expected = edge_integral(cutter, SHARP, phi)
    scale = np.abs(expected).max(axis=0)
    rms = np.sqrt(((found - expected) ** 2).mean(axis=0)) / scale
    assert rms.max() < 0.015, rms


def test_forces_are_constant_where_an_edge_ends_above_the_tip_of_the_next():
    """Depth = pitch R / tan(helix): some point of some edge is at every angle all the time."""
    helix = math.degrees(math.atan(2 * np.pi / TEETH * RADIUS / DEPTH))
    forces = {}
    for angle in (0.0, helix):
        cutter = tool(angle)
        cut, here, first = engaged(PAPER_LAW, cutter)
        forces[angle] = np.zeros((TURN, 3))
        cut.sweep(here, here + [TEETH * FEED, 0.0, 0.0], first, TURN, forces[angle])
    straight, constant = (f[:, :2].std(axis=0).max() for f in forces.values())
    assert constant < 0.03 * straight


def test_a_helix_that_lags_by_next_to_nothing_changes_next_to_nothing():
    loads = [mean_wrench(AXIAL, tool(helix))[0] for helix in (0.0, 1e-9, 1e-3)]
    np.testing.assert_allclose(loads[1], loads[0], rtol=1e-9)
    np.testing.assert_allclose(loads[2], loads[0], rtol=1e-3, atol=1e-4)


def test_a_sweep_is_taken_back_with_the_loads_that_it_left_to_later_micro_steps():
    cutter = tool(30.0)
    cut, here, first = engaged(AXIAL, cutter)
    there = here + [FEED / 10, 0.0, 0.0]
    once = cut.sweep(here, there, first, 12)
    cut.restore()
    np.testing.assert_array_equal(cut.sweep(here, there, first, 12), once)
    whole = cut.sweep(there, there + [FEED / 10, 0.0, 0.0], first + 12, 12)
    cut.restore()
    parts = [cut.sweep(there + [k * FEED / 20, 0, 0], there + [(k + 1) * FEED / 20, 0, 0], first + 12 + 6 * k, 6)
             for k in range(2)]  # fmt: skip
    np.testing.assert_allclose(np.mean(parts, axis=0), whole, rtol=1e-9)


def test_forces_only_are_what_the_paper_sums_up():
    plain = Cutting("linear_edge", linear_edge=LAW, moments=False)
    (with_moments, torque), (without, same) = (mean_wrench(law, tool()) for law in (AXIAL, plain))
    np.testing.assert_array_equal(without, [*with_moments[:3], 0.0, 0.0, 0.0])
    assert torque == same
