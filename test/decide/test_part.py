"""Results of each feature along a tool path, the finished workpiece, and the shipped test piece."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from milled_part import CONFIG, HEAD, POCKET, RADIUS, RIGID, SLOT, small_cell

from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.decide.part import assess, assess_all, heights_at, machined
from kr270_milling.decide.part.course import course, deviations
from kr270_milling.physics.motion.arm_model import modal_models
from kr270_milling.physics.motion.dynamics import discretise


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_cell(tmp_path_factory.mktemp("assessment"), POCKET)


@pytest.fixture(scope="module")
def ran(cell):
    return simulate(cell)


@pytest.fixture(scope="module")
def part(cell, ran):
    return assess(cell, ran)


def test_each_feature_that_cuts_has_a_row_and_the_whole_part_is_the_worst_of_them(part):
    assert [row.name for row in part.rows] == ["side", "ring"]
    for key in ("max_normal", "max_vertical", "max_wall", "max_floor", "max_force", "max_torque", "max_power"):
        values = [getattr(row, key) for row in part.rows]
        assert getattr(part.whole, key) == max(values) > 0
    assert part.whole.cut_length == pytest.approx(sum(row.cut_length for row in part.rows))
    for row in part.rows:
        assert row.mean_normal < row.quantile_normal < row.max_normal


def test_nothing_is_cut_in_the_air_and_power_is_torque_times_spindle_speed(cell, ran, part):
    result, stock = ran.result, cell.stock
    above = np.minimum(result.tool[:-1, 2], result.tool[1:, 2]) > stock.max[2]
    beside = np.abs(result.tool[1:, 0]) > stock.max[0] + RADIUS + 1e-3
    air = np.append(False, above | beside)
    assert air.sum() > 100 and not part.cutting[air].any()
    assert np.all(part.force[air] == 0) and np.all(part.power[air] == 0)
    assert part.whole.cut_length < 0.8 * part.path.distance[-1]
    np.testing.assert_allclose(part.power, part.torque * cell.tool.spindle_speed, rtol=1e-12)
    assert result.volume.sum() == pytest.approx(result.removed_volume, rel=1e-9)


def test_a_feature_in_the_air_has_no_row(tmp_path):
    cell = small_cell(tmp_path, SLOT.replace("M5", "(air)\nG0 X-28 Y0 Z2\nG1 X28\nM5"))
    assert [row.name for row in assess(cell, simulate(cell)).rows] == ["slot"]


def test_mean_torque_of_a_rigid_slot_is_that_of_the_linear_edge_law(tmp_path):
    cell = small_cell(tmp_path, SLOT, RIGID, "stock.grid_step_um=20.0", "exchange.micro_step_deg=1.0")
    found = assess(cell, simulate(cell))
    full = np.abs(found.path.distance - 30e-3 - 2e-3) < 8e-3  # plunge of 3 mm, then x from -28 to 28: in the middle
    full = full[: full.size]
    law, depth, feed = cell.cutting.linear_edge, 1e-3, 0.25e-3
    # each of the teeth cuts over half a turn with h = f_z sin: mean of F_t is (2 K_tc f_z + pi K_te) a / (2 pi)
    per_tooth = (2 * law.tangential_cutting * feed + np.pi * law.tangential_edge) * depth / (2 * np.pi)
    turns = int(full.sum() // 20) * 20  # periods of 18 deg
    mean = found.torque[np.flatnonzero(full)[:turns]].mean()
    assert mean == pytest.approx(cell.tool.teeth * per_tooth * RADIUS, rel=0.015)


def test_the_workpiece_of_the_pass_itself_gives_what_a_sweep_along_the_pass_gives(cell, ran, part):
    """The pass cut with the predicted tool centre, here within 2 um of the corrected one: nodes at the very edge of a
    tooth's way may fall to another tooth."""
    cut = machined(cell, ran.result.tool)
    assert np.array_equal(cut.map_heights()[2], ran.result.heights)
    x, y, z = cut.heights(thinning=7)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    np.testing.assert_array_equal(heights_at(cut, points).reshape(z.shape), z)
    first, again = assess_all(
        cell, [ran, dataclasses.replace(ran, result=dataclasses.replace(ran.result, heights=None))]
    )
    assert first.table() == part.table()  # both passes share the ideal part
    differ = np.abs(part.surface.floors.error - again.surface.floors.error)
    assert np.nanquantile(differ, 0.999) <= part.surface.floor_resolution
    assert part.whole.max_floor == pytest.approx(again.whole.max_floor, abs=ran.result.correction.max())


