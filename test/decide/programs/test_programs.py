"""The programs of a cell, read back by a reader written here and run on an arm chain written here."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from krl_robot import Robot
from scipy.spatial.transform import Rotation
from small_part import small_part

from kr270_milling.base.errors import InputError
from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import commanded_joints
from kr270_milling.decide.programs.files import write_programs
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.path.trajectory_csv import read_csv

DATE = "2030-01-01T00:00:00+00:00"


def flange(arm, q) -> np.ndarray:
    """$FLANGE of the chain in facts: T(0,0,d1) Rz(-q1) T(a1,0,0) Ry(q2) ... Rx(-q6), then z out of the flange."""

    def move(x=0.0, z=0.0):
        t = np.eye(4)
        t[[0, 2], 3] = x, z
        return t

    def turn(axis, angle):
        t = np.eye(4)
        t[:3, :3] = Rotation.from_euler(axis, angle).as_matrix()
        return t

    chain = [move(z=arm.d1), turn("z", -q[0]), move(x=arm.a1), turn("y", q[1]), move(x=arm.a2), turn("y", q[2]),
             move(z=arm.a3), turn("x", -q[3]), move(x=arm.d4), turn("y", q[4]), move(x=arm.d6), turn("x", -q[5]),
             turn("y", np.pi / 2)]  # fmt: skip
    return np.linalg.multi_dot(chain)


def wavy(target: Trajectory, size: float = 50e-6) -> Trajectory:
    """A correction in all three components, at rest where the target rests."""
    still = np.zeros(len(target), bool) if target.velocity is None else ~target.velocity.any(axis=1)
    shift = size * np.sin(np.outer(target.time, [20.0, 30.0, 40.0])) * ~still[:, None]
    return target.with_position(target.position + shift, target.velocity)


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return small_part(tmp_path_factory.mktemp("part"))


@pytest.mark.parametrize("motion", ["LIN", "SPLINE"])
@pytest.mark.parametrize("kind", ["ORG", "CMP"])
def test_programs_bring_the_flange_where_the_joint_positions_do(cell, tmp_path, motion, kind):
    target = cell.target()
    run = wavy(target) if kind == "CMP" else target
    write_programs(tmp_path, cell, target, wavy(target), method="wavy", date=DATE, motions=(motion,))
    read = Robot(next(tmp_path.glob(f"krl_{motion.lower()}_*")), f"MILLING_{kind}")
    (table,) = tmp_path.glob(f"joints_{'wavy' if kind == 'CMP' else 'original'}_*.csv")
    table = np.loadtxt(table, delimiter=",", skiprows=1)
    knots = read.numbers - 1
    reached = np.array([flange(cell.arm, np.radians(q)) for q in table[knots, 1:]])
    told = read.matrix("BASE") @ read.transforms @ np.linalg.inv(read.matrix("TOOL"))
    assert np.abs(told[:, :3, 3] - reached[:, :3, 3]).max() < 1e-6
    turned = Rotation.from_matrix(np.swapaxes(told[:, :3, :3], 1, 2) @ reached[:, :3, :3])
    assert np.degrees(turned.magnitude()).max() < 1e-3
    assert np.abs(read.transforms[:, :3, 3] - run.position[knots]).max() < 1e-6
    assert table[:, 0] == pytest.approx(run.time, abs=1e-9)
    away = np.linalg.norm(np.diff(run.position[knots], axis=0), axis=1)
    least = 0.9 * cell.program.point_spacing
    assert away.min() > least and len(knots) > 0.9 * len(run)  # nothing but close points is left out


def test_tool_and_base_are_mount_and_workpiece_as_the_controller_sees_them(cell, tmp_path):
    write_programs(tmp_path, cell, cell.target(), cell.target(), method="same", date=DATE)
    text = (next(tmp_path.glob("krl_spline_*")) / "MILLING_ORG.src").read_text()
    # the paper's spindle in line with axis 6: for a KUKA, whose flange has z along axis 6, a tool without turns
    assert "$TOOL={X 0.0000,Y 0.0000,Z 0.0000,A 0.00000,B 0.00000,C 0.00000}" in text
    x, y, z = 1e3 * cell.workpiece.pose.position
    assert f"$BASE={{X {abs(x):.4f},Y {y:.4f},Z {z:.4f},A 90.00000,B 45.00000,C 0.00000}}" in text
    assert "VERIFY IN T1" in text and DATE in text and re.search(r"sha256 of this trajectory [0-9a-f]{64}", text)


def test_load_centre_is_told_in_the_axes_of_the_controllers_flange(tmp_path):
    cell = read_cell(find_file("test_piece.yaml"))
    part = Trajectory(*(a[:3] for a in (cell.target().time_ns, cell.target().position, cell.target().quaternion)))
    write_programs(tmp_path, cell, part, part, method="same", date=DATE)
    text = (next(tmp_path.glob("krl_spline_*")) / "MILLING_ORG.src").read_text()
    # 130 mm out of the flange and 60 mm below it: out of the flange is the controller's z, up is its minus x
    assert "$LOAD={M 45.000,CM {X 60.000,Y 0.000,Z 130.000" in text


def test_an_axis_at_zero_gets_an_approach_beside_it_so_that_its_turn_is_certain(tmp_path):
    """A part straight ahead: A1, A4 and A6 start at exactly 0, and rounding would decide what T says of them."""
    cell = read_cell(find_file("test_piece.yaml"))
    time_ns, quaternion = np.arange(3) * 12_000_000, cell.target().quaternion[0]
    line = Trajectory(time_ns, np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], [2e-3, 0.0, 0.0]]), quaternion)
    for sign in (1.0, -1.0):
        beside = line.with_position(line.position + [0.0, sign * 1e-5, 0.0])
        folder = tmp_path / f"{sign:g}"
        write_programs(folder, cell, line, beside, method="beside", date=DATE)
        for kind, run in (("ORG", line), ("CMP", beside)):
            robot = Robot(next(folder.glob("krl_spline_*")), f"MILLING_{kind}")
            above = np.array(robot.approach) / 1e3
            assert np.linalg.norm(above[:2] - run.position[0, :2]) < 0.5e-3 and above[2] >= 0.05
            (joints,) = cell.joints_at(above[None], quaternion[None])
            assert np.degrees(np.abs(joints)).min() > 1e-3
            assert robot.turn == sum(1 << axis for axis in range(6) if joints[axis] < 0)


def test_sag_is_in_the_points_where_the_controller_does_not_compensate_it(cell, tmp_path):
    own = cell.replace(compensation=cell.compensation.replace(sag_compensated=False))
    line = Trajectory(np.arange(4) * 10**8, np.outer(np.arange(4), [1e-3, 0, 0]), cell.target().quaternion[0])
    write_programs(tmp_path, own, line, line, method="same", date=DATE)
    read = Robot(next(tmp_path.glob("krl_spline_*")), "MILLING_ORG")
    told = read.matrix("BASE") @ read.transforms @ np.linalg.inv(read.matrix("TOOL"))
    reached = np.array([flange(own.arm, q) for q in commanded_joints(own, line)])
    assert np.abs(told[:, :3, 3] - reached[:, :3, 3]).max() < 1e-6
    lifted = (own.workpiece.pose.apply(read.transforms[:, :3, 3]) - own.workpiece.pose.apply(line.position))[:, 2]
    assert np.all(lifted > 0.1e-3)  # 700 kg of arm bend it by tenths of a millimetre


def test_offsets_are_the_difference_of_the_two_programs(cell, tmp_path):
    target = cell.target()
    files = write_programs(tmp_path, cell, target, wavy(target), method="wavy", date=DATE)
    table = np.loadtxt(files["rsi"][0], delimiter=",", skiprows=1)
    stamps = np.rint(table[:, 0] * 1e9).astype(np.int64)
    assert set(np.diff(stamps)) == {12_000_000}
    shift = wavy(target).sample(stamps) - target.sample(stamps)
    assert table[:, 1:4] == pytest.approx(shift * 1e3, abs=1e-6)


def test_revised_trajectory_is_read_back_to_the_last_bit(cell, tmp_path):
    target = cell.target()
    files = write_programs(tmp_path, cell, target, wavy(target), method="wavy", date=DATE)
    back, joints = read_csv(files["trajectory"][0])
    assert np.array_equal(back.position, wavy(target).position) and np.array_equal(back.time_ns, target.time_ns)
    assert joints == pytest.approx(commanded_joints(cell, back), abs=1e-9)


def test_same_input_and_date_give_the_same_files(cell, tmp_path):
    def written(folder) -> dict[str, bytes]:
        write_programs(folder, cell, cell.target(), wavy(cell.target()), method="wavy", date=DATE, source="ab" * 32)
        return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}

    assert written(tmp_path / "a") == written(tmp_path / "b")


def test_the_fingerprint_of_a_path_is_that_of_its_file(cell):
    import hashlib

    assert cell.programmed.sha256 == hashlib.sha256(Path(cell.path.file).read_bytes()).hexdigest()
    assert read_cell(find_file("paper.yaml")).programmed.sha256 == ""


@pytest.mark.parametrize("method", ["../x", "", "a/b", "x" * 41])
def test_a_method_that_is_no_file_name_is_refused(cell, tmp_path, method):
    with pytest.raises(InputError, match="method"):
        write_programs(tmp_path / "out", cell, cell.target(), cell.target(), method=method, date=DATE)
    assert not (tmp_path / "out").exists()
