"""Force and wrench of a rigid tool, (26) to (29): closed forms, quadratures, integrals along lagging edges."""

import functools
import itertools
import math
from dataclasses import dataclass

import numpy as np
import pytest
from book import check
from samples.cuttings import ALUMINIUM, KLIMCHIK2014, LAWS, PAPER_LAW, convergence, slot_chip

from kr270_milling.base.errors import ConfigError, ParameterError
from kr270_milling.base.record import build, flatten
from kr270_milling.physics.cutting import AL7075_T6, Cut, Cutting, Stock, Tool, fractional
from kr270_milling.physics.cutting.laws import LinearEdgeLaw

FEED, DEPTH = 0.125e-3, 1e-3  # [m] a tooth, [m]
PAPER = Tool(diameter=20e-3, teeth=4, spindle_speed=8000 * 2 * np.pi / 60)
SLOT = (-np.pi / 2 - 0.02, np.pi / 2 + 0.02)  # [rad] from the feed; the chip ends f_z / (2 R) past the quarter


def block(low, high, length=20e-3, depth=5e-3, grid_step=10e-6) -> Stock:
    return Stock(min=np.array([0.0, low, -depth]), max=np.array([length, high, 0.0]), grid_step=grid_step)


def engaged(tool=PAPER, cutting=PAPER_LAW, low=-12e-3, high=12e-3):
    """A cut with the tool on y = 0, fully engaged in material from y = low to high; where it is, micro-steps so far."""
    cut = Cut(tool, cutting, block(low, high), np.radians(1.0))
    end = np.array([-10.1e-3 + 96 * FEED, 0.0, -DEPTH])
    cut.sweep([-10.1e-3, 0.0, -DEPTH], end, 0, 24 * 360)
    return cut, end, 24 * 360


@functools.cache
def mean(law: str, low: float = -12e-3, high: float = 12e-3) -> np.ndarray:
    """Mean force (2,) [N] over four revolutions."""
    cut, here, first = engaged(cutting=LAWS[law], low=low, high=high)
    return cut.sweep(here, here + [16 * FEED, 0.0, 0.0], first, 4 * 360)[:2]


def by_26(h):
    """(26) with k_0 for one millimetre of depth, (28): tangential and radial force [N] at DEPTH."""
    u = np.maximum(h, 0.0) / 18e-6
    tangential = 5e6 * 18e-6 * (u + 0.1 * u * u) / (1 + u) * DEPTH / 1e-3
    return tangential, 0.3 * tangential


def linear_edge(h):
    return (600.46e6 * h + 17.9e3) * DEPTH * (h > 0), (180.96e6 * h + 20.42e3) * DEPTH * (h > 0)


FORMULA = {"fractional": by_26, "linear_edge": linear_edge}


def components(law, phi, chips) -> np.ndarray:
    """F_x, F_y (29) of one clockwise tooth, (2, n)."""
    tangential, radial = law(chips)
    return np.array([-radial * np.cos(phi) + tangential * np.sin(phi), radial * np.sin(phi) + tangential * np.cos(phi)])


def integral(law: str, entry: float, leave: float) -> np.ndarray:
    """Mean of (29) over a revolution of four teeth, chips between two trochoids."""
    edges = np.linspace(entry, leave, 20001)
    phi = 0.5 * (edges[1:] + edges[:-1])
    return components(FORMULA[law], phi, slot_chip(PAPER, FEED, phi)).mean(axis=1) * (leave - entry) * 4 / (2 * np.pi)


# --- mean forces of the paper's cutter ---
@check("force of one tooth at h = 0.125 mm, 1 mm deep", "(26), k_0 read per millimetre of depth [derived]", "N")
def test_one_tooth():
    return 133.3, PAPER_LAW.force_per_depth(FEED)[0] * DEPTH, 0.05


#: y of the material [m], phi of a tooth in it [rad]
CUTS = {"slot": (-12e-3, 12e-3, *SLOT), "half up": (0.0, 12e-3, SLOT[0], 0.0), "half down": (-12e-3, 0.0, 0.0, SLOT[1])}


@check(
    "rigid tool, {law} law, {name}: mean F_{axis}", "quadrature of (26)-(29), 4 teeth, 1 mm deep, chips between two "
    "trochoids [derived]", "N",
    cases=("law name axis", [(law, name, axis) for law in FORMULA for name in CUTS for axis in "xy"]),
)  # fmt: skip
def test_mean_between_trochoids(law, name, axis):
    """The edge force sets in with the first node: at a wall it misses about 1 deg of chips far thinner than one."""
    low, high, entry, leave = CUTS[name]
    expected, which = integral(law, entry, leave), "xy".index(axis)
    if name == "slot":
        slack = (1e-4 if law == "fractional" else 3e-3) * abs(expected[which])
    else:
        slack = (2e-3 if law == "fractional" else 7e-3) * np.hypot(*expected)
    return expected[which], mean(law, low, high)[which], slack


