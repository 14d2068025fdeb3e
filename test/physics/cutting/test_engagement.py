"""The mean-force model: closed forms of the mean, volume, undo, convergence, and the sweep of the teeth beside it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from samples.cuttings import LAWS, fitted_order
from samples.milled_part import HEAD, POCKET, small_cell
from samples.small_part import GCODE, small_part

from kr270_milling import read_cell
from kr270_milling.base.errors import MillingError
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.cell.models import arm_model_of, cut_of, cut_text_of, path_of
from kr270_milling.decide.part import assess
from kr270_milling.physics.cutting import AL7075_T6, Cut, Cutting, EngagementCut, Stock, Tool
from kr270_milling.physics.cutting.engagement import BINS, FLOORS_KNOWN, LOAD, mean_thrusts
from kr270_milling.physics.motion.milling_pass import run_pass

RADIUS, TEETH, DEPTH, FEED = 10e-3, 4, 1e-3, 0.125e-3  # [m]; feed per tooth
SPEED = 8000.0 * math.pi / 30.0  # [rad/s]
VELOCITY = FEED * TEETH * SPEED / (2.0 * math.pi)
MICRO_STEP = math.radians(1.0)
AXIAL = Cutting("linear_edge", linear_edge=AL7075_T6.replace(axial_cutting=220e6, axial_edge=2e3))

CUTTINGS = {"fractional": LAWS["fractional"], "linear_edge": AXIAL}
#: y of the material as shares of R: the tool turns clockwise and feeds along +x
IMMERSIONS = {"slot": (-1.1, 1.1), "half up": (-1.1, 0.0), "half down": (0.0, 1.1), "5 % up": (-1.1, -0.9),
              "5 % down": (0.9, 1.1)}  # fmt: skip


def tool(helix: float = 0.0) -> Tool:
    return Tool(diameter=2 * RADIUS, teeth=TEETH, spindle_speed=SPEED, helix=math.radians(helix))


def block(low: float, high: float, grid_step: float = 1e-4, length: float = 40e-3) -> Stock:
    corners = np.array([[0.0, low * RADIUS, -5e-3], [length, high * RADIUS, 0.0]])
    return Stock(min=corners[0], max=corners[1], grid_step=grid_step)


def straight(dt: float, length: float, start: float = -RADIUS - 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Tool tips (n, 3) [m] along +x and their micro-steps (n,)."""
    n = round(SPEED * dt / MICRO_STEP)
    step = VELOCITY * n * MICRO_STEP / SPEED
    x = start + step * np.arange(int(length / step))
    return np.column_stack([x, np.zeros_like(x), np.full_like(x, -DEPTH)]), n * np.arange(x.size)


def closed_form(cutting, low: float, high: float, feed: float = FEED) -> np.ndarray:
    """Mean force (3,) [N] over a revolution, (29) integrated over phi from the feed, clockwise from -y to +y."""
    edges = np.linspace(-math.pi / 2, math.pi / 2, 20001)
    phi, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    engaged = (np.sin(phi) > low) & (np.sin(phi) < high)
    tangential, radial, axial = np.where(engaged, cutting.active.per_depth(feed * np.cos(phi)), 0.0)
    forward, across = np.cos(phi), np.sin(phi)
    share = TEETH / (2 * math.pi) * width * DEPTH
    return share * np.array([
        np.sum(-radial * forward + tool().sense * tangential * across),
        np.sum(-radial * across - tool().sense * tangential * forward),
        -np.sum(axial),
    ])  # fmt: skip


def forces(cutting, immersion: str, helix=0.0, dt=4e-3, grid_step=1e-4, bins: int = BINS) -> np.ndarray:
    """(n, 3) [N] where the tool is fully engaged."""
    cut = EngagementCut(tool(helix), cutting, block(*IMMERSIONS[immersion], grid_step), MICRO_STEP, bins)
    path, steps = straight(dt, 40e-3 + RADIUS)
    return cut.along(path, steps)[0][(path[:, 0] > 2 * RADIUS) & (path[:, 0] < 28e-3), :3]


