"""The mean force of a cutter of revolution beside a quadrature of its edge; volume, torque, undo, order."""

import itertools
import math

import numpy as np
import pytest
from budget import LONG
from samples.cuttings import fitted_order
from samples.tilted_cuts import (
    CUTTINGS,
    EDGE,
    FLAT,
    MICRO_STEP,
    RADIUS,
    SHARP,
    TEETH,
    TOOLS,
    VELOCITY,
    bore_error,
    error,
    measured,
    ramp_error,
    swept_widths,
)

from kr270_milling.physics.cutting import Cutting, EngagementCut, Stock, Tool

UPRIGHT = (0.0, 0.0)
DEPTHS = {"flat": 1e-3, "ball": 3e-3, "bull": 2e-3, "taper": 3e-3, "point": 4e-3}  # [m]
#: y of the material as shares of R; the tool turns clockwise and feeds along +x. 5 %: of the width that the tool cuts
IMMERSIONS = {"slot": (-1.1, 1.1), "70 % up": (-1.1, 0.4), "70 % down": (-0.4, 1.1), "30 % up": (-1.1, -0.4),
              "30 % down": (0.4, 1.1), "5 % up": (-1.1, -0.9), "5 % down": (0.9, 1.1)}  # fmt: skip


def cut_of(tool: Tool, cutting: Cutting, side: float = 1.5 * RADIUS) -> EngagementCut:
    stock = Stock(min=np.array([0.0, -side, -12e-3]), max=np.array([30e-3, side, 0.0]), grid_step=1e-4)
    return EngagementCut(tool, cutting, stock, MICRO_STEP)


@pytest.mark.parametrize("law", CUTTINGS)
@pytest.mark.parametrize("name", TOOLS)
def test_the_mean_force_is_that_of_the_quadrature_within_two_percent(name, law):
    """The usual suite takes each immersion of a tool with one of the laws."""
    immersions = list(IMMERSIONS.items())
    for immersion, shares in immersions if LONG else immersions[list(CUTTINGS).index(law) :: 3]:
        sides = np.multiply(shares, RADIUS)
        if "5 %" in immersion:
            inner = round(0.9 * swept_widths(TOOLS[name], DEPTHS[name], UPRIGHT)[1], 4)  # on the border of a cell
            sides = (-1.1 * RADIUS, -inner) if "up" in immersion else (inner, 1.1 * RADIUS)
        # 5 % of the width of a cone is three or four nodes of the map, whose columns end at the top of the stock
        most = 0.025 if name in ("taper", "point") and "5 %" in immersion else 0.02
        assert error(TOOLS[name], CUTTINGS[law], UPRIGHT, sides, DEPTHS[name]) < most, immersion


@pytest.mark.parametrize(("name", "k"), list(itertools.product(("flat", "ball", "bull", "taper"), range(3))))
def test_a_ramp_down_and_up_and_a_plunge_have_the_force_of_the_quadrature(name, k):
    """Each way with each tool, and with each law; the usual suite takes one law of each."""
    square = (k + list(TOOLS).index(name)) % 3
    for law in CUTTINGS if LONG else [list(CUTTINGS)[square]]:
        assert ramp_error(TOOLS[name], CUTTINGS[law], UPRIGHT, (3.0, -3.0, 90.0)[k]) < 0.02, law


@pytest.mark.parametrize("tool", [FLAT, *(TOOLS[name] for name in ("ball", "bull", "taper"))])
def test_the_mean_force_of_a_helical_bore_is_that_of_the_quadrature(tool):
    assert bore_error(tool, EDGE) < 0.02


@pytest.mark.parametrize("name", TOOLS)
def test_torque_times_angle_is_the_cutting_coefficient_times_the_volume_on_any_path(name):
    """Exactly: 1e-9, on a path that turns, sinks and rises; the lag moves work to a later step and keeps its sum."""
    cut, n, turn = cut_of(TOOLS[name], SHARP.replace(end_share=0.5)), 192, np.arange(150)
    path = np.column_stack([2e-4 * turn, 2e-3 * np.sin(turn / 9.0), -2e-3 + 1e-3 * np.sin(turn / 5.0)])
    path = np.vstack([path, path[-1] + [[0.0, 0.0, 20e-3]] * np.ones((60, 1))])
    _, torque, volume = cut.along(path, n * np.arange(len(path)))
    fresh = n * MICRO_STEP / (n * MICRO_STEP + math.pi / TEETH)
    assert volume.sum() == pytest.approx(cut.removed_volume, rel=1e-12)
    own = torque[1:] / fresh - (1.0 / fresh - 1.0) * torque[:-1]  # without the lag
    removed = SHARP.linear_edge.tangential_cutting * volume[1:]
    assert own * n * MICRO_STEP == pytest.approx(removed, rel=1e-9, abs=1e-9 * removed.max())


def test_the_part_of_a_ball_is_that_of_the_geometry_and_the_volume_its_groove():
    depth, cut = 1e-3, cut_of(TOOLS["ball"], EDGE)
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
        sides = np.multiply(IMMERSIONS[immersion], RADIUS)
        (flat, torque), (general, other) = (
            measured(tool, EDGE, UPRIGHT, sides, 1e-3, grid_step=5e-5)[0] for tool in (FLAT, TOOLS["flat"])
        )
        assert general == pytest.approx(flat, abs=0.005 * np.linalg.norm(flat))
        assert other == pytest.approx(torque, rel=0.005)


@pytest.mark.parametrize(("tool", "sinking"), [(FLAT, 0.0), (FLAT, 2e-5), (TOOLS["ball"], 5e-5)])
def test_a_step_taken_back_leaves_every_bit_of_the_state_and_the_next_step_unchanged(tool, sinking):
    cut, n = cut_of(tool, EDGE), 192
    path = np.column_stack([1e-3 + 2e-4 * np.arange(40), np.zeros(40), np.full(40, -1e-3)])
    cut.along(path, n * np.arange(40))
    end, used = path[-1] + [0.2e-3, 0.1e-3, -sinking], cut.tiles * 256**2

    def bits():
        state = cut.state
        maps = state.pool[:used], state.rest[:used], state.table
        return [values.tobytes() for values in (*maps, state.floats)]

    before, volume = bits(), cut.removed_volume
    first = cut.sweep(path[-1], end, 39 * n, n)
    assert cut.removed_volume > volume
    cut.restore()
    assert bits() == before
    assert np.array_equal(cut.sweep(path[-1], end, 39 * n, n), first)


def test_the_error_of_a_shallow_cut_falls_with_the_map_and_the_bins():
    """A ball 0.3 mm deep; edge forces included."""
    steps, bins, slot = [4e-4, 2e-4, 1e-4], [8, 16, 32], (-1.1 * RADIUS, 1.1 * RADIUS)
    shallow = [error(TOOLS["ball"], EDGE, UPRIGHT, slot, 0.3e-3, 1e-3, grid_step=step) for step in steps]
    assert fitted_order(steps, shallow) > 0.8
    assert error(TOOLS["ball"], EDGE, UPRIGHT, slot, 0.3e-3) < 0.02
    errors = [error(TOOLS["ball"], EDGE, UPRIGHT, (0.0, slot[1]), 3e-3, bins=count) for count in bins]
    assert errors[-1] < 0.01 < errors[0]