def surface(phi, radii, pitches, i):
    """Distance from the tool centre to the material's edge in the direction of tooth i at phi, before it cuts.

    The paths of the teeth ahead are points; each is looked up by its direction as seen from the present centre.
    """
    drift = 4 * FEED / (2 * np.pi)  # centre's way [m/rad]
    edge, lag = 0.0, 0.0
    for ahead in range(1, len(pitches) + 1):
        lag += pitches[(i + ahead - 1) % len(pitches)]
        psi = phi + np.linspace(-0.2, 0.2, 4001)
        x = -drift * (phi + lag - psi) + radii[(i + ahead) % len(pitches)] * np.cos(psi)
        y = radii[(i + ahead) % len(pitches)] * np.sin(psi)  # mirrored: counted in the sense of rotation
        edge = max(edge, np.interp(phi, np.arctan2(y, x), np.hypot(x, y)))
    return edge


def test_runout_and_unequal_pitch_agree_with_the_quadrature():
    """A / (R dphi): the line of tooth i turns about its centre and drifts with it; dphi as seen from where it was."""
    pitches, radii = np.radians([80.0, 97.0, 88.0, 95.0]), 10e-3 + 1e-6 * np.array([12.0, -20.0, 5.0, 0.0])
    cut, here, first = engaged(PAPER.replace(pitch=pitches, runout=radii - 10e-3))
    obtained = cut.sweep(here, here + [16 * FEED, 0.0, 0.0], first, 4 * 360)[:2]
    phi, total = np.radians(np.arange(-91.75, 92.0, 0.5)), np.zeros(2)
    drift = 4 * FEED / (2 * np.pi) * np.sin(phi)
    for i, radius in enumerate(radii):
        rho = np.array([surface(angle, radii, pitches, i) for angle in phi])
        area = np.maximum(0.0, (radius**2 - rho**2) / 2 - drift * (radius - rho))
        chips = area / (radius - drift)
        assert cut.state.chips[i] == pytest.approx(chips.max(), abs=10e-6)  # a node
        total += components(by_26, phi, chips).sum(axis=1)
    exact = total * np.radians(0.5) / (2 * np.pi)
    assert obtained == pytest.approx(exact, abs=3e-3 * np.linalg.norm(exact))
    assert np.ptp(cut.state.chips) > 20e-6


# --- invariants ---
@check("work of the tangential force / (K_tc volume removed)", "energy: of the spindle, torque, and of the feed, force")
def test_work():
    law = AL7075_T6.replace(tangential_edge=0.0, radial_cutting=0.0, radial_edge=0.0)
    cut, here, first = engaged(cutting=Cutting(law="linear_edge", linear_edge=law))
    before = cut.removed_volume
    wrench = cut.sweep(here, here + [16 * FEED, 0.0, 0.0], first, 4 * 360)
    energy = cut.torque * 4 * 2 * np.pi - wrench[0] * 16 * FEED
    return 1.0, energy / (600.46e6 * (cut.removed_volume - before)), 1e-9


@check("force of a tool that backs off", "(27): no chip, no force", "N")
def test_backing_off():
    """A tool that backs off, and comes back, meets only ground that it has cleared; one that dwells after one pitch."""
    cut, here, first = engaged()
    forces, back = np.zeros((360, 3)), here - [2e-3, 0.0, 0.0]
    cut.sweep(here, here, first, 360, forces)
    assert forces[:89].any() and not forces[91:].any()
    ways = cut.sweep(here, back, first + 360, 1440), cut.sweep(back, here, first + 1800, 1440)
    assert cut.torque == 0.0 and not cut.state.chips.any()
    return 0.0, np.abs(ways).max(), 0.0