def error(cutting, immersion: str, **options) -> float:
    """Of the mean force, a share of its size."""
    exact = closed_form(cutting, *IMMERSIONS[immersion])
    mean = forces(cutting, immersion, **options).mean(axis=0)
    return float(np.abs(mean - exact).max() / np.linalg.norm(exact))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("helix", [0.0, 30.0, 45.0])
@pytest.mark.parametrize("immersion", IMMERSIONS)
@pytest.mark.parametrize("law", CUTTINGS)
def test_the_mean_force_is_that_of_the_closed_form_within_one_percent(law, immersion, helix):
    assert error(CUTTINGS[law], immersion, helix=helix) < 0.01


@pytest.mark.parametrize("helix", [0.0, 30.0, 45.0])
@pytest.mark.parametrize("immersion", ["slot", "half up", "half down"])
def test_wrench_and_torque_are_the_means_of_the_swept_teeth(immersion, helix):
    """The helix moves the cut of a tooth in time, and neither its mean force nor its mean moment."""
    low, high = IMMERSIONS[immersion]
    path, steps = straight(7.5e-3, 2.5 * RADIUS)  # a step is a revolution
    results = []
    for model, grid_step in ((Cut, 2e-5), (EngagementCut, 1e-4)):
        cut = model(tool(helix), AXIAL, block(low, high, grid_step, 20e-3), MICRO_STEP)
        wrench, torque, volume = cut.along(path, steps)
        full = (path[:, 0] > RADIUS / 5) & (path[:, 0] < 9e-3)
        results.append((wrench[full].mean(axis=0), torque[full].mean(), volume[full].sum()))
    (teeth, teeth_torque, teeth_volume), (mean, torque, volume) = results
    assert mean[:3] == pytest.approx(teeth[:3], abs=0.015 * np.linalg.norm(teeth[:3]))
    assert mean[3:] == pytest.approx(teeth[3:], abs=0.02 * np.linalg.norm(teeth[3:]))
    assert torque == pytest.approx(teeth_torque, rel=0.015)
    assert volume == pytest.approx(teeth_volume, rel=0.01)


def test_the_removed_volume_is_that_of_the_geometry_and_of_a_ramp_the_wedge_below_the_path():
    for immersion in IMMERSIONS:
        low, high = (min(max(side, -1.0), 1.0) for side in IMMERSIONS[immersion])
        cut = EngagementCut(tool(), AXIAL, block(*IMMERSIONS[immersion]), MICRO_STEP)
        path, steps = straight(4e-3, 45e-3 + 2 * RADIUS)  # through the stock
        volume = cut.along(path, steps)[2]
        assert volume.sum() == pytest.approx(cut.removed_volume, rel=1e-9)
        assert cut.removed_volume == pytest.approx((high - low) * RADIUS * 40e-3 * DEPTH, rel=0.01)
    cut = EngagementCut(tool(), AXIAL, block(-1.5, 1.5), MICRO_STEP)
    path, steps = straight(4e-3, 20e-3, start=12e-3)
    path[:, 2] = -1e-3 * np.linspace(0.0, 1.0, len(path))
    cut.along(path, steps)
    x, _, surface = cut.heights(low=(15e-3, -1e-4), high=(25e-3, 1e-4))
    lowest = np.interp(x + RADIUS, path[:, 0], path[:, 2])  # the last place whose footprint covers the node
    inside = x + RADIUS < path[-1, 0]
    assert surface[inside, 0] == pytest.approx(lowest[inside], abs=1.5 * 1e-3 * 0.267 / 19)


