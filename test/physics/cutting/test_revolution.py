"""The mean force of a cutter of revolution beside a quadrature of its edge; volume, torque, undo, order."""

import itertools
import math

import numpy as np
import pytest
from budget import LONG
from samples.cuttings import LAWS, fitted_order

from kr270_milling.physics.cutting import AL7075_T6, Cutting, EngagementCut, Stock, Tool

RADIUS, TEETH, FEED = 5e-3, 4, 0.125e-3  # [m]; feed per tooth
SPEED = 8000.0 * math.pi / 30.0  # [rad/s]
VELOCITY = FEED * TEETH * SPEED / (2.0 * math.pi)
MICRO_STEP = math.radians(1.0)
SHARP = Cutting("linear_edge", linear_edge=AL7075_T6.replace(tangential_edge=0.0, radial_edge=0.0))
AXIAL = Cutting("linear_edge", linear_edge=AL7075_T6.replace(axial_cutting=220e6, axial_edge=2e3))
CUTTINGS = {"sharp": SHARP, "edge": AXIAL, "fractional": LAWS["fractional"]}
FLAT = Tool(diameter=2 * RADIUS, teeth=TEETH, spindle_speed=SPEED)
TOOLS = {
    "flat": FLAT.replace(type="points", profile=np.array([RADIUS, 0.0])),
    "ball": FLAT.replace(type="ball"),
    "bull": FLAT.replace(type="bull_nose", corner_radius=1e-3),
    "taper": FLAT.replace(type="tapered", taper=math.radians(20.0), tip_diameter=4e-3),
    "point": FLAT.replace(type="tapered", taper=math.radians(45.0)),
}
DEPTHS = {"flat": 1e-3, "ball": 3e-3, "bull": 2e-3, "taper": 3e-3, "point": 4e-3}  # [m]
#: half of the width of a slot of that depth [m]
WIDTHS = {
    "flat": RADIUS,
    "ball": 4.58e-3,
    "bull": RADIUS,
    "taper": 2e-3 + 3e-3 * math.tan(math.radians(20.0)),
    "point": 4e-3,
}
#: y of the material as shares of R; the tool turns clockwise and feeds along +x. 5 %: of the width that the tool cuts
IMMERSIONS = {"slot": (-1.1, 1.1), "70 % up": (-1.1, 0.4), "70 % down": (-0.4, 1.1), "30 % up": (-1.1, -0.4),
              "30 % down": (0.4, 1.1), "5 % up": (-1.1, -0.9), "5 % down": (0.9, 1.1)}  # fmt: skip


def edge(tool: Tool, depth: float) -> tuple[np.ndarray, ...]:
    """Radius, height, kappa and length [m], [rad] of small pieces of the edge up to a height."""
    middle = (np.arange(1500) + 0.5) / 1500
    corner = {"ball": RADIUS, "bull_nose": tool.corner_radius}.get(tool.type, 0.0)
    tip = tool.tip_diameter / 2 if tool.type == "tapered" else RADIUS - corner
    rows = [(middle * tip, 0.0 * middle, 0.0 * middle, tip / 1500)]
    kappa = middle * math.pi / 2
    rows.append((tip + corner * np.sin(kappa), corner * (1 - np.cos(kappa)), kappa, corner * math.pi / 2 / 1500))
    top = corner
    if tool.type == "tapered":
        top = (RADIUS - tip) / math.tan(tool.taper)
        rows.append((tip + middle * (RADIUS - tip), middle * top, 0.0 * middle + math.pi / 2 - tool.taper,
                     math.hypot(top, RADIUS - tip) / 1500))  # fmt: skip
    rows.append((RADIUS + 0.0 * middle, top + 1e-2 * middle, 0.0 * middle + math.pi / 2, 1e-2 / 1500))
    table = np.concatenate([np.vstack([*row[:3], np.full(1500, row[3])]) for row in rows], axis=1)
    return tuple(column[:, None] for column in table[:, (table[1] < depth) & (table[3] > 0.0)])