# --- Directions, distances and features along a pass ---
@pytest.fixture(scope="module")
def stamps(cell):
    return np.arange(0, cell.target().duration_ns, 500_000)


def test_the_tangent_is_the_direction_of_the_motion_and_is_there_while_the_tool_rests(cell, stamps):
    target = cell.target()
    end = target.duration_ns
    path, velocity = course(cell, np.append(stamps, [end, end + 10**9])), target.sample_velocity(stamps)
    speed = np.linalg.norm(velocity, axis=1)
    moving = np.flatnonzero(speed > 5e-3)
    assert moving.size > 500
    along = np.sum(velocity[moving] / speed[moving, None] * path.tangent[moving], axis=1)
    assert np.quantile(along, 0.01) > 0.999  # the controller's knots round arcs a little
    np.testing.assert_allclose(np.linalg.norm(path.tangent, axis=1), 1.0, atol=1e-12)
    assert np.all(np.diff(path.distance) >= -1e-12)
    assert path.distance[-1] == pytest.approx(cell.timed_path.toolpath.length, abs=1e-12)
    upright = np.abs(path.tangent[:, 2]) > 0.999  # a move along the spindle keeps the side of the last horizontal move
    assert upright.any() and not upright[np.flatnonzero(np.abs(np.diff(path.heading)) > 1e-9) + 1].any()
    assert path.features == ("unnamed", "side", "ring")
    assert set(np.unique(path.feature)) <= {0, 1, 2} and {1, 2} <= set(np.unique(path.feature))


def test_normal_deviation_is_positive_to_the_left_of_the_path(tmp_path):
    cell = small_cell(tmp_path, HEAD + "G0 X-28 Y0 Z-1\nG1 X20 F3000\nG1 X20 Y28\nG0 Z2\n")
    stamps = np.linspace(0, cell.target().duration_ns, 200).astype(np.int64)
    path = course(cell, stamps)
    shifted = deviations(path, np.tile([-1.0, 2.0, 3.0], (stamps.size, 1)))
    flat = np.abs(path.tangent[:, 2]) < 0.5
    along_x, along_y = flat & (path.tangent[:, 0] > 0.9), flat & (path.tangent[:, 1] > 0.9)
    np.testing.assert_allclose(shifted[along_x], np.tile([-1, 2, 3], (along_x.sum(), 1)), atol=1e-12)
    np.testing.assert_allclose(shifted[along_y], np.tile([2, 1, 3], (along_y.sum(), 1)), atol=1e-12)


def test_a_straight_cut_without_a_file_is_one_feature_along_x():
    cell = read_cell(CONFIG / "paper.yaml")
    path = course(cell, np.array([0, 10**9, 2 * 10**9]))
    assert path.features == ("straight cut",)
    np.testing.assert_allclose(path.tangent, np.tile([1.0, 0, 0], (3, 1)), atol=1e-12)
    assert path.distance[1] == pytest.approx(4.0 / 60)  # 4 m/min for 1 s


# --- The shipped cell of the test piece ---
COARSE = ("stock.grid_step_um=50.0", "exchange.micro_step_deg=3.0")


def with_features(path, *names: str):
    """The programme of the test piece with some of its features only."""
    keep, copied = True, []
    for line in (CONFIG / "test_piece.nc").read_text().splitlines():
        if line.startswith("("):
            keep = line.strip("()") in names
        if keep or line.startswith(("N540", "N550")):
            copied.append(line.replace("M3", "M3 F4000"))
    path.write_text("\n".join(copied) + "\n")
    return path