def test_counterclockwise_rotation_mirrors_the_cut_and_force_is_proportional_to_the_depth_down_to_the_bottom():
    right, left = np.zeros((720, 3)), np.zeros((720, 3))
    for rotation, forces in (("clockwise", right), ("counterclockwise", left)):
        cut, here, first = engaged(PAPER.replace(rotation=rotation))
        cut.sweep(here, here + [8 * FEED, 0.0, 0.0], first, 720, forces)
    assert left * [1, -1, 1] == pytest.approx(right, rel=1e-6, abs=1e-6) and np.abs(right[:, 1]).max() > 100.0
    obtained = []
    for depth in (1e-3, 2e-3, 5e-3, 8e-3):
        cut = Cut(PAPER, PAPER_LAW, block(-12e-3, 12e-3), np.radians(1.0))
        obtained.append(cut.sweep([-10e-3, 0, -depth], [-5e-3, 0, -depth], 0, 3600)[:2])
    assert obtained[1] == pytest.approx(2 * obtained[0], rel=1e-9)
    assert obtained[3] == pytest.approx(obtained[2], rel=1e-12)


# --- six components, a helix; [m], feed per tooth ---
TEETH, RADIUS, SMALL_FEED, DEEP = 4, 10e-3, 0.05e-3, 8e-3
LAW = AL7075_T6.replace(axial_cutting=220e6, axial_edge=5e3)
AXIAL = Cutting("linear_edge", linear_edge=LAW)
SHARP = Cutting("linear_edge", linear_edge=LAW.replace(tangential_edge=0.0, radial_edge=0.0, axial_edge=0.0))
TURN = 360  # micro-steps
IMMERSIONS = {  # y of the material as shares of R; phi of [Altintas2012] from +y clockwise, where a tooth cuts
    "slot": (-1.2, 1.2, 0.0, np.pi), "half up": (0.0, 1.2, 0.0, np.pi / 2), "half down": (-1.2, 0.0, np.pi / 2, np.pi),
    "quarter up": (0.5, 1.2, 0.0, np.pi / 3), "quarter down": (-1.2, -0.5, 2 * np.pi / 3, np.pi),
}  # fmt: skip


def helical(helix: float = 0.0, rotation: str = "clockwise") -> Tool:
    return Tool(diameter=2 * RADIUS, teeth=TEETH, spindle_speed=800.0, rotation=rotation, helix=math.radians(helix))


def deep(cutting, tool, low=-1.2, high=1.2):
    """A cut 8 mm deep that is fully engaged, where it is, and its next micro-step; fed along +x."""
    cut = Cut(tool, cutting, block(low * RADIUS, high * RADIUS, 14e-3, 10e-3, 2.5e-6), np.radians(1.0))
    turns = math.ceil(1.1 * RADIUS / SMALL_FEED / TEETH)
    start = np.array([-RADIUS, 0.0, -DEEP])
    here = start + [turns * TEETH * SMALL_FEED, 0.0, 0.0]
    cut.sweep(start, here, 0, turns * TURN)
    return cut, here, turns * TURN


def mean_wrench(cutting, tool, *wall):
    cut, here, first = deep(cutting, tool, *wall)
    return cut.sweep(here, here + [TEETH * SMALL_FEED, 0.0, 0.0], first, TURN), cut.torque


@functools.cache
def immersed(name: str, helix: float):
    return mean_wrench(AXIAL, helical(helix), *IMMERSIONS[name][:2])


def altintas(phi: float) -> np.ndarray:
    """F_x, F_y, F_z, M_z as antiderivatives in phi, per N a / (2 pi); clockwise: the spindle is turned back."""
    c, s, c2, s2 = np.cos(phi), np.sin(phi), np.cos(2 * phi), np.sin(2 * phi)
    x = SMALL_FEED / 4 * (LAW.tangential_cutting * c2 - LAW.radial_cutting * (2 * phi - s2))
    y = SMALL_FEED / 4 * (LAW.tangential_cutting * (2 * phi - s2) + LAW.radial_cutting * c2)
    x += -LAW.tangential_edge * s + LAW.radial_edge * c
    y += -LAW.tangential_edge * c - LAW.radial_edge * s
    z = LAW.axial_cutting * SMALL_FEED * c - LAW.axial_edge * phi
    return np.array([x, y, z, RADIUS * (-LAW.tangential_cutting * SMALL_FEED * c + LAW.tangential_edge * phi)])


@check("helix of {helix} deg, {name}: mean {component}", "closed form of [Altintas2012], chapter 2, linear-edge law",
       "N, N m", cases=("helix name component", [(helix, name, c) for helix in (0, 30) for name in IMMERSIONS
                                                 for c in ("F_x", "F_y", "F_z", "M_z")]))  # fmt: skip