def quadrature(tool: Tool, cutting: Cutting, depth, low: float, high: float, move, passes: float):
    """Mean force (3,) [N] and torque [N m] of all edges that meet material at a depth, or the mean over depths."""
    if np.ndim(depth):
        rows = [quadrature(tool, cutting, each, low, high, move, passes) for each in depth]
        return np.mean([row[0] for row in rows], axis=0), np.mean([row[1] for row in rows])
    r, _, kappa, length = edge(tool, depth)
    phi = ((np.arange(720) + 0.5) / 720 * 2.0 - 1.0) * math.pi  # from the feed to the left
    normal = move[0] * np.sin(kappa) * np.cos(phi) - move[2] * np.cos(kappa)
    y = r * np.sin(phi)
    cuts = (normal > 1e-12) & (y > low * RADIUS) & (y < high * RADIUS)
    f_t, f_r, f_a = np.where(cuts, cutting.active.per_depth(np.where(cuts, normal, 1e-9) / passes), 0.0)
    f_a = np.where(kappa == 0.0, 0.0, f_a)  # the force along an end edge is left out
    weight = TEETH / (2 * math.pi) * length * (2 * math.pi / phi.size)
    out, up = -f_r * np.sin(kappa) - f_a * np.cos(kappa), f_r * np.cos(kappa) - f_a * np.sin(kappa)
    x = weight * (out * np.cos(phi) + tool.sense * f_t * np.sin(phi))
    y = weight * (out * np.sin(phi) - tool.sense * f_t * np.cos(phi))
    return np.array([x.sum(), y.sum(), (weight * up).sum()]), float((weight * f_t * r).sum())


def cut_of(tool: Tool, cutting: Cutting, low: float, high: float, grid_step: float = 1e-4, bins: int = 72):
    stock = Stock(min=np.array([0.0, low * RADIUS, -12e-3]), max=np.array([30e-3, high * RADIUS, 0.0]),
                  grid_step=grid_step)  # fmt: skip
    return EngagementCut(tool, cutting, stock, MICRO_STEP, bins)


def measured(
    tool: Tool, cutting: Cutting, immersion=(-1.1, 1.1), depth=1e-3, slope=0.0, plunge=0.0, dt=4e-3, **options
):
    """Mean force and torque of the kernel and of the quadrature, where the tool is fully engaged.

    slope: of a ramp that sinks; plunge: speed of a straight way down [m/s].
    """
    n = round(SPEED * dt / MICRO_STEP)
    move = np.array([VELOCITY, 0.0, -slope * VELOCITY]) if not plunge else np.array([0.0, 0.0, -plunge])
    move *= n * MICRO_STEP / SPEED
    count = 60 if plunge else int(30e-3 / move[0])
    path = np.array([15e-3 if plunge else -RADIUS - 1e-3, 0.0, 0.0]) + np.arange(count)[:, None] * move
    chosen = np.arange(count) > 30 if plunge else (path[:, 0] > 11e-3) & (path[:, 0] < 19e-3)
    path[:, 2] += -depth - path[count - 1 if plunge else int(np.argmax(path[:, 0] > 15e-3)), 2]
    cut = cut_of(tool, cutting, *immersion, **options)
    wrench, torque, _ = cut.along(path, n * np.arange(count))
    ends = np.flatnonzero(chosen)[[0, -1]] - 0.75  # the middle of a step, and the lag of a quarter of a step
    depths = -np.interp(np.linspace(*ends, 9), np.arange(count), path[:, 2]) if slope or plunge else depth
    passes = n * MICRO_STEP * TEETH / (2 * math.pi)
    exact = quadrature(tool, cutting, depths, *immersion, move, passes)
    return (wrench[chosen, :3].mean(axis=0), torque[chosen].mean()), exact


def error(*arguments, **options) -> float:
    """Of the mean force, a share of its size."""
    (force, _), (exact, _) = measured(*arguments, **options)
    return float(np.abs(force - exact).max() / np.linalg.norm(exact))


@pytest.mark.parametrize("law", CUTTINGS)
@pytest.mark.parametrize("name", TOOLS)
def test_the_mean_force_is_that_of_the_quadrature_within_two_percent(name, law):
    for immersion, sides in IMMERSIONS.items():
        if "5 %" in immersion:
            inner = round(0.9 * WIDTHS[name], 4) / RADIUS  # on the border of a cell of the map
            sides = (-1.1, -inner) if "up" in immersion else (inner, 1.1)
        # 5 % of the width of a point is four nodes of the map wide, and their columns end at the top of the stock
        most = 0.025 if name == "point" and "5 %" in immersion else 0.02
        assert error(TOOLS[name], CUTTINGS[law], sides, DEPTHS[name]) < most, immersion


WAYS = [{"slope": math.tan(math.radians(3.0))}, {"slope": -math.tan(math.radians(3.0))}, {"plunge": 0.005}]


@pytest.mark.parametrize(("name", "k"), list(itertools.product(("ball", "bull", "taper"), range(3))))
def test_a_ramp_down_and_up_and_a_plunge_have_the_force_of_the_quadrature(name, k):
    """Each way with each tool, and with each law; the usual suite takes a Latin square of the 27."""
    dt = 1e-3 if name == "bull" else 4e-3  # its flat end passes the rim of the floor: 3 % at 4 ms, of first order
    square = (k + list(TOOLS).index(name)) % 3
    for law in CUTTINGS if LONG else [list(CUTTINGS)[square]]:
        cutting = CUTTINGS[law].replace(end_share=1.0)
        assert error(TOOLS[name], cutting, (-1.5, 1.5), DEPTHS[name], dt=dt, **WAYS[k]) < 0.02, law


