"""Checks of the cut: force laws (26)-(28), sum over the teeth (29), chips A_i / (R dphi), the sweep."""

from __future__ import annotations

import functools

import numpy as np
from book import check
from cuttings import LAWS, PAPER_LAW
from scipy.integrate import quad
from scipy.optimize import brentq
from slot import convergence

from kr270_milling.physics.cutting import AL7075_T6, Cut, Cutting, Stock, Tool

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


@check("radial over tangential force", "k_r of [Klimchik2014], section 6")
def test_radial():
    tangential, found = PAPER_LAW.force_per_depth(40e-6)
    return 0.3, found / tangential, 1e-12


def _components(phi: float, h: float) -> np.ndarray:
    """F_x, F_y (29) of one tooth by the paper's law at DEPTH."""
    tangential, radial = (DEPTH * float(f) for f in PAPER_LAW.force_per_depth(h))
    x = -radial * np.cos(phi) + tangential * np.sin(phi)
    return np.array([x, radial * np.sin(phi) + tangential * np.cos(phi)])


def _integral(chip, entry: float, leave: float) -> np.ndarray:
    """Mean of (29) over a revolution of four teeth with chips chip(phi) from entry to leave."""
    return np.array(
        [quad(lambda p, k=k: _components(p, chip(p))[k], entry, leave)[0] * 4 / (2 * np.pi) for k in (0, 1)]
    )


def _between_trochoids(phi: float) -> float:
    """h = A / (R dphi + d . t) of a tooth at phi: its line sweeps what the path of the tip ahead has left of it.

    The centre goes c = 4 f_z / (2 pi) a radian. When it was s radians back, the tip ahead stood at phi + pi / 2 - s; it
    lay in the direction phi of the present centre, at the distance rho.
    """
    c, radius = 4 * FEED / (2 * np.pi), 10e-3

    def tip(s: float) -> np.ndarray:
        return radius * np.array([np.cos(phi + np.pi / 2 - s), np.sin(phi + np.pi / 2 - s)]) - [c * s, 0.0]

    back = brentq(lambda s: float(np.cross(tip(s), [np.cos(phi), np.sin(phi)])), np.pi / 2 - 0.2, np.pi / 2 + 0.2)
    rho = np.hypot(*tip(back))
    area = (radius**2 - rho**2) / 2 - c * np.sin(phi) * (radius - rho)
    return max(0.0, area / (radius - c * np.sin(phi)))


@check(
    "rigid slot, fractional law, mean F_{axis}", "integral of (26)-(29), 4 teeth, 1 mm deep, h = f_z cos(phi) but for "
    "terms of f_z / R [derived]", "N",
    cases=("axis expected", [("x", -44.39), ("y", 147.98)]),
)  # fmt: skip
def test_slot_mean(axis, expected):
    return expected, _mean("fractional")["xy".index(axis)], 1e-2 * abs(expected)  # 0.84 and 0.03 % by the next check


@check(
    "rigid slot, fractional law, mean F_{axis}, exact chips", "the same integral with the chips between two trochoids "
    "[derived]", "N", cases=("axis", [("x",), ("y",)]),
)  # fmt: skip
def test_slot_mean_between_trochoids(axis):
    expected = _integral(_between_trochoids, -np.pi / 2 - 0.02, np.pi / 2 + 0.02)["xy".index(axis)]
    return expected, _mean("fractional")["xy".index(axis)], 1e-4 * abs(expected)


@check(
    "rigid slot, linear-edge law, mean F_{axis}", "-+ N a (K f_z / 4 + K_e / pi), Al7075-T6", "N",
    cases=("axis cutting edge", [("x", -180.96, -20.42), ("y", 600.46, 17.9)]),
)  # fmt: skip
def test_linear_edge_slot_mean(axis, cutting, edge):
    """Coefficients [N/mm^2, N/mm] times 4 teeth, 1 mm and f_z / 4, 1 / pi; terms of f_z / R are left out."""
    expected = cutting * 0.125 + 4 / np.pi * edge
    return expected, _mean("linear_edge")["xy".index(axis)], 1e-2 * abs(expected)


WAYS = {"up": (0.0, 12e-3, -np.pi / 2, 0.0), "down": (-12e-3, 0.0, 0.0, np.pi / 2)}  # y [m], phi [rad]


@check(
    "half immersion, {way}-milling, mean F_{axis}", "quadrature of (26)-(29) with h = f_z cos(phi)", "N",
    cases=("way axis", [(way, axis) for way in WAYS for axis in "xy"]),
)  # fmt: skip
def test_half_immersion(way, axis):
    """h = f_z cos(phi) leaves out terms of f_z / R, 1.25 %, which a half immersion does not average away."""
    low, high, entry, leave = WAYS[way]
    expected = _integral(lambda phi: FEED * np.cos(phi), entry, leave)
    which = "xy".index(axis)
    return expected[which], _mean("fractional", low, high)[which], 0.0125 * np.hypot(*expected)