def test_a_tool_that_has_left_the_stock_has_no_force_at_all():
    """The lag ends, so that a pass is not scored in the air."""
    cut = EngagementCut(tool(30.0), AXIAL, block(*IMMERSIONS["slot"]), MICRO_STEP)
    path, steps = straight(4e-3, 45e-3 + 2 * RADIUS)
    wrench, _, volume = cut.along(path, steps)
    air = np.flatnonzero(volume)[-1] + 1
    assert wrench[air].any() and not wrench[air + 10 :].any()


SHARP = Cutting("linear_edge", linear_edge=AL7075_T6.replace(tangential_edge=0.0, radial_edge=0.0))


def sunk(model, cutting, slope: float, micro_step_deg: float = 1.0, grid_step: float = 0.0, runout=()):
    """Wrench, torque and energy over K_tc dV of the last steps of a tool that sinks from the air by ``slope`` (0: a
    plunge at 0.3 m/min), and the axial feed per tooth."""
    low = block(-1.5, 1.5, grid_step or (2e-5 if model is Cut else 2e-4), 50e-3)
    cutter = tool().replace(runout=np.array(runout))
    cut = model(cutter, cutting, low, math.radians(micro_step_deg))
    n = round(360 / micro_step_deg)  # a revolution
    along = TEETH * FEED * (slope > 0.0)
    down = along * slope or 0.3 / 60 * 2 * math.pi / SPEED
    path = np.array([20e-3, 0.0, 2e-4]) + np.arange(40)[:, None] * [along, 0.0, -down]
    wrench, torque, volume = cut.along(path, n * np.arange(40))
    work = torque * 2 * math.pi - wrench[:, 0] * along + wrench[:, 2] * down
    last = slice(-10, None)
    removed = cutting.active.tangential_cutting * volume[last].sum()
    return wrench[last].mean(axis=0), torque[last].mean(), work[last].sum() / removed, down / TEETH