def test_altintas(helix, name, component):
    """In the plane 1 % of the resultant; along the axis and about it 1 % of the value."""
    _, _, entry, leave = IMMERSIONS[name]
    expected = TEETH * DEEP / (2 * np.pi) * (altintas(leave) - altintas(entry))
    which = ("F_x", "F_y", "F_z", "M_z").index(component)
    obtained = immersed(name, helix)[0][[0, 1, 2, 5]]
    scale = np.hypot(*expected[:2]) if which < 2 else abs(expected[which])
    return expected[which], obtained[which], 0.01 * scale


def test_the_reaction_turns_against_the_teeth_a_helix_of_no_lag_changes_nothing_and_moments_may_be_left_out():
    for rotation, sign in (("clockwise", 1.0), ("counterclockwise", -1.0)):
        wrench, torque = mean_wrench(AXIAL, helical(rotation=rotation))
        assert torque > 0.0 and wrench[5] == pytest.approx(sign * torque, rel=1e-12)
    loads = [immersed("slot", helix)[0] for helix in (0, 1e-9, 1e-3)]
    np.testing.assert_allclose(loads[1], loads[0], rtol=1e-9)
    np.testing.assert_allclose(loads[2], loads[0], rtol=1e-3, atol=1e-4)
    torque = immersed("slot", 0)[1]
    without, same = mean_wrench(Cutting("linear_edge", linear_edge=LAW, moments=False), helical())
    np.testing.assert_array_equal(without, [*loads[0][:3], 0.0, 0.0, 0.0])
    assert torque == same


def edge_integral(cutter, law, phi):
    """F and M about the tip (n, 6) with tooth 0's tip at phi: integrals over the lagging edges, by Gauss' rule."""
    points, weights = np.polynomial.legendre.leggauss(40)
    z, dz = DEEP * (1 + points) / 2, DEEP * weights / 2
    teeth = 2 * np.pi / TEETH * np.arange(TEETH)
    angle = phi[:, None, None] + teeth[:, None] - z * np.tan(cutter.helix) / RADIUS
    h = slot_chip(cutter, SMALL_FEED, angle)
    f_t, f_r = law.force_per_depth(h)
    cosine, sine = np.cos(angle), np.sin(angle)
    force = np.stack([-f_r * cosine + f_t * sine, f_r * sine + f_t * cosine, -law.axial_per_depth(h)], -1)  # (29)
    arm = np.stack([RADIUS * cosine, -RADIUS * sine, np.broadcast_to(z, angle.shape)], -1)
    return np.einsum("ntzk,z->nk", np.concatenate([force, np.cross(arm, force)], -1), dz)


