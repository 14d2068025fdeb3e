"""Results of each feature along a tool path, errors of walls and floors, the finished workpiece as STL."""

import dataclasses
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from samples.cuttings import profile
from samples.milled_part import CONFIG, HEAD, POCKET, RADIUS, SLOT, small_cell

from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import compensated, simulate
from kr270_milling.cell.models import arm_model_of, arm_of, cut_of, path_of
from kr270_milling.decide.part import assess, assess_all, heights_at, ideal_part, machined, surface
from kr270_milling.decide.part.surface import (
    MARK,
    Stations,
    deviations,
    neighbours,
    remaining_walls,
    stations_of,
    write_part,
)
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
    assert all(row.mean_normal < row.quantile_normal < row.max_normal for row in part.rows)


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


def test_the_workpiece_of_the_pass_itself_gives_what_a_sweep_along_the_pass_gives(cell, ran, part):
    """The predicted tool centre, which cut, is within 2 um of the corrected one: few nodes fall to another tooth."""
    cut = machined(cut_of(cell), ran.result.tool, path_of(cell).clock)
    assert np.array_equal(cut.map_heights()[2], ran.result.heights)
    x, y, z = cut.heights(thinning=7)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    np.testing.assert_array_equal(heights_at(cut, points).reshape(z.shape), z)
    swept = dataclasses.replace(ran, result=dataclasses.replace(ran.result, heights=None))
    differ = np.abs(part.floors.error - assess(cell, swept).floors.error)
    assert np.nanquantile(differ, 0.999) <= part.floor_resolution


# --- Directions, distances and features along a pass ---
def test_the_tangent_is_the_direction_of_the_motion_and_is_there_while_the_tool_rests(cell):
    target = path_of(cell).target
    end = target.duration_ns
    stamps = np.arange(0, end, 500_000)
    path, velocity = stations_of(path_of(cell), np.append(stamps, [end, end + 10**9])), target.sample_velocity(stamps)
    speed = np.linalg.norm(velocity, axis=1)
    moving = np.flatnonzero(speed > 5e-3)
    assert moving.size > 500
    along = np.sum(velocity[moving] / speed[moving, None] * path.tangent[moving], axis=1)
    assert np.quantile(along, 0.01) > 0.999  # the controller's knots round arcs a little
    assert path.distance[-1] == pytest.approx(path_of(cell).timed.toolpath.length, abs=1e-12)
    upright = np.abs(path.tangent[:, 2]) > 0.999  # a move along the spindle keeps the side of the last horizontal move
    assert upright.any() and not upright[np.flatnonzero(np.abs(np.diff(path.heading)) > 1e-9) + 1].any()
    straight = stations_of(path_of(read_cell(CONFIG / "paper.yaml")), np.array([0, 10**9, 2 * 10**9]))
    np.testing.assert_allclose(straight.tangent, np.tile([1.0, 0, 0], (3, 1)), atol=1e-12)
    assert straight.distance[1] == pytest.approx(4.0 / 60)  # 4 m/min for 1 s


def test_normal_deviation_is_positive_to_the_left_of_the_path(tmp_path):
    cell = small_cell(tmp_path, HEAD + "G0 X-28 Y0 Z-1\nG1 X20 F3000\nG1 X20 Y28\nG0 Z2\n")
    stamps = np.linspace(0, path_of(cell).target.duration_ns, 200).astype(np.int64)
    path = stations_of(path_of(cell), stamps)
    shifted = deviations(path, np.tile([-1.0, 2.0, 3.0], (stamps.size, 1)))
    flat = np.abs(path.tangent[:, 2]) < 0.5
    along_x, along_y = flat & (path.tangent[:, 0] > 0.9), flat & (path.tangent[:, 1] > 0.9)
    np.testing.assert_allclose(shifted[along_x], np.tile([-1, 2, 3], (along_x.sum(), 1)), atol=1e-12)
    np.testing.assert_allclose(shifted[along_y], np.tile([2, 1, 3], (along_y.sum(), 1)), atol=1e-12)


# --- The shipped cell of the test piece ---
def test_one_pass_of_inverse_leaves_a_twentieth_of_walls_and_floors_with_every_corner(tmp_path):
    """Sharp corners, helix, axial force and inertia of the arm. A fifth was asked for; a coarser cut is simulated."""
    start, *features = (CONFIG / "test_piece.nc").read_text().split("\n(")
    (diamond,) = (lines for lines in features if lines.startswith("diamond)"))
    path = tmp_path / "diamond.nc"
    path.write_text(f"{start.replace('M3', 'M3 F4000')}\n({diamond}\nM5\nM30\n")
    coarse = "stock.grid_step_um=50.0", "exchange.micro_step_deg=3.0", f"path.file={path}"
    cell = read_cell(CONFIG / "test_piece.yaml", coarse)
    assert cell.tool.helix > 0.0 and cell.cutting.axial and cell.dynamics.reference_inertia
    original = simulate(cell)
    before, after = assess_all(cell, (original, compensated(cell, original, "inverse")))
    assert before.whole.max_wall > 50e-6 and before.whole.max_floor > 50e-6
    assert after.whole.max_wall < before.whole.max_wall / 20 and after.whole.max_floor < before.whole.max_floor / 20
    assert after.whole.max_normal < before.whole.max_normal / 20  # while it cuts, also where the wall goes later


