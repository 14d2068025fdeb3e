"""Maps of placements, turns of the tool along a path, and sweeps."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
from hostile import answered, refused, settings

from kr270_milling.base.errors import ModelError, ParameterError
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.physics.motion.arm_model import modal_models
from kr270_milling.physics.robot import compliance, equilibrium, pose
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.arm import GravityCompensator
from kr270_milling.studies.maps.along import Turns, best_turns, constant_turn
from kr270_milling.studies.maps.placements import PathPlaces, Placements, moved_cell, present_row
from kr270_milling.studies.maps.postures import whole_turns
from kr270_milling.studies.maps.sweep import Axis, Sweep, parse_axis

parquet = pytest.importorskip("pyarrow.parquet")


def line(start, end, count: int, force) -> PathPlaces:
    """Places from start to end [m] with the tool down and a constant force [N]."""
    feed = np.subtract(end, start) / np.linalg.norm(np.subtract(end, start))
    down = np.tile(np.diag([1.0, -1.0, -1.0]), (count, 1, 1))
    return PathPlaces(np.linspace(start, end, count), down, np.tile(feed, (count, 1)), np.tile(force, (count, 1)))


@pytest.fixture(scope="module")
def placements() -> Placements:
    cell = read_cell(find_file("test_piece.yaml"), ["dynamics.gravity=false"])
    places = line([-0.04, 0.0, -1e-3], [0.04, 0.0, -1e-3], 5, [-40.0, 150.0, 5.0])
    axes = (np.array([1.4, 1.5]), np.array([-0.1, 0.1]), np.array([0.8]), np.radians([0.0, 20.0]),
            np.radians([-30.0, 0.0]))  # fmt: skip
    return Placements(arm_of(cell), cell.uncertainty.left, places, axes)


def test_a_feasible_row_is_what_finite_differences_of_the_arm_give(placements):
    chosen = placements.placements(0, len(placements))
    rows = placements.rows(chosen)
    number, branch = np.argwhere(rows["feasible"])[3]
    x, y, z, turn, tool_turn = chosen[number]
    row = {"x_mm": 1e3 * x, "y_mm": 1e3 * y, "z_mm": 1e3 * z, "turn_deg": np.degrees(turn),
           "tool_turn_deg": np.degrees(tool_turn), "branch": branch}  # fmt: skip
    moved = moved_cell(placements.arm, placements.places, row, "posture_deg")
    place = moved["workpiece"]
    settings = [f"workpiece.xyz_mm={place['xyz_mm']}", f"workpiece.abc_deg={place['abc_deg']}"]
    settings += [f"mount.abc_deg={moved['mount']['abc_deg']}", f"posture_hint_deg={moved['posture_deg']}"]
    cell = read_cell(find_file("test_piece.yaml"), settings)
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (5, 1))  # the tool down
    q = arm_of(cell).joints_at(placements.places.position, quaternion)  # independent: the path of the cell itself
    across = []
    for joints in q:
        step = 1e-6
        here = pose(cell.arm, cell.mount, joints).position
        turned = [(pose(cell.arm, cell.mount, joints + step * e).position - here) / step for e in np.eye(6)]
        turned = np.stack(turned, axis=1)
        force = cell.workpiece.pose.rotation @ placements.places.force[0]
        way = turned @ (cell.arm.joint_compliance * (turned.T @ force))
        feed = cell.workpiece.pose.rotation[:, 0]
        across.append(np.linalg.norm(way - way @ feed * feed))
    assert rows["error_max_um"][number, branch] == pytest.approx(1e6 * max(across), rel=1e-4)
    assert rows["error_mean_um"][number, branch] == pytest.approx(1e6 * np.mean(across), rel=1e-4)


def test_of_the_whole_turns_within_the_limits_the_most_central_are_taken():
    """175 deg is 360 deg more than -185 deg, the limit; a run over the seam has no jump."""
    limits = np.radians([185.0] * 6)
    q = np.radians([[-184.9, 170.0, -170.0, 0.0, 200.0, 350.0], [-184.5, -179.0, 176.0, 1.0, 201.0, 351.0]])
    assert whole_turns(q, -limits, limits)
    expected = [[175.1, 170.0, -170.0, 0.0, -160.0, -10.0], [175.5, 181.0, -184.0, 1.0, -159.0, -9.0]]
    assert np.degrees(q) == pytest.approx(np.array(expected))
    q[0, 0] -= np.radians(20.0)
    assert whole_turns(q, -limits, limits)
    q[0, 2] += np.radians(20.0)
    q[1, 2] -= np.radians(2.0)  # from -150 to -186 deg, or from 210 to 174 deg
    assert not whole_turns(q, -limits, limits)


def test_the_compensator_and_the_lowest_mode_are_those_of_the_loaded_arm(placements):
    """A stiff spring, made so long that it pulls nothing there: else its own pull would bend the arm."""
    place, whole = np.array([[1.5, 0.0, 0.8, 0.0, 0.0]]), placements.places
    places = PathPlaces(whole.position[2:3], whole.rotation[2:3], whole.feed[2:3], np.array([[0.0, 0.0, 150.0]]))
    spring = GravityCompensator(stiffness=20e6, base_x=-0.69, base_z=0.12, arm_length=0.4)
    cell = read_cell(find_file("test_piece.yaml"))
    rows = Placements(arm_of(cell), placements.left, places, placements.axes).rows(place)
    branch = int(np.flatnonzero(rows["feasible"][0])[0])
    row = {"x_mm": 1500.0, "y_mm": 0.0, "z_mm": 800.0, "turn_deg": 0.0, "tool_turn_deg": 0.0, "branch": branch}
    q = np.radians(moved_cell(arm_of(cell), places, row, "posture_deg")["posture_deg"])
    long = spring.length(np.cos(q[1]), np.sin(q[1]))
    slack = spring.replace(preload=20e6 * (spring.length(0.0, -1.0) - long))
    ours = []
    for compensator in (GravityCompensator(), slack):
        arm = cell.arm.replace(compensator=compensator)
        made = Placements(arm_of(cell.replace(arm=arm)), placements.left, places, placements.axes).rows(place)
        model = modal_models(arm, cell.mount, cell.dynamics, cell.workpiece.pose, q[None])[0]
        assert made["lowest_mode_hz"][0, branch] == pytest.approx(model.frequency[0] / (2 * np.pi), rel=0.01)
        way = compliance(equilibrium(arm, cell.mount, q), arm)[:3, :3] @ places.force[0]
        ours.append(made["compliance_um_per_n"][0, branch])
        assert ours[-1] == pytest.approx(1e6 * np.linalg.norm(way) / 150.0, rel=0.005)
    assert ours[1] < 0.95 * ours[0]


def test_turning_everything_about_axis_1_changes_nothing_else_and_a_place_out_of_reach_has_no_errors(placements):
    c, s = np.cos(0.5), np.sin(0.5)
    places = [1.4, 0.1, 0.8, 0.3, 0.2], [1.4 * c - 0.1 * s, 1.4 * s + 0.1 * c, 0.8, 0.8, 0.2], [9.0, 0.0, 0.8, 0.0, 0.0]
    one, other, far = (placements.rows(np.array([place])) for place in places)
    np.testing.assert_allclose(one["error_max_um"], other["error_max_um"], rtol=1e-9)
    np.testing.assert_allclose(one["singularity"], other["singularity"], rtol=1e-9)
    assert not far["feasible"].any() and not far["reachable"].any() and np.isnan(far["error_max_um"]).all()


def test_the_present_row_is_on_the_branch_of_the_joints_that_the_cell_commands(placements):
    cell, places = read_cell(find_file("test_piece.yaml"), ["dynamics.gravity=false"]), placements.places
    row = present_row(placements, path_of(cell).target)
    assert [row["x_mm"], row["y_mm"], row["z_mm"]] == pytest.approx(1e3 * cell.workpiece.xyz)
    assert row["feasible"] and row["error_max_um"] > 0.0
    joints = arm_of(cell).joints_at(places.position, np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)))[2]
    np.testing.assert_allclose(
        moved_cell(arm_of(cell), places, row, "posture_deg")["posture_deg"], np.degrees(joints), atol=1e-6
    )


def test_the_map_of_the_command_ends_in_cells_that_may_be_read(tmp_path):
    words = ["map", "paper.yaml", "--x=-100:100/2", "--y=-1700:-1500/2", "--out", tmp_path / "map"]
    result = answered(*words, *settings("path.length_mm=6", "stock.grid_step_um=40"))
    assert result["rows"] == 4 * 8 and result["rows_per_s"] > 0 and result["best"] and len(result["best"]) <= 5
    assert f">{result['present']['error_max_um']:.2f}<" in (tmp_path / "map" / "map.html").read_text()
    errors = [row["error_max_um"] for row in result["best"]]
    assert errors == sorted(errors)
    best = read_cell(result["best"][0]["cell"])
    assert 1e3 * best.workpiece.xyz[:2] == pytest.approx([result["best"][0]["x_mm"], result["best"][0]["y_mm"]])
    assert arm_of(best).joints(path_of(best).target).shape[1] == 6


# --- Sweeps: axes, samples, rows that do not depend on the chunk. Workers are in ``test_engine`` ---
SHORT = ("path.length_mm=4", "stock.grid_step_um=40", "stock.max_mm=[4,12,0]")


def sweep(**more) -> Sweep:
    axes = (Axis("path.depth_of_cut_mm", (0.2, 0.4)), Axis("tool.teeth", (2.0, 4.0)))
    return Sweep(str(find_file("paper.yaml")), SHORT, axes, **more)


def test_axes_are_ranges_or_lists_of_a_key_that_a_cell_has():
    assert parse_axis("tool.teeth=2:6:2") == Axis("tool.teeth", (2.0, 4.0, 6.0))
    assert parse_axis("tool.teeth=2:6/3") == parse_axis("tool.teeth=2:6:2")
    assert parse_axis("path.depth_of_cut_mm=0.2:2:0.2").values[-1] == pytest.approx(2.0)
    assert parse_axis("dynamics.mass_model=lumped,rigid").values == ("lumped", "rigid")
    for text in ("teeth", "teeth=", "teeth=1:0:1", "teeth=1:2:0", "teeth=1:2/0.5", "=1,2", "x=1:2:nan"):
        with pytest.raises(ParameterError):
            parse_axis(text)
    with pytest.raises(ParameterError, match="did you mean tool.teeth"):
        Sweep(str(find_file("paper.yaml")), (), (Axis("tool.teth", (2.0,)),))


def test_a_grid_has_every_combination_and_a_hypercube_every_stratum():
    assert [sweep().values(i) for i in range(4)] == [(0.2, 2.0), (0.2, 4.0), (0.4, 2.0), (0.4, 4.0)]
    drawn = sweep(samples=40)
    values = np.array([drawn.values(i) for i in range(40)])
    for column, low, high in ((0, 0.2, 0.4), (1, 2.0, 4.0)):
        strata = np.floor((values[:, column] - low) / (high - low) * 40)
        assert sorted(strata) == list(range(40))


def test_the_rows_are_plain_passes_whatever_the_chunk():
    def rows(chunk):
        made = sweep(chunk=chunk)
        return [row for n in range(made.chunks) for row in parquet.read_table(io.BytesIO(made(n))).to_pylist()]

    one, all_at_once = rows(1), rows(4)
    assert one == all_at_once and [row["index"] for row in one] == [0, 1, 2, 3]
    cell = read_cell(find_file("paper.yaml"), [*SHORT, "path.depth_of_cut_mm=0.4", "tool.teeth=2"])
    assert one[2]["max_deviation_um"] == 1e6 * simulate(cell).scores.max_deviation


def test_every_spindle_speed_runs_with_the_nearest_period_of_whole_micro_steps():
    """The cell has 0.5 ms, 24 steps of 1 deg at 8000 rpm; at 7400 rpm a step takes 1 / 44.4 ms: 22.2 of them."""
    made = Sweep(str(find_file("paper.yaml")), SHORT, (Axis("tool.spindle_speed_rpm", (7400.0, 8000.0, 0.0)),))
    rows = [made.row(index) for index in range(3)]
    assert [row["exchange.period_ms"] for row in rows] == pytest.approx([22 / 44.4, 0.5, 0.5], rel=1e-12)
    assert [bool(row["error"]) for row in rows] == [False, False, True] and "spindle_speed" in rows[2]["error"]
    assert rows[2]["tool.spindle_speed_rpm"] == 0.0  # a failure is a row
    own = Sweep(made.cell, SHORT, (*made.axes, Axis("exchange.period_ms", (0.5,))))
    assert "whole number of micro-steps" in own.row(0)["error"]  # what was asked for is not changed


# --- The turn of the tool along a path ---
GRID = np.radians(np.arange(-90.0, 91.0, 10.0))
ARM, _ = read_arm(find_file("kr270_2.yaml"))


class Known(Turns):
    """Joint 6 turns with the tool, and the error is the distance from a wish [rad] at each place."""

    def at(self, turn):
        q = np.zeros((*turn.shape, 8, 6))
        q[..., 1:3] = np.radians([-80.0, 100.0])
        q[..., 5] = (turn[..., None] + np.pi) % (2 * np.pi) - np.pi
        away = (turn - self.places.wish[:, None] + np.pi) % (2 * np.pi) - np.pi
        return q, np.abs(away)[..., None] * np.where(np.arange(8) == 2, 1.0, 2.0)


def known(wish: np.ndarray, weight: float, step: float = 1.0) -> Known:
    places = SimpleNamespace(wish=wish, position=np.zeros((len(wish), 3)))
    return Known(SimpleNamespace(arm=ARM), places, step, weight)


def test_a_wish_and_a_price_of_turning_have_a_closed_solution():
    """d/dpsi of sum (psi_k - a_k)^2 + (w / dt)^2 sum (psi_k+1 - psi_k)^2 = 0 is a linear system."""
    wish = np.sin(np.linspace(0.0, 6.0, 40)) + 0.3
    matrix = np.eye(40)
    for k in range(39):
        matrix[k : k + 2, k : k + 2] += 4.0 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    exact = np.linalg.solve(matrix, wish)
    way = best_turns(known(wish, 2.0), GRID)
    assert way.branch == 2  # the others have twice the error
    assert way.turn == pytest.approx(exact, abs=2e-3)
    value = np.mean((exact - wish) ** 2) + 4.0 * np.sum(np.diff(exact) ** 2) / 40
    assert way.value**2 == pytest.approx(value, rel=1e-5)


def test_a_jump_is_taken_as_fast_as_the_joint_turns():
    """A wish that jumps by 0.8 rad in the middle is left and met on one straight line, half on each side."""
    way = best_turns(known(np.where(np.arange(41) < 20, 0.0, 0.8), 1e-6, 0.05), GRID)
    room = ARM.joint_speed_limit[5] * 0.05
    exact = np.clip(0.4 + room * (np.arange(41) - 19.5), 0.0, 0.8)
    assert np.abs(np.diff(way.turn)).max() <= room * (1 + 1e-9)
    assert np.sum((way.turn - exact) ** 2) < 0.02 * np.sum((np.where(np.arange(41) < 20, 0.0, 0.8) - exact) ** 2)


def test_a_whole_turn_has_no_seam():
    wish = np.radians(np.linspace(150.0, 210.0, 60))
    way = best_turns(known(wish, 1e-3), np.radians(np.arange(-180.0, 181.0, 10.0)))
    assert way.value < 2e-3
    assert np.ptp(way.turn) == pytest.approx(np.ptp(wish), abs=0.02)
    assert np.abs(np.diff(way.q[:, 5])).max() < 0.1  # joint 6 has room for it and makes no jump


def test_no_turn_that_stays_the_same_is_better_joints_keep_to_their_limits_and_what_is_too_fast_is_refused():
    """A cut of 1.2 m across the front of the arm in 24 s, the spindle across axis 6."""
    places = line([0.0, -0.6, 0.0], [0.0, 0.6, 0.0], 49, [150.0, -40.0, -20.0])
    across = Turns(arm_of(read_cell(find_file("test_piece.yaml"))), places, 0.5, np.degrees(0.05e-6))
    grid = np.radians(np.arange(-180.0, 181.0, 10.0))
    way, arm = best_turns(across, grid), across.arm.arm
    same = constant_turn(across, np.radians(np.arange(-180.0, 181.0, 2.0)))
    assert way.value < 0.99 * same.value
    turning = np.degrees(np.gradient(way.turn, 0.5))
    own = np.sqrt(np.mean((1e6 * way.error) ** 2) + np.mean((0.05 * turning) ** 2))  # the criterion once more
    assert 1e6 * way.value == pytest.approx(own, rel=0.01)
    assert np.all(np.abs(np.diff(way.q, axis=0)) <= arm.joint_speed_limit * 0.5)
    assert np.all((way.q >= arm.joint_lower) & (way.q <= arm.joint_upper))
    with pytest.raises(ModelError, match="lower the feed"):
        best_turns(Turns(across.arm, places, 1e-3, across.weight), GRID)


def test_the_command_writes_a_cell_that_runs(tmp_path):
    words = ["map", "test_piece.yaml", "--along", "--places", "20", "--tool-turn=-60:60/13", "--out", str(tmp_path)]
    slot = ("path.file=''", "path.start_mm=[-60,0]", "path.length_mm=15", "path.depth_of_cut_mm=1",
            "path.feed_rate_m_per_min=4", "stock.grid_step_um=60")  # fmt: skip
    result = answered(*words, *settings(*slot))
    assert result["criterion_um"] <= result["criterion_constant_um"] and max(result["joint_speed_share"]) < 1.0
    cell, old = read_cell(result["best"][0]["cell"]), read_cell(find_file("test_piece.yaml"), slot)
    run = path_of(cell).target
    assert run.position == pytest.approx(path_of(old).target.position, abs=1e-12)
    assert arm_of(cell).joints(run).shape == (len(run), 6)
    assert len((tmp_path / "along.csv").read_text().splitlines()) == len(run) + 1
    assert refused(*words, "--x", "1:2/2")