@pytest.mark.parametrize("name", TOOLS)
def test_torque_times_angle_is_the_cutting_coefficient_times_the_volume_on_any_path(name):
    """Exactly: 1e-9, on a path that turns, sinks and rises; the lag moves work to a later step and keeps its sum."""
    cut, n, turn = cut_of(TOOLS[name], SHARP.replace(end_share=0.5), -1.5, 1.5), 192, np.arange(150)
    path = np.column_stack([2e-4 * turn, 2e-3 * np.sin(turn / 9.0), -2e-3 + 1e-3 * np.sin(turn / 5.0)])
    path = np.vstack([path, path[-1] + [[0.0, 0.0, 20e-3]] * np.ones((60, 1))])
    _, torque, volume = cut.along(path, n * np.arange(len(path)))
    fresh = n * MICRO_STEP / (n * MICRO_STEP + math.pi / TEETH)
    assert volume.sum() == pytest.approx(cut.removed_volume, rel=1e-12)
    own = torque[1:] / fresh - (1.0 / fresh - 1.0) * torque[:-1]  # without the lag
    removed = SHARP.linear_edge.tangential_cutting * volume[1:]
    assert own * n * MICRO_STEP == pytest.approx(removed, rel=1e-9, abs=1e-9 * removed.max())


def test_the_part_of_a_ball_is_that_of_the_geometry_and_the_volume_its_groove():
    depth, cut = 1e-3, cut_of(TOOLS["ball"], AXIAL, -1.1, 1.1)
    x = np.arange(-7e-3, 37e-3, VELOCITY * 4e-3)
    cut.along(np.column_stack([x, 0 * x, 0 * x - depth]), 192 * np.arange(x.size))
    _, y, z = cut.heights(low=(10e-3, -9e-3), high=(20e-3, 9e-3))
    groove = np.minimum(RADIUS - np.sqrt(np.maximum(RADIUS**2 - y**2, 0.0)) - depth, 0.0)
    assert np.abs(z - groove).max() < 2 * cut.params.level_step
    half = math.acos(1.0 - depth / RADIUS)
    area = RADIUS**2 * (half - math.sin(half) * math.cos(half))
    assert cut.removed_volume == pytest.approx(area * 30e-3, rel=0.002)


def test_a_flat_profile_has_the_force_of_the_kernel_of_flat_tools():
    for immersion in ("slot", "70 % up", "70 % down", "30 % down"):
        forces = [measured(tool, AXIAL, IMMERSIONS[immersion], grid_step=5e-5)[0] for tool in (FLAT, TOOLS["flat"])]
        (flat, torque), (general, other) = forces
        assert general == pytest.approx(flat, abs=0.005 * np.linalg.norm(flat))
        assert other == pytest.approx(torque, rel=0.005)


@pytest.mark.parametrize(("tool", "sinking"), [(FLAT, 0.0), (FLAT, 2e-5), (TOOLS["ball"], 5e-5)])
def test_a_step_taken_back_leaves_every_bit_of_the_state_and_the_next_step_unchanged(tool, sinking):
    cut, n = cut_of(tool, AXIAL, -1.1, 1.1), 192
    path = np.column_stack([1e-3 + 2e-4 * np.arange(40), np.zeros(40), np.full(40, -1e-3)])
    cut.along(path, n * np.arange(40))
    end, used = path[-1] + [0.2e-3, 0.1e-3, -sinking], cut.tiles * 256**2

    def bits():
        state = cut.state
        maps = state.pool[:used], state.rest[:used], state.table
        return [values.tobytes() for values in (*maps, state.floats, state.load, state.last)]

    before, volume = bits(), cut.removed_volume
    first = cut.sweep(path[-1], end, 39 * n, n)
    assert cut.removed_volume > volume
    cut.restore()
    assert bits() == before
    assert np.array_equal(cut.sweep(path[-1], end, 39 * n, n), first)


def test_the_error_of_a_shallow_cut_falls_with_the_map_and_the_bins():
    """A ball 0.3 mm deep; edge forces included."""
    steps, bins = [4e-4, 2e-4, 1e-4], [8, 16, 32]
    shallow = [error(TOOLS["ball"], AXIAL, depth=0.3e-3, dt=1e-3, grid_step=step) for step in steps]
    assert fitted_order(steps, shallow) > 0.8
    assert error(TOOLS["ball"], AXIAL, depth=0.3e-3) < 0.02
    errors = [error(TOOLS["ball"], AXIAL, (0.0, 1.1), 3e-3, bins=count) for count in bins]
    assert errors[-1] < 0.01 < errors[0]