# --- Stiffness and mass that follow the posture ---
#: 200 mm away from the arm and 100 mm across, through the stock
FAR = HEAD + "(far)\nG0 X-100 Y-50 Z-1\nG1 X100 Y50 F3000\n"


def static(transition, input_matrix, output, feedthrough) -> np.ndarray:
    """Deflection under a force that stays, (3, 3)."""
    return (output @ np.linalg.solve(np.eye(len(transition)) - transition, input_matrix) + feedthrough)[:3, :3]


def interpolation_error(folder, spacing_mm: float) -> float:
    """Largest relative error of the static compliance, over exchanges along FAR."""
    cell = small_cell(folder, FAR, "dynamics.follow_pose=true", f"dynamics.posture_spacing_mm={spacing_mm}")
    target = path_of(cell).target
    model = arm_model_of(cell, target)
    steps = np.arange(
        0, path_of(cell).clock.steps(target.duration_ns), 37
    )  # exchanges; 37 meets every place between postures
    stamps = path_of(cell).clock.stamp(steps)
    joints = arm_of(cell).joints_at(target.sample(stamps), target.sample_orientation(stamps))
    modes = modal_models(cell.arm, cell.mount, cell.dynamics, cell.workpiece.pose, joints)
    worst = 0.0
    for step, mode in zip(steps, modes, strict=True):
        knot, part = divmod(step / model.steps_per_knot, 1.0)
        soft = static(
            *(
                a[int(knot)] + part * (a[int(knot) + 1] - a[int(knot)])
                for a in (model.transition, model.input, model.output, model.feedthrough)
            )
        )
        exact = static(*discretise(mode, cell.dynamics.damping_ratio, path_of(cell).clock.period))
        worst = max(worst, np.abs(soft - exact).max() / np.abs(exact).max())
    return worst


def test_postures_5_mm_apart_give_the_stiffness_to_1e_3_and_the_error_falls_with_the_square(tmp_path):
    """5 mm is the shipped spacing; joint compliances are known to a few per cent."""
    finest, fine, coarse = (interpolation_error(tmp_path, spacing) for spacing in (5.0, 20.0, 40.0))
    assert finest < 1e-3 and coarse / fine == pytest.approx(4.0, rel=0.4)


# --- Errors of walls and floors for deviations that are known beforehand ---
MM, UM = 1e-3, 1e-6


def planned(cell):
    """Stamps, stations and target (n + 1, 3) of a cell."""
    clock = path_of(cell).clock
    stamps = clock.stamp(np.arange(clock.steps(path_of(cell).target.duration_ns) + 1))
    return stations_of(path_of(cell), stamps), path_of(cell).target.sample(stamps)


def errors(cell, shift, feature: str = ""):
    """Errors of floors and walls where the tool is shifted by (3,) [m], everywhere or in one feature."""
    path, target = planned(cell)
    shifted = path.feature == path.features.index(feature) if feature else np.full(len(target), True)
    return surface(cell, path, target, target + shifted[:, None] * shift, ideal_part(cell, path, target))


@pytest.fixture(scope="module")
def slot(tmp_path_factory):
    return small_cell(tmp_path_factory.mktemp("slot"), SLOT)


@pytest.mark.parametrize("shift_um", [(30, 0, 0), (40, -30, 0), (0, 0, -4.0), (0, -20, 2.5), (0, 0, 30.0)])
def test_a_shift_moves_each_wall_by_its_part_along_the_normal_and_each_floor_by_its_part_along_the_spindle(
    cell, shift_um
):
    (floors, walls), step = errors(cell, UM * np.array(shift_um)), cell.stock.level_step
    assert len(np.unique(np.round(np.arctan2(*walls.normal.T), 2))) > 50  # straight sides, a corner, an arc
    across = UM * walls.normal @ np.array(shift_um[:2])
    np.testing.assert_allclose(walls.error, across, atol=1e-10 if across.any() else 1e-12)
    assert np.unique(floors.feature[np.isfinite(floors.error)]).tolist() == [1, 2]
    np.testing.assert_allclose(floors.errors(), UM * shift_um[2], atol=1e-9 * step + 1e-15)