@pytest.mark.parametrize("helix", [0.0, 10.0, 30.0, 45.0])
def test_force_and_moment_of_each_micro_step_are_integrals_along_the_lagging_edges(helix):
    cutter = helical(helix)
    cut, here, first = deep(SHARP, cutter)
    obtained = np.zeros((TURN // 2, 6))
    for k in range(len(obtained)):
        ahead = here + [TEETH * SMALL_FEED / TURN, 0.0, 0.0]
        obtained[k] = cut.sweep(here, ahead, first + k, 1)
        here = ahead
    phi = cutter.start_angle + (first + np.arange(len(obtained)) + 0.5) * np.radians(1.0)
    expected = edge_integral(cutter, SHARP, phi)
    rms = np.sqrt(((obtained - expected) ** 2).mean(axis=0)) / np.abs(expected).max(axis=0)
    assert rms.max() < 0.015, rms


def test_a_sweep_is_taken_back_with_the_loads_that_it_left_to_later_micro_steps():
    cut, here, first = deep(AXIAL, helical(30.0))
    step = np.array([SMALL_FEED / 10, 0.0, 0.0])
    there = here + step
    once = cut.sweep(here, there, first, 12)
    cut.restore()
    np.testing.assert_array_equal(cut.sweep(here, there, first, 12), once)
    whole = cut.sweep(there, there + step, first + 12, 12)
    cut.restore()
    parts = [cut.sweep(there + k * step / 2, there + (k + 1) * step / 2, first + 12 + 6 * k, 6) for k in range(2)]
    np.testing.assert_allclose(np.mean(parts, axis=0), whole, rtol=1e-9)


# --- orders of convergence ---
converged = functools.cache(convergence)


@check("order of convergence in the grid step, {law} law", "1.5: noise of the nodes along the border of a sector",
       cases=("law", [(law,) for law in LAWS]))  # fmt: skip
def test_grid_order(law):
    return 1.5, converged(PAPER, LAWS[law])[0], 0.4


@check("order of convergence in the angle step, {law} law", "2: force at mid-angle",
       cases=("law", [(law,) for law in LAWS]))  # fmt: skip
def test_angle_order(law):
    _, order, largest_error = converged(PAPER, LAWS[law])
    assert largest_error < 2e-3
    return 2.0, order, 0.4


# --- force laws as functions of the chip thickness, and their coefficients in a file ---
def test_laws_have_their_slopes_no_force_without_a_chip_and_an_axial_force_by_coefficients_of_its_own():
    law = PAPER_LAW.fractional
    slope = [(fractional(h + d, 5e6, 18e-6, 0.1) - fractional(h, 5e6, 18e-6, 0.1)) / d for h, d in ((0, 1e-10), (1, 1))]
    assert slope == pytest.approx([law.stiffness / 1e-3, law.ratio * law.stiffness / 1e-3], rel=1e-4)
    for cutting, h in itertools.product((PAPER_LAW, ALUMINIUM), (0.0, -1e-6, -1.0)):
        assert cutting.force_per_depth(h) == (0.0, 0.0)
    steel = Cutting("linear_edge", linear_edge=AL7075_T6.replace(axial_cutting=220e6, axial_edge=1e3))
    assert steel.axial and not ALUMINIUM.axial and not PAPER_LAW.axial
    assert steel.axial_per_depth(1e-4) == pytest.approx(220e6 * 1e-4 + 1e3) and steel.axial_per_depth(0.0) == 0.0
    bent = Cutting(fractional=KLIMCHIK2014.replace(axial_ratio=0.4))
    assert bent.axial_per_depth(1e-4) == pytest.approx(0.4 * bent.force_per_depth(1e-4)[0])


LINEAR_EDGE = {"tangential_cutting_n_per_mm2": 700.0, "tangential_edge_n_per_mm": 17.9,
               "radial_cutting_n_per_mm2": 180.96, "radial_edge_n_per_mm": 20.42}  # fmt: skip
FRACTIONAL = {"stiffness_n_per_m": 5e6, "specific_chip_thickness_um": 18.0, "ratio": 0.1, "radial_ratio": 0.3}


def test_a_file_names_only_the_law_that_it_uses_and_all_coefficients_of_that_one():
    cutting = build(Cutting, {"law": "linear_edge", "linear_edge": LINEAR_EDGE})
    assert cutting.coefficients == pytest.approx([700e6, 17.9e3, 180.96e6, 20.42e3, 0.0, 0.0])
    assert build(Cutting, {"fractional": FRACTIONAL}).coefficients == pytest.approx([5e6, 18e-6, 0.1, 0.3, 0.0])
    axial = ("axial_cutting_n_per_mm2", "axial_edge_n_per_mm")
    assert {key for key in flatten(cutting) if "linear" in key} == {f"linear_edge.{k}" for k in (*LINEAR_EDGE, *axial)}
    assert {key for key in flatten(cutting) if "fractional" in key} == {"fractional.axial_ratio"}
    for law, coefficients in (("linear_edge", LINEAR_EDGE), ("fractional", FRACTIONAL)):
        for missing in coefficients:
            given = {key: value for key, value in coefficients.items() if key != missing}
            with pytest.raises(
                ConfigError, match=f"{law}.{missing}: has no value, it must be given where cutting.law is"
            ):
                build(Cutting, {"law": law, law: given})
        with pytest.raises(ConfigError, match="has no value"):
            build(Cutting, {"law": law})
        with pytest.raises(ParameterError, match="must be given"):
            Cutting(law)
    for tree in ({"fractional": {**FRACTIONAL, "ratio": math.nan}},  # which is no missing coefficient
                 {"fractional": FRACTIONAL, "linear_edge": {"radial_edge_n_per_mm": math.nan}}):  # fmt: skip
        with pytest.raises(ConfigError, match="nan is not usable"):
            build(Cutting, tree)


@dataclass(frozen=True, eq=False)
class Reordered(LinearEdgeLaw):
    """The linear-edge law, whose function takes the coefficients in another order than the fields have."""

    @staticmethod
    def force(h, axial_edge, axial_cutting, radial_edge, radial_cutting, tangential_edge, tangential_cutting):
        return (
            tangential_cutting * h + tangential_edge,
            radial_cutting * h + radial_edge,
            axial_cutting * h + axial_edge,
        )


def test_a_law_takes_its_coefficients_by_their_names_in_any_order():
    values, h = (600e6, 18e3, 180e6, 20e3, 220e6, 1e3), np.array([1e-6, 1e-4])
    assert Reordered.fault() == ""
    forces = Reordered(*values).per_depth(h)
    assert np.array_equal(forces, [600e6 * h + 18e3, 180e6 * h + 20e3, 220e6 * h + 1e3])