@pytest.mark.parametrize("share", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("model", [Cut, EngagementCut])
def test_a_plunge_pushes_the_tool_up_by_the_radial_force_of_the_end_edges(model, share):
    """N s R F_r(h) up, N R^2 / 2 (K_tc h + s K_te) about the axis, h the axial feed per tooth; 885 N, 4.7 N m at s = 1.

    A whole footprint leaves no force to the side.
    """
    wrench, torque, _, h = sunk(model, AXIAL.replace(end_share=share), 0.0)
    law = AXIAL.linear_edge
    thrust = TEETH * share * RADIUS * (law.radial_cutting * h + law.radial_edge)
    turning = TEETH * RADIUS**2 / 2 * (law.tangential_cutting * h + share * law.tangential_edge)
    assert wrench[2] == pytest.approx(thrust, rel=0.02, abs=1.0)
    assert torque == pytest.approx(turning, rel=0.02)
    assert wrench[5] == pytest.approx(torque, rel=1e-12)
    assert np.abs(wrench[:2]).max() < 0.02 * turning / RADIUS and np.abs(wrench[3:5]).max() < 0.02 * turning
    if share == 1.0:
        assert (thrust, turning) == pytest.approx((885.0, 4.7), rel=0.002)


@pytest.mark.parametrize("model", [Cut, EngagementCut])
def test_a_ramp_has_the_thrust_of_all_end_edges_and_the_energy_of_the_volume_at_each_share(model):
    """The floor sinks below the whole tool, so each tooth cuts all the way round; the rim pulls down as in a slot."""
    slope = math.tan(math.radians(3.0))
    thrust = {share: sunk(model, AXIAL.replace(end_share=share), slope)[0][2] for share in (0.0, 1.0)}
    h, law = FEED * slope, AXIAL.linear_edge
    edges = TEETH * RADIUS * (law.radial_cutting * h + law.radial_edge)
    assert thrust[0.0] < 0.0 < thrust[1.0]
    assert thrust[1.0] - thrust[0.0] == pytest.approx(edges, rel=0.03)
    for share in (0.0, 0.2, 1.0):
        sharp = SHARP.replace(linear_edge=SHARP.linear_edge.replace(radial_cutting=0.0), end_share=share)
        assert sunk(model, sharp, slope)[2] == pytest.approx(1.0, abs=0.01)


def test_both_models_have_one_wrench_of_a_ramp_and_run_out_leaves_the_thrust():
    slope, cutting = math.tan(math.radians(3.0)), AXIAL.replace(end_share=0.2)
    (teeth, turning, _, _), (mean, torque, _, _) = (sunk(model, cutting, slope) for model in (Cut, EngagementCut))
    assert mean[:3] == pytest.approx(teeth[:3], abs=0.03 * np.linalg.norm(teeth[:3]))
    assert mean[3:] == pytest.approx(teeth[3:], abs=0.02 * np.linalg.norm(teeth[3:]))
    assert torque == pytest.approx(turning, rel=0.02)
    runout = sunk(Cut, cutting, 0.0, runout=[12e-6, -20e-6, 5e-6, 0.0])[0][2]
    assert runout == pytest.approx(sunk(Cut, cutting, 0.0)[0][2], rel=0.01)


def test_a_tool_that_plunges_beside_the_stock_has_the_force_of_the_part_of_its_end_that_cuts():
    """The stock ends at y = R / 2: N / 2 pi int (R - R / (2 sin a)) da over 30 to 150 deg, and F_t to the side."""
    a = np.linspace(math.pi / 6, 5 * math.pi / 6, 20001)
    length = RADIUS - RADIUS / (2 * np.sin(a))
    law = AXIAL.linear_edge
    for model in (Cut, EngagementCut):
        stock = block(0.5, 1.5, 2e-5 if model is Cut else 1e-4)
        cut = model(tool(), AXIAL.replace(end_share=1.0), stock, MICRO_STEP)
        down = 0.3 / 60 * 2 * math.pi / SPEED
        path = np.array([20e-3, 0.0, 2e-4]) - np.arange(40)[:, None] * [0.0, 0.0, down]
        wrench = cut.along(path, 360 * np.arange(40))[0][-5:].mean(axis=0)
        h, each = down / TEETH, TEETH / (2 * math.pi) * (a[1] - a[0])
        thrust = each * length.sum() * (law.radial_cutting * h + law.radial_edge)
        side = each * (np.sin(a) * length).sum() * (law.tangential_cutting * h + law.tangential_edge)
        assert wrench[2] == pytest.approx(thrust, rel=0.05)
        assert wrench[:2] == pytest.approx([-side, 0.0], abs=0.05 * side)


def test_the_thrust_of_the_swept_teeth_converges_with_the_angle_step_and_a_level_cut_has_none():
    thrust = [sunk(Cut, AXIAL.replace(end_share=1.0), 0.0, step)[0][2] for step in (4.0, 2.0, 1.0, 0.5)]
    assert np.abs(np.diff(thrust)).max() < 0.01 * thrust[-1]
    assert np.array_equal(forces(AXIAL.replace(end_share=1.0), "half up"), forces(AXIAL, "half up"))


@pytest.mark.parametrize("iterated", [False, True])
def test_a_sinking_tool_need_not_visit_again_what_it_has_cut(iterated):
    """A tool that swings up and down along a turning path, beside one that knows nothing of its former places."""
    path, steps = straight(4e-3, 20e-3)
    turn = np.arange(len(path))
    path[:, 1] = 2e-3 * np.sin(turn / 20.0)
    path[:, 2] += 3e-5 * np.sin(turn / 3.0) * np.exp(-(((turn - 40.0) / 60.0) ** 2))
    cuts = [EngagementCut(tool(), AXIAL, block(-1.1, 1.1), MICRO_STEP) for _ in range(2)]
    n = int(steps[1])
    for k in turn[:-1]:
        cuts[1].state.ints[FLOORS_KNOWN] = 0
        if iterated:
            cuts[0].sweep(path[k], path[k + 1] - [0.0, 0.0, 4e-5], int(steps[k]), n)
            cuts[0].restore()
        wrenches = [cut.sweep(path[k], path[k + 1], int(steps[k]), n) for cut in cuts]
        np.testing.assert_array_equal(wrenches[0], wrenches[1])
    for both in zip(*((cut.state.pool, cut.state.rest, cut.state.floats[LOAD:]) for cut in cuts), strict=True):
        np.testing.assert_array_equal(*both)


def test_the_error_falls_with_the_step_of_the_map_and_the_square_of_the_bins_and_has_no_order_in_the_length_of_a_step():
    """Scatter of the force over the steps: cells that are cut in part alias with the step of the path.

    The chip thickness belongs to the feed per tooth and not to the step.
    """
    steps, bins = [8e-4, 4e-4, 2e-4, 1e-4, 5e-5], [8, 12, 16, 24]
    scatter = [float(forces(AXIAL, "slot", grid_step=step).std(axis=0).max()) for step in steps]
    assert fitted_order(steps, scatter) > 0.8
    assert scatter[2] < 0.006 * np.linalg.norm(closed_form(AXIAL, -1.0, 1.0))
    errors = [error(AXIAL, "half up", bins=count) for count in bins]
    assert fitted_order(1.0 / np.array(bins), errors) > 1.7
    assert error(AXIAL, "half up") < errors[-1] / 4
    assert max(error(AXIAL, "half down", dt=dt) for dt in (1e-3, 2e-3, 4e-3, 8e-3)) < 0.01


def test_the_deflection_converges_with_the_exchange_period(tmp_path):
    """An edge force begins with a step, whose time is known to a period: the order is 1 at least."""

    def deflection(period: float):
        words = [f"exchange.engagement_period_ms={period}", "cutting.detail=engagement", "tool.teeth=4"]
        cell = small_cell(tmp_path, POCKET, *words, "exchange.micro_step_deg=1.0")
        target = path_of(cell).target
        result = run_pass(arm_model_of(cell, target), cut_of(cell), path_of(cell).clock, target, target)
        return result.time_ns, result.deflection[:, :3]

    time, finest = deflection(0.25)
    errors = []
    for period in (16.0, 8.0, 4.0, 2.0):
        stamps, coarse = deflection(period)
        rows = np.searchsorted(time, stamps[stamps <= time[-1]])
        errors.append(rms(coarse[: rows.size] - finest[rows]))
    assert fitted_order([16.0, 8.0, 4.0, 2.0], errors) > 1.0
    assert errors[2] < 0.5e-6


def test_the_test_piece_deflects_and_has_the_errors_of_the_swept_teeth():
    """Within 2 %, and within 5 % where the end edges touch the floor: teeth touch it one by one."""
    cells = [read_cell("test_piece.yaml", f"cutting.detail={name}") for name in ("teeth", "engagement")]
    passes = [simulate(cell) for cell in cells]
    teeth, mean = (ran.result for ran in passes)
    at = np.searchsorted(teeth.time_ns, mean.time_ns[1:-1])
    swept, engaged = teeth.deflection[at, :3], mean.deflection[1:-1, :3]
    for axis in range(3):
        for measure in (np.max, rms):
            before, after = (measure(np.abs(series[:, axis])) for series in (swept, engaged))
            assert after == pytest.approx(before, rel=0.02, abs=0.5e-6)
    difference = np.linalg.norm(engaged[:, :2] - swept[:, :2], axis=1)
    assert difference.max() < 0.05 * np.abs(swept[:, :2]).max()
    assert rms(difference) < 1e-6
    assert mean.removed_volume == pytest.approx(teeth.removed_volume, rel=0.002)
    parts = [assess(cell, ran).whole for cell, ran in zip(cells, passes, strict=True)]
    for name in ("max_normal", "max_vertical", "max_wall", "mean_wall", "max_floor", "mean_floor"):
        swept, engaged = (getattr(part, name) for part in parts)
        touching = name in ("max_vertical", "mean_floor")
        assert engaged == pytest.approx(swept, rel=0.05 if touching else 0.02, abs=0.5e-6), name


#: a ramp of 3 deg
RAMP = HEAD + "(ramp)\nG0 X-14 Y0 Z2\nG1 Z0 F1000\nG1 X14 Z-1.467 F2000\nG0 Z2\nM5\nM30\n"


@pytest.mark.parametrize("share", [0.2, 1.0])
def test_the_floor_below_a_swinging_arm_does_not_depend_on_the_exchange_period(tmp_path, share):
    """The contact of the end edges is solved within a period. A tip that bounces: peaks at 4 ms are 4 um higher."""
    parts = []
    for period in (4.0, 1.0):
        words = f"exchange.engagement_period_ms={period}", f"cutting.end_share={share}", "cutting.detail=engagement"
        cell = small_cell(tmp_path, RAMP, *words)
        parts.append(assess(cell, simulate(cell)).whole)
    assert parts[0].mean_floor == pytest.approx(parts[1].mean_floor, abs=3e-6)
    if share == 0.2:
        assert parts[0].max_floor == pytest.approx(parts[1].max_floor, abs=3e-6)


@pytest.mark.parametrize("share", [0.2, 0.5, 1.0])
def test_an_arm_that_bounces_on_its_end_edges_is_lifted_as_by_the_swept_teeth(tmp_path, share):
    """The thrust of steady contact is N s R F_r(h), 290 N at s = 1; a tip that lifts off again and again has 126 N."""
    thrust, lift = [], []
    for words in (("cutting.detail=teeth", "exchange.period_ms=0.0833333333"), ("cutting.detail=engagement",)):
        ran = simulate(small_cell(tmp_path, RAMP, f"cutting.end_share={share}", *words)).result
        depth = -ran.target[:, 2]
        inside = (depth > 0.5e-3) & (depth < 1.4e-3) & (np.gradient(depth) > 0.0)
        thrust.append(ran.wrench[inside, 2].mean())
        lift.append(ran.deflection[inside, 2].mean())
    assert thrust[1] == pytest.approx(thrust[0], rel=0.1)
    assert lift[1] == pytest.approx(lift[0], rel=0.1, abs=0.5e-6)


def test_a_layer_of_many_edge_radii_or_a_stiff_arm_leaves_no_bounce():
    soft, stiff = (
        [np.array([value]) for value in (w, 0.04, 1.0, 1.0 / mass)] for w, mass in ((120.0, 50.0), (2e4, 50.0))
    )
    pressing = AXIAL.replace(end_share=1.0)
    assert mean_thrusts(stiff, tool(), pressing, 2e-3) == pytest.approx(1.0, abs=0.02)
    shares = mean_thrusts(soft, tool(), pressing, 2e-3)
    assert shares.min() < 0.6 and shares[-1] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("detail", ["teeth", "engagement"])
def test_a_compensated_ramp_has_a_better_floor(tmp_path, detail):
    cell = small_cell(tmp_path, RAMP, f"cutting.detail={detail}")
    before = simulate(cell)
    floors = [assess(cell, ran).whole.max_floor for ran in (before, compensated(cell, before, "inverse"))]
    assert floors[1] < 0.2 * floors[0]


def test_a_reference_planned_by_the_engagement_leaves_at_most_a_fifth_more_under_the_swept_teeth(tmp_path):
    words = ("compensation.max_passes=2", "dynamics.reference_inertia=true", "stock.grid_step_um=20")
    teeth, mean = (small_part(tmp_path, GCODE, f"cutting.detail={name}", *words) for name in ("teeth", "engagement"))
    original = simulate(teeth)
    planned = compensated(mean, simulate(mean), "learned").reference
    best = compensated(teeth, original, "learned").scores.max_deviation
    assert simulate(teeth, planned).scores.max_deviation < 1.2 * best < 0.04 * original.scores.max_deviation


def test_the_detail_is_that_of_the_key_or_of_the_length_with_a_finer_map_for_a_small_cutter(tmp_path):
    for value, kind in (("auto", Cut), ("engagement", EngagementCut)):
        assert type(cut_of(read_cell("test_piece.yaml", f"cutting.detail={value}"))) is kind
    small = read_cell("test_piece.yaml", "cutting.detail=engagement", "tool.diameter_mm=2")
    assert small.stock.grid_step == pytest.approx(1e-3 / 50)
    with pytest.raises(MillingError, match=r"cutting.detail.*straight cut"):
        read_cell("paper.yaml", "cutting.detail=engagement")
    program = tmp_path / "long.nc"
    moves = "".join(f"G1 X{40 * (-1) ** k} Y{k % 40 - 20}\n" for k in range(60))
    program.write_text(f"G21 G90 G17\nS8000 M3\nG0 X60 Y0 Z5\nG0 Z-0.5\nG1 X40 F4000\n{moves}G0 Z5\nM30\n")
    words = [f"path.file={program}"]
    cell = read_cell("test_piece.yaml", *words)
    assert cell.cutting.by_engagement
    assert path_of(cell).clock.period == pytest.approx(4e-3) and path_of(cell).clock.micro_steps == 192
    assert cell.stock.grid_step == pytest.approx(2e-4)
    assert "engagement" in cut_text_of(cell)
    assert not read_cell("test_piece.yaml", *words, "cutting.detail=teeth").cutting.by_engagement


@pytest.mark.parametrize(
    ("feed_um", "grid_um", "micro_step", "share"),
    [(2.0, 40.0, 1.0, 0.25), (4.0, 16.0, 1.0, 0.9), (4.0, 16.0, 5.0, 0.99), (10.0, 16.0, 2.0, 0.99)],
)
def test_a_grid_too_coarse_for_thin_chips_is_stated_where_the_swept_teeth_lose_force(
    feed_um, grid_um, micro_step, share
):  # fmt: skip
    """A rigid slot of one revolution: the sweep beside the closed form, and the line that a command prints."""
    feed, n = 1e-6 * feed_um, round(360 / micro_step)
    cut = Cut(tool(), AXIAL, block(*IMMERSIONS["slot"], 1e-6 * grid_um, 20e-3), math.radians(micro_step))
    x = 8e-3 + feed * TEETH * np.arange(5)
    path = np.column_stack([x, np.zeros_like(x), np.full_like(x, -DEPTH)])
    force = cut.along(path, n * np.arange(5))[0][-1, :3]
    ratio = np.linalg.norm(force) / np.linalg.norm(closed_form(AXIAL, *IMMERSIONS["slot"], feed))
    rate = 60 * feed * TEETH * SPEED / (2 * math.pi)
    words = [f"path.feed_rate_m_per_min={rate}", f"stock.grid_step_um={grid_um}"]
    words += [f"exchange.micro_step_deg={micro_step}", "exchange.period_ms=7.5", "path.length_mm=1"]
    stated = "the force of thin chips is too low" in cut_text_of(read_cell("paper.yaml", *words))
    assert stated == (share < 0.95)
    assert ratio < share if stated else ratio == pytest.approx(1.0, abs=0.05)


def test_a_program_of_hours_is_modelled_at_a_bounded_number_of_postures(monkeypatch):
    cell = read_cell("test_piece.yaml", "cutting.detail=engagement")
    target = path_of(cell).target
    free = arm_model_of(cell, target)
    monkeypatch.setattr("kr270_milling.cell.models.MOST_LONG_POSTURES", 50)
    bounded = arm_model_of(cell, target)
    assert len(free.transition) > 100 and len(bounded.transition) <= 51
    clock = path_of(cell).clock
    passes = [run_pass(model, cut_of(cell), clock, target, target).deflection[:, :3] for model in (free, bounded)]
    assert np.abs(passes[1] - passes[0]).max() < 0.05 * np.abs(passes[0]).max()