def test_the_square_is_left_too_large_by_tens_of_micrometres(tmp_path):
    short = with_features(tmp_path / "short.nc", "square", "inclined_side")
    cell = read_cell(CONFIG / "test_piece.yaml", [*COARSE, f"path.file={short}"])
    part = assess(cell, simulate(cell))
    square, inclined = part.rows
    assert (square.name, inclined.name) == ("square", "inclined_side")
    # half immersion, 1.2 mm deep: a mean force of some 90 N at 0.5 to 0.8 um/N; climb milling pushes the tool away
    assert 30e-6 < square.mean_wall < 80e-6 and inclined.mean_wall < square.mean_wall
    made = part.surface.walls.error[part.surface.walls.feature == part.path.features.index("square")]
    assert np.quantile(made, 0.02) > 0
    assert square.cut_length == pytest.approx(385e-3, rel=0.05)  # four sides of 100 mm less what the entry leaves


def test_one_pass_of_inverse_leaves_a_twentieth_of_walls_and_floors_with_every_corner(tmp_path):
    """Sharp corners, helix, axial force and inertia of the arm. A fifth was asked for; a coarser cut is simulated."""
    path = with_features(tmp_path / "diamond.nc", "diamond")
    cell = read_cell(CONFIG / "test_piece.yaml", [*COARSE, f"path.file={path}"])
    assert cell.tool.helix > 0.0 and cell.cutting.axial and cell.dynamics.reference_inertia
    original = simulate(cell)
    before, after = assess_all(cell, (original, compensated(cell, original, "inverse")))
    assert before.whole.max_wall > 50e-6 and before.whole.max_floor > 50e-6
    assert after.whole.max_wall < before.whole.max_wall / 20 and after.whole.max_floor < before.whole.max_floor / 20
    assert after.whole.max_normal < before.whole.max_normal / 20  # while it cuts, also where the wall goes later


# --- Stiffness and mass that follow the posture ---
#: 200 mm away from the arm and 100 mm across, through the stock
FAR = HEAD + "(far)\nG0 X-100 Y-50 Z-1\nG1 X100 Y50 F3000\n"


def static(transition, held, output, feedthrough) -> np.ndarray:
    """Deflection under a wrench that stays, (6, 6)."""
    return output @ np.linalg.solve(np.eye(len(transition)) - transition, held) + feedthrough


def lowest(transition) -> float:
    """Angle of the slowest mode in one period [rad]."""
    return float(np.abs(np.angle(np.linalg.eigvals(transition))).min())


def interpolation_error(folder, spacing_mm: float) -> tuple[float, float]:
    """Largest relative error of translational compliance and of the lowest frequency, over exchanges along FAR."""
    cell = small_cell(folder, FAR, "dynamics.follow_pose=true", f"dynamics.posture_spacing_mm={spacing_mm}")
    target = cell.target()
    model = cell.arm_model(target)
    steps = np.arange(0, cell.clock.steps(target.duration_ns), 37)  # exchanges; 37 meets every place between postures
    stamps = cell.clock.stamp(steps)
    joints = cell.joints_at(target.sample(stamps), target.sample_orientation(stamps))
    exact = modal_models(cell.arm, cell.mount, cell.dynamics, cell.workpiece.pose, joints)
    worst = np.zeros(2)
    for step, mode in zip(steps, exact, strict=True):
        k, part = divmod(step / model.steps_per_knot, 1.0)
        arrays = [a[int(k)] + part * (a[int(k) + 1] - a[int(k)]) for a in model.arrays[:4]]
        fresh = discretise(mode, cell.dynamics.damping_ratio, cell.clock.period)
        soft, right = static(*arrays)[:3, :3], static(*fresh)[:3, :3]
        wrong = [np.abs(soft - right).max() / np.abs(right).max(), abs(lowest(arrays[0]) / lowest(fresh[0]) - 1)]
        worst = np.maximum(worst, wrong)
    return worst[0], worst[1]


def test_postures_5_mm_apart_give_stiffness_and_frequency_to_1e_3_and_the_error_falls_with_the_square(tmp_path):
    """5 mm is the shipped spacing; joint compliances are known to a few per cent."""
    finest, fine, coarse = (np.array(interpolation_error(tmp_path, spacing)) for spacing in (5.0, 20.0, 40.0))
    assert finest.max() < 1e-3
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.4)
