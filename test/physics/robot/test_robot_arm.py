"""Arm and mount records and the two shipped arm files."""

import numpy as np
import pytest

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import ConfigError, build, find_file, read_tree
from kr270_milling.physics.robot import Arm, Mount, pose
from kr270_milling.physics.robot.analysis import read_arm

PAPER = np.radians([90, -50, 120, 180, 25, 180])
#: at the paper's pose [facts.md, The arm]
FLANGES = {"kr270_2.yaml": [0, -1.6407, 0.4924], "kr270_r2700_ultra.yaml": [0, -1.6308, 0.2446]}


@pytest.mark.parametrize("name", FLANGES)
def test_both_arms_reach_the_paper_posture_where_the_data_sheets_put_the_flange(name):
    arm, mount = read_arm(find_file(name))
    np.testing.assert_allclose(pose(arm, mount, PAPER).position, FLANGES[name], atol=5e-5)
    assert np.all((arm.joint_lower <= PAPER) & (arm.joint_upper >= PAPER))


@pytest.mark.parametrize("name", FLANGES)
def test_table_1_of_the_paper_stands_in_both_arm_files(name):
    arm, _ = read_arm(find_file(name))
    np.testing.assert_allclose(1 / arm.joint_stiffness, np.array([0.26, 0.15, 0.26, 1.79, 1.52, 2.13]) * 1e-6)
    assert arm.link_mass.sum() == pytest.approx(790.4)


def test_a_bare_arm_file_has_its_tool_point_at_the_flange():
    _, mount = read_arm(find_file("kr270_2.yaml"))
    np.testing.assert_array_equal(mount.pose.rotation, np.eye(3))


def test_the_default_mount_points_z_out_of_the_flange():
    np.testing.assert_allclose(Mount().pose.rotation[:, 2], [1, 0, 0], atol=1e-15)


def test_limits_that_leave_no_range_are_refused_with_the_key_of_the_file():
    tree = read_tree(find_file("kr270_2.yaml"))["arm"]
    tree["joint_upper_deg"] = [185.0, -200.0, 155.0, 350.0, 125.0, 350.0]
    with pytest.raises(ConfigError, match="joint_upper_deg.*above joint_lower_deg"):
        build(Arm, tree)


def test_a_spring_without_compliance_and_a_nan_mass_are_refused():
    arm, _ = read_arm(find_file("kr270_2.yaml"))
    with pytest.raises(ParameterError, match="joint_compliance_urad_per_n_m"):
        arm.replace(joint_compliance=np.zeros(6))
    with pytest.raises(ParameterError, match="mass_kg"):
        Mount(mass=float("nan"))


def test_an_unknown_key_in_an_arm_file_is_refused(tmp_path):
    text = find_file("kr270_2.yaml").read_text().replace("d1_m:", "d_1_m:")
    (tmp_path / "arm.yaml").write_text(text)
    with pytest.raises(ConfigError, match="arm.d_1_m is not a known key|d_1_m.*not a known key"):
        read_arm(tmp_path / "arm.yaml")
