"""The dict of the stiffness command."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import find_file
from kr270_milling.physics.robot import Mount, equilibrium
from kr270_milling.physics.robot.analysis import analyse, read_arm

ARM, BARE = read_arm(find_file("kr270_2.yaml"))
MOUNT = Mount(xyz=np.array([0.3, 0.0, 0.1]), mass=60.0)
PAPER = np.radians([90, -50, 120, 180, 25, 180])
WRENCH = np.array([300.0, -150.0, 80.0, 20.0, -10.0, 5.0])


def test_it_holds_every_documented_key_and_goes_into_json():
    found = json.loads(json.dumps(analyse(ARM, BARE, PAPER, np.zeros(6))))
    assert list(found) == ["position_m", "quaternion_xyzw", "jacobian", "stiffness", "compliance", "deflection",
                           "joint_deflection_rad", "mode_frequencies_hz", "condition_number", "warnings"]  # fmt: skip
    assert found["deflection"] == [0.0] * 6
    assert found["mode_frequencies_hz"]["lumped"][0] == pytest.approx(6.69, abs=0.005)  # facts.md


def test_a_posture_outside_the_limits_or_below_the_floor_says_so():
    assert analyse(ARM, BARE, PAPER, np.zeros(6))["warnings"] == []
    (limit,) = analyse(ARM, BARE, np.radians([190, -50, 120, 180, 25, 180]), np.zeros(6))["warnings"]
    assert limit == "axis 1 at 190 deg is outside its limits, -185 to 185 deg"
    low = analyse(ARM, BARE, np.radians([0, -10, 100, 0, 30, 0]), np.zeros(6))
    assert any("mm below the floor" in warning for warning in low["warnings"])


def test_both_frames_tell_the_same_story():
    base = analyse(ARM, MOUNT, PAPER, WRENCH, "base", gravity=True)
    turn = Rotation.from_quat(base["quaternion_xyzw"]).as_matrix().T
    both = np.kron(np.eye(2), turn)
    tool = analyse(ARM, MOUNT, PAPER, both @ WRENCH, "tool", gravity=True)
    np.testing.assert_allclose(tool["joint_deflection_rad"], base["joint_deflection_rad"], atol=1e-14)
    np.testing.assert_allclose(tool["deflection"], both @ base["deflection"], atol=1e-14)
    np.testing.assert_allclose(tool["jacobian"], both @ base["jacobian"], atol=1e-12)
    for key, unit in (("stiffness", 1e-2), ("compliance", 1e-18)):
        np.testing.assert_allclose(tool[key], both @ base[key] @ both.T, rtol=1e-9, atol=unit)
    np.testing.assert_allclose(
        tool["mode_frequencies_hz"]["consistent"], base["mode_frequencies_hz"]["consistent"], rtol=1e-9
    )


def test_a_small_wrench_deflects_the_tool_by_the_compliance():
    found = analyse(ARM, MOUNT, PAPER, 0.1 * WRENCH)
    np.testing.assert_allclose(found["deflection"], found["compliance"] @ (0.1 * WRENCH), rtol=1e-3, atol=1e-9)
    loaded = equilibrium(ARM, MOUNT, PAPER, 0.1 * WRENCH, gravity=False).pose
    np.testing.assert_allclose(np.add(found["position_m"], found["deflection"][:3]), loaded.position, atol=1e-14)


def test_the_condition_number_is_that_of_the_jacobian():
    found = analyse(ARM, MOUNT, PAPER, np.zeros(6))
    values = np.linalg.svd(found["jacobian"], compute_uv=False)
    assert found["condition_number"] == pytest.approx(values[0] / values[-1])


def test_another_frame_is_refused():
    with pytest.raises(ParameterError, match="base, tool"):
        analyse(ARM, MOUNT, PAPER, WRENCH, "world")


def test_a_cell_file_gives_its_arm_and_mount(tmp_path):
    (tmp_path / "cell.yaml").write_text(
        "/**:\n  ros__parameters:\n    includes: [kr270_2.yaml]\n    mount:\n      mass_kg: 12.0\n"
        "    workpiece:\n      anything: 1\n"
    )
    arm, mount = read_arm(tmp_path / "cell.yaml")
    assert arm.name == "KR 270-2" and mount.mass == 12.0