AXIAL = AL7075_T6.replace(axial_cutting=220e6, axial_edge=5e3)
IMMERSIONS = {  # y of the material in mm; phi of [Altintas2012] from +y clockwise, where a tooth enters and leaves
    "slot": (-12.0, 12.0, 0.0, np.pi),
    "half up": (0.0, 12.0, 0.0, np.pi / 2),
    "half down": (-12.0, 0.0, np.pi / 2, np.pi),
    "quarter up": (5.0, 12.0, 0.0, np.pi / 3),
    "quarter down": (-12.0, -5.0, 2 * np.pi / 3, np.pi),
}
SMALL_FEED = 0.05e-3  # [m] a tooth: the closed forms leave out terms of f_z / R


@functools.cache
def _helical_mean(name: str) -> np.ndarray:
    """Mean wrench (6,) over a revolution of a cutter with 30 deg of helix, fully engaged, 8 mm deep."""
    low, high, _, _ = IMMERSIONS[name]
    stock = Stock(min=np.array([0.0, low, -10.0]) * 1e-3, max=np.array([14.0, high, 0.0]) * 1e-3, grid_step=2.5e-6)
    tool = _tool().replace(helix=np.radians(30.0))
    cut = Cut(tool, Cutting("linear_edge", linear_edge=AXIAL), stock, np.radians(1.0))
    start, turn = np.array([-10e-3, 0.0, -8e-3]), np.array([4 * SMALL_FEED, 0.0, 0.0])
    cut.sweep(start, start + 55 * turn, 0, 55 * 360)
    return cut.sweep(start + 55 * turn, start + 56 * turn, 55 * 360, 360)


def _altintas(phi: float) -> np.ndarray:
    """F_x, F_y, F_z, M_z as antiderivatives in phi, per N a / (2 pi); clockwise: the spindle is turned back."""
    law, c, s, c2, s2 = AXIAL, np.cos(phi), np.sin(phi), np.cos(2 * phi), np.sin(2 * phi)
    x = SMALL_FEED / 4 * (law.tangential_cutting * c2 - law.radial_cutting * (2 * phi - s2))
    y = SMALL_FEED / 4 * (law.tangential_cutting * (2 * phi - s2) + law.radial_cutting * c2)
    x += -law.tangential_edge * s + law.radial_edge * c
    y += -law.tangential_edge * c - law.radial_edge * s
    z = law.axial_cutting * SMALL_FEED * c - law.axial_edge * phi
    torque = 10e-3 * (-law.tangential_cutting * SMALL_FEED * c + law.tangential_edge * phi)
    return np.array([x, y, z, torque])


@check(
    "helix of 30 deg, {name}: mean {component}", "closed form of [Altintas2012], chapter 2, linear-edge law", "N, N m",
    cases=("name component", [(name, c) for name in IMMERSIONS for c in ("F_x", "F_y", "F_z", "M_z")]),
)  # fmt: skip
def test_altintas(name, component):
    """In the plane 1 % of the resultant; along the axis and about it 1 % of the value."""
    _, _, entry, leave = IMMERSIONS[name]
    expected = 4 * 8e-3 / (2 * np.pi) * (_altintas(leave) - _altintas(entry))
    which = ("F_x", "F_y", "F_z", "M_z").index(component)
    found = _helical_mean(name)[[0, 1, 2, 5]]
    scale = np.hypot(*expected[:2]) if which < 2 else abs(expected[which])
    return expected[which], found[which], 0.01 * scale


@check("removed area of a slot 10 mm long", "2 R L + pi R^2 / 2: the half disc at its end", "m^2")
def test_area():
    stock = Stock(min=np.array([0.0, -12e-3, -5e-3]), max=np.array([25e-3, 12e-3, 0.0]))
    cut = Cut(_tool(), PAPER_LAW, stock, np.radians(1.0))
    end = np.array([10e-3, 0.0, -DEPTH])
    cut.sweep([-10.1e-3, 0.0, -DEPTH], end, 0, 15000)
    cut.sweep(end, end, 15000, 360)  # so that every tooth reaches the end; scallops on the walls: 1e-9 m^2
    return 20e-3 * 10e-3 + np.pi / 2 * 1e-4, cut.removed_area, 0.2 * 10e-6 * (20e-3 + np.pi * 10e-3)


@check("work of the tangential force / (K_tc volume removed)", "energy: of the spindle, torque, and of the feed, force")
def test_work():
    law = AL7075_T6.replace(tangential_edge=0.0, radial_cutting=0.0, radial_edge=0.0)
    cut, here, first = _engaged(Cutting(law="linear_edge", linear_edge=law))
    before = cut.removed_volume
    wrench = cut.sweep(here, here + [16 * FEED, 0.0, 0.0], first, 4 * 360)
    energy = cut.torque * 4 * 2 * np.pi - wrench[0] * 16 * FEED
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