def test_walls_of_a_slot_stand_a_radius_beside_the_path_with_its_depth(slot):
    _, walls = errors(slot, np.zeros(3))
    np.testing.assert_allclose(np.abs(walls.position[:, 1]), RADIUS, atol=1e-9)
    np.testing.assert_allclose(walls.normal, -np.sign(walls.position[:, 1:2]) * [0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(walls.height, 1 * MM, atol=2 * slot.stock.level_step)
    for side in (1, -1):  # one mark for each tooth: f_z = 3000 mm/min / 6000 rpm / 2 = 0.25 mm
        x = np.sort(walls.position[np.sign(walls.position[:, 1]) == side, 0])
        assert x[0] < -19.7 * MM and x[-1] > 19.7 * MM
        np.testing.assert_allclose(np.diff(x), 0.25 * MM, rtol=1e-6)


def test_walls_under_vibration_agree_with_the_nodes_of_a_fine_grid(tmp_path):
    fine = small_cell(tmp_path, SLOT, "stock.grid_step_um=4.0", "stock.min_mm=[-3, -6, -6.5535]",
                      "stock.max_mm=[3, 6, 0]", "exchange.micro_step_deg=1.0")  # fmt: skip
    path, target = planned(fine)
    time = np.arange(len(target)) * path_of(fine).clock.period
    shake = 8 * UM * np.sin(2 * np.pi * 63.0 * time)  # comes round between the teeth, which pass at 200 Hz
    ideal = ideal_part(fine, path, target)
    _, result = surface(fine, path, target, target + shake[:, None] * [0, 1, 0], ideal)
    cut = machined(cut_of(fine), target + shake[:, None] * [0, 1, 0], path_of(fine).clock)
    x, low, high = profile(cut)
    left = result.normal[:, 1] < 0
    for mine, border, side in ((left, high + 2 * UM, 1), (~left, low - 2 * UM, -1)):
        columns = np.searchsorted(x, result.position[mine, 0])
        inside = (columns > 30) & (columns < len(x) - 30)
        by_nodes = RADIUS - side * border[columns[inside]]
        assert np.abs(by_nodes).max() > 5 * UM
        np.testing.assert_allclose(result.error[mine][inside], by_nodes, atol=3.5 * UM)  # nodes are 4 um apart
        assert np.mean(result.error[mine][inside] - by_nodes) == pytest.approx(0, abs=0.8 * UM)


def test_a_deviation_that_is_cut_away_later_does_not_count(tmp_path):
    rough = HEAD + "(rough)\nG0 X-28 Y2.6 Z-1\nG1 X28 F3000\nG0 Z2\n(finish)\nG0 X-28 Y2 Z2\nG0 Z-1\nG1 X28\nG0 Z2\n"
    _, result = errors(small_cell(tmp_path, rough), [0, -50 * UM, 0], "rough")
    below = result.normal[:, 1] > 0  # the side where the finishing pass took more
    assert set(result.feature[below]) == {2}  # unnamed, rough, finish
    np.testing.assert_allclose(result.error[below], 0.0, atol=1e-12)
    np.testing.assert_allclose(result.error[~below], 50 * UM, atol=1e-10)  # the far wall stays as it was roughed


def test_a_fin_between_two_passes_that_only_touch_is_no_floor(tmp_path):
    two = HEAD + "(one)\nG0 X-28 Y-5 Z-1\nG1 X28 F3000\nG0 Z2\n(two)\nG0 X-28 Y5 Z2\nG0 Z-1\nG1 X28\nG0 Z2\n"
    floors, _ = errors(small_cell(tmp_path, two), [0, 100 * UM, 30 * UM], "two")
    assert np.abs(floors.errors(1)).max() == pytest.approx(0.0, abs=1e-12)  # the fin is 1 mm high
    assert floors.errors(2) == pytest.approx(30 * UM)


def test_a_deeper_pass_on_the_same_contour_may_cut_the_wall_above_but_cannot_put_material_back(tmp_path):
    two = HEAD + "(upper)\nG0 X-28 Y0 Z-1\nG1 X28 F3000\nG0 Z2\n(lower)\nG0 X-28 Z2\nG0 Z-2\nG1 X28\nG0 Z2\n"
    _, result = errors(small_cell(tmp_path, two), [0, 20 * UM, 0], "lower")
    left, upper = result.normal[:, 1] < 0, result.feature == 1  # unnamed, upper, lower
    cusp = (0.25 * MM) ** 2 / (8 * RADIUS)  # the teeth of the lower pass need not meet the marks of the upper one
    cases = ((left & upper, -20, cusp), (left & ~upper, -20, 0), (~left & upper, 0, 0), (~left & ~upper, 20, 0))
    for chosen, expected, tolerance in cases:
        assert chosen.sum() > 100
        np.testing.assert_allclose(result.error[chosen], expected * UM, atol=tolerance + 1e-10)


def test_a_ramp_leaves_its_own_slope_and_an_oblique_shift_its_vertical_part(tmp_path):
    cell = small_cell(tmp_path, HEAD + "(ramp)\nG0 X-28 Y0 Z-0.5\nG1 X28 Z-0.9 F3000\nG0 Z2\n")
    path, target = planned(cell)
    ideal = ideal_part(cell, path, target)
    middle = np.argmin(np.abs(ideal.y))
    inner = np.abs(ideal.x) < 14 * MM
    slope = np.polyfit(ideal.x[inner], ideal.height[inner, middle], 1)[0]
    assert slope == pytest.approx(-0.4 / 56, rel=2e-2)
    floors, _ = surface(cell, path, target, target + [0, 0, 10 * UM], ideal)
    assert np.mean(floors.errors()) == pytest.approx(10 * UM, rel=0.02)


def test_a_plunge_owns_the_floor_it_ends_on_and_heights_beside_the_stock_are_not_known(tmp_path):
    cell = small_cell(tmp_path, HEAD + "(hole)\nG0 X5 Y5 Z2\nG1 Z-1 F600\nG0 Z2\n(slot)\nG0 X-28 Y-8\nG0 Z-1\nG1 X28\n")
    path, target = planned(cell)
    floors, _ = errors(cell, np.zeros(3))
    hole = path.features.index("hole")
    place = np.argwhere(floors.feature == hole)
    assert len(place) > 500
    away = np.hypot(floors.x[place[:, 0]] - 5 * MM, floors.y[place[:, 1]] - 5 * MM)
    assert away.max() < RADIUS
    deepest = heights_at(machined(cut_of(cell), target, path_of(cell).clock), np.array([[5 * MM, 5 * MM]]))[0]
    assert deepest == pytest.approx(-1 * MM, abs=5e-6)  # no dwell
    beside = heights_at(cut_of(cell), np.array([[0.0, 0.0], [20.1 * MM, 0.0], [0.0, -15.1 * MM]]))
    assert beside[0] == 0.0 and np.isnan(beside[1:]).all()


def test_a_mark_among_too_many_of_other_walls_counts_alone():
    """A tool that rests in a corner: more marks at one point than are looked at, all but one of the other wall."""
    other, mine, radius = 60, 1, 0.01
    normal = np.array([[0.0, 1.0]] * other + [[1.0, 0.0]] * mine)
    centre = np.column_stack([-radius * normal, np.full(other + mine, -1e-3)])  # all teeth point at the origin
    marks = np.zeros(61, MARK)
    marks["centre"], marks["normal"], marks["radius"], marks["share"] = centre, normal, radius, 0.5
    path = Stations(
        np.zeros(2), np.array([[1.0, 0, 0]] * 2), np.zeros(2), np.zeros(2, np.int64), ("corner",), np.zeros(2, bool)
    )
    near = neighbours(marks, np.array([60]), 2e-9)
    ideal = SimpleNamespace(marks=marks, staying=np.array([60]), wall_height=np.array([1e-3]), near=near)
    walls = remaining_walls(ideal, path, np.full((2, 3), 1e-5))
    np.testing.assert_allclose(walls.error, [-1e-5])  # the wall is cut 10 um too deep


# --- The STL file ---
def test_the_stl_of_a_pass_is_closed_with_normals_outward_and_the_volume_of_the_stock_without_the_chips(
    cell, ran, tmp_path
):
    path, stock, chips = tmp_path / "part.stl", cell.stock, 1e9 * ran.result.removed_volume
    count = write_part(path, cut_of(cell), ran.result, path_of(cell).clock)
    data = path.read_bytes()  # by its definition: 84 bytes, then 50 each
    assert struct.unpack_from("<I", data, 80) == (count,)
    assert len(data) == 84 + 50 * count and not data.startswith(b"solid")
    rows = np.array([struct.unpack_from("<12f", data, 84 + 50 * k) for k in range(count)])
    corners, normals = rows[:, 3:].reshape(-1, 3, 3), rows[:, :3]
    _, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    number = number.reshape(-1, 3)
    edges = np.concatenate([number[:, [0, 1]], number[:, [1, 2]], number[:, [2, 0]]])
    one_way, times = np.unique(edges, axis=0, return_counts=True)
    assert times.max() == 1  # two triangles share each edge, and run it in opposite directions
    np.testing.assert_array_equal(one_way, np.unique(edges[:, ::-1], axis=0))
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1)
    np.testing.assert_allclose(np.sum(cross * normals, axis=1), length, rtol=1e-5)
    assert length.min() > 0
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(np.prod(stock.max - stock.min) * 1e9 - chips, abs=0.01 * chips)
    np.testing.assert_allclose(corners.reshape(-1, 3).min(0), stock.min * 1e3, atol=1e-5)
    np.testing.assert_allclose(corners.reshape(-1, 3).max(0), stock.max * 1e3, atol=1e-5)
