"""Checks of the cut: force laws (26)-(28), sum over the teeth (29), chips A_i / (R dphi), the sweep."""

from __future__ import annotations

import functools

import numpy as np
from book import check
from cuttings import LAWS, PAPER_LAW
from scipy.integrate import quad

from kr270_milling.cutting import AL7075_T6, Cut, Cutting, Stock, Tool
from kr270_milling.cutting.convergence import convergence

FEED, DEPTH = 0.125e-3, 1e-3  # [m] a tooth, [m]


def _tool() -> Tool:
    return Tool(diameter=20e-3, teeth=4, spindle_speed=8000 * 2 * np.pi / 60)


def _engaged(cutting: Cutting, low: float = -12e-3, high: float = 12e-3):
    """The paper's cutter on y = 0, fully engaged in material from y = low to high; where it is, micro-steps so far."""
    stock = Stock(min=np.array([0.0, low, -5e-3]), max=np.array([20e-3, high, 0.0]))
    cut = Cut(_tool(), cutting, stock, np.radians(1.0))
    end = np.array([-10.1e-3 + 96 * FEED, 0.0, -DEPTH])
    cut.sweep([-10.1e-3, 0.0, -DEPTH], end, 0, 24 * 360)
    return cut, end, 24 * 360


@functools.cache
def _mean(law: str, low: float = -12e-3, high: float = 12e-3) -> np.ndarray:
    """Mean force (2,) [N] over four revolutions."""
    cut, here, first = _engaged(LAWS[law], low, high)
    return cut.sweep(here, here + [16 * FEED, 0.0, 0.0], first, 4 * 360)[:2]


@check("force of one tooth at h = 0.125 mm, 1 mm deep", "(26), k_0 read per millimetre of depth [derived]", "N")
def test_one_tooth():
    return 133.3, PAPER_LAW.force_per_depth(FEED)[0] * DEPTH, 0.05


@check("radial over tangential force", "k_r of [Klimchik2012], section 6")
def test_radial():
    tangential, found = PAPER_LAW.force_per_depth(40e-6)
    return 0.3, found / tangential, 1e-12


@check(
    "rigid slot, fractional law, mean F_{axis}", "integral of (26)-(29), 4 teeth, 1 mm deep [derived]", "N",
    cases=("axis expected", [("x", -44.39), ("y", 147.98)]),
)  # fmt: skip
def test_slot_mean(axis, expected):
    return expected, _mean("fractional")["xy".index(axis)], 5e-3 * abs(expected)


@check(
    "rigid slot, linear-edge law, mean F_{axis}", "-+ N a (K f_z / 4 + K_e / pi), Al7075-T6", "N",
    cases=("axis cutting edge", [("x", -180.96, -20.42), ("y", 600.46, 17.9)]),
)  # fmt: skip
def test_linear_edge_slot_mean(axis, cutting, edge):
    """Coefficients [N/mm^2, N/mm] times 4 teeth, 1 mm and f_z / 4, 1 / pi."""
    expected = cutting * 0.125 + 4 / np.pi * edge
    return expected, _mean("linear_edge")["xy".index(axis)], 5e-3 * abs(expected)


WAYS = {"up": (0.0, 12e-3, -np.pi / 2, 0.0), "down": (-12e-3, 0.0, 0.0, np.pi / 2)}  # y [m], phi [rad]


@check(
    "half immersion, {way}-milling, mean F_{axis}", "quadrature of (26)-(29) with h = f_z cos(phi)", "N",
    cases=("way axis", [(way, axis) for way in WAYS for axis in "xy"]),
)  # fmt: skip
def test_half_immersion(way, axis):
    """h = f_z cos(phi) leaves out terms of f_z / R, 1.25 %, which a half immersion does not average away."""
    low, high, entry, leave = WAYS[way]

    def integrand(phi, which):
        tangential, radial = (DEPTH * float(f) for f in PAPER_LAW.force_per_depth(FEED * np.cos(phi)))
        if which == 0:
            return -radial * np.cos(phi) + tangential * np.sin(phi)
        return radial * np.sin(phi) + tangential * np.cos(phi)

    expected = [quad(integrand, entry, leave, args=(k,))[0] * 4 / (2 * np.pi) for k in (0, 1)]
    which = "xy".index(axis)
    return expected[which], _mean("fractional", low, high)[which], 0.0125 * np.hypot(*expected)


@check("removed area of a slot 10 mm long", "2 R L + pi R^2 / 2: the half disc at its end", "m^2")
def test_area():
    stock = Stock(min=np.array([0.0, -12e-3, -5e-3]), max=np.array([25e-3, 12e-3, 0.0]))
    cut = Cut(_tool(), PAPER_LAW, stock, np.radians(1.0))
    end = np.array([10e-3, 0.0, -DEPTH])
    cut.sweep([-10.1e-3, 0.0, -DEPTH], end, 0, 15000)
    cut.sweep(end, end, 15000, 360)  # so that every tooth reaches the end; scallops on the walls: 1e-9 m^2
    return 20e-3 * 10e-3 + np.pi / 2 * 1e-4, cut.removed_area, 0.2 * 10e-6 * (20e-3 + np.pi * 10e-3)


@check("work of the tangential force / (K_tc volume removed)", "energy: power is torque times spindle speed")
def test_work():
    law = AL7075_T6.replace(tangential_edge=0.0, radial_cutting=0.0, radial_edge=0.0)
    cut, here, first = _engaged(Cutting(law="linear_edge", linear_edge=law))
    before = cut.removed_volume
    cut.sweep(here, here + [16 * FEED, 0.0, 0.0], first, 4 * 360)
    energy = cut.power / cut.tool.spindle_speed * 4 * 2 * np.pi
    return 1.0, energy / (600.46e6 * (cut.removed_volume - before)), 1e-9


@check("force of a tool that backs off", "(27): no chip, no force", "N")
def test_backing_off():
    cut, here, first = _engaged(PAPER_LAW)
    cut.sweep(here, here, first, 360)
    return 0.0, np.abs(cut.sweep(here, here - [2e-3, 0.0, 0.0], first + 360, 1440)).max(), 0.0


@functools.cache
def _convergence() -> dict:
    return convergence(_tool(), PAPER_LAW)


@check("order of convergence in the grid step", "1.5: noise of the nodes along the border of a sector")
def test_grid_order():
    return 1.5, _convergence()["grid_order"], 0.4


@check("order of convergence in the angle step", "2: force at mid-angle")
def test_angle_order():
    return 2.0, _convergence()["angle_order"], 0.4
