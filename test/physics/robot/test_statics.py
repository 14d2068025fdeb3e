"""Torques of loads, equilibria, stiffness and compliance of loaded arms: pinocchio, differences, closed forms."""

import json
import math

import numpy as np
import pinocchio as pin
import pytest
from arm_oracle import ARM, ARMS, ON_BASE, PAPER, POSTURES, SPINDLE, TURNED, UNEVEN, arm_of, pinocchio_arm
from book import check
from scipy.spatial.transform import Rotation

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.frames import Pose
from kr270_milling.physics.robot import BARE, compliance, equilibrium, forward, jacobian, pose, stiffness
from kr270_milling.physics.robot.analysis import analyse, read_arm
from kr270_milling.physics.robot.arm import GravityCompensator
from kr270_milling.physics.robot.elastostatics import wrench_for_pose
from kr270_milling.physics.robot.errors import DeflectionError, EquilibriumError, SingularityError, UnstableLoadError
from kr270_milling.physics.robot.kinematics import rotate_matrix, singularity_measures
from kr270_milling.physics.robot.loads import link_loads, load_hessian, load_torque
from kr270_milling.studies.maps.postures import postures as reaching

RNG = np.random.default_rng(11)
NEAR = PAPER + RNG.uniform(-0.3, 0.3, (50, 6))
LOADS = RNG.normal(size=(50, 6)) * [600, 600, 600, 100, 100, 100]
#: an arm with only joint 2 soft, 1e6 N m/rad, stretched along x; its critical load [N]
HINGE = ARM.replace(a3=0.0, joint_compliance=np.array([1e-12, 1e-6, 1e-12, 1e-12, 1e-12, 1e-12]))
CRITICAL = 1e6 / (1.25 + 1.1 + 0.23)
STRAIGHT = PAPER * [1, 1, 1, 1, 0, 1]  # axis 5 at 0: singular
SOFT = ((0.7168e-6, 0.6369e-6, 0.1489e-6), (0.7099e-6, 0.7535e-6, 0.1313e-6))  # [m/N], [derived], facts
ALONG = ("the lateral axis", "the axis in plane", "the flange axis")
NONE = np.zeros((100, 6))


@check("torque of the link weights at 100 postures", "pinocchio", "N m")
def test_pinocchio_gravity():
    model, data, _ = pinocchio_arm(UNEVEN, TURNED)
    motors = [pin.computeGeneralizedGravity(model, data, q) for q in POSTURES]  # what holds the arm up
    ours = load_torque(forward(UNEVEN, TURNED, POSTURES), NONE, link_loads(UNEVEN, TURNED))
    return 0.0, np.abs(ours + motors).max(), 1e-9


@check("derivative of that torque", "pinocchio", "N m/rad")
def test_pinocchio_gravity_derivative():
    model, data, _ = pinocchio_arm(UNEVEN, TURNED)
    theirs = [pin.computeGeneralizedGravityDerivatives(model, data, q) for q in POSTURES]
    ours = load_hessian(forward(UNEVEN, TURNED, POSTURES), NONE, link_loads(UNEVEN, TURNED))
    return 0.0, np.abs(ours + theirs).max(), 1e-9


@check("equilibrium (7): largest torque out of balance", "0: torques of weights and 1 kN balance, 50 postures", "N m")
def test_residual():
    solved = equilibrium(ARM, SPINDLE, NEAR, LOADS)
    torque = load_torque(forward(ARM, SPINDLE, solved.posture), LOADS, link_loads(ARM, SPINDLE))
    np.testing.assert_array_equal(solved.pose.position, pose(ARM, SPINDLE, NEAR + solved.theta).position)
    np.testing.assert_array_equal(solved.jacobian, jacobian(ARM, SPINDLE, solved.posture))
    return 0.0, max(np.abs(ARM.spring_stiffness * solved.theta - torque).max(), solved.residual.max()), 1e-9


@check(
    "wrench of a loaded pose, f of (31) after f^-1 of (30), {weights}, {base} base",
    "self-consistent: the wrench that bent the arm", "N, N m",
    cases=("weights base", [("with weights", "rigid"), ("without", "rigid"), ("with weights", "tilting")]),
)  # fmt: skip
def test_both_ways(weights, base):
    gravity, arm = weights == "with weights", ARM if base == "rigid" else ON_BASE
    there = equilibrium(arm, SPINDLE, NEAR, LOADS, gravity)
    back = wrench_for_pose(arm, SPINDLE, NEAR, there.pose, gravity)
    np.testing.assert_allclose(back.theta, there.theta, atol=1e-10)
    assert back.residual.max() <= 1e-9 and back.iterations.max() <= 5  # quadratic: 1e-3 rad to 1e-12 in few steps
    return 0.0, np.abs(back.wrench - LOADS).max(), 1e-4  # 1e-12 m and rad times 1e7 N m/rad, some singular


def test_a_batch_gives_exactly_what_single_postures_give_and_maps_of_postures_have_the_same_base():
    batch = equilibrium(ARM, SPINDLE, NEAR.reshape(5, 10, 6), LOADS.reshape(5, 10, 6))
    single = equilibrium(ARM, SPINDLE, NEAR[23], LOADS[23])
    np.testing.assert_array_equal(batch.theta[2, 3], single.theta)
    np.testing.assert_array_equal(batch.hessian[2, 3], single.hessian)
    assert equilibrium(ARM, SPINDLE, np.empty((0, 6))).theta.shape == (0, 6)
    assert equilibrium(ARM, SPINDLE, PAPER, LOADS).theta.shape == (50, 6)
    place = pose(ARM, SPINDLE, PAPER)
    force = np.array([[300.0, -200.0, 100.0]])
    _, way = reaching(ON_BASE, SPINDLE, Pose(place.position[None], place.rotation[None]), force, gravity=False)
    soft = compliance(equilibrium(ON_BASE, SPINDLE, PAPER, gravity=False), ON_BASE)[:3, :3]
    assert np.abs(way[0] - soft @ force[0]).max(1).min() == pytest.approx(0.0, abs=1e-12)


@check("column on one hinge: H / K at {share} of its critical load", "H = F L, critical at F L = K",
       cases=("share", [(0.5,), (0.99,)]))  # fmt: skip
def test_column(share):
    solved = equilibrium(HINGE, BARE, np.zeros(6), [-share * CRITICAL, 0, 0, 0, 0, 0], gravity=False)
    np.testing.assert_allclose(solved.theta, 0, atol=1e-15)
    return share, solved.hessian[1, 1] / 1e6, 1e-9


@check("hinge under a dead side load", "K theta = F L cos(theta)", "rad")
def test_dead_load():
    """Large enough for the load steps."""
    theta = equilibrium(HINGE, BARE, np.zeros(6), [0, 0, -0.15 * CRITICAL, 0, 0, 0], gravity=False).theta[1]
    return 0.15 * np.cos(theta), theta, 1e-8


def test_what_has_no_equilibrium_or_no_stiffness_is_an_error_with_joint_base_and_share_of_the_load():
    with pytest.raises(UnstableLoadError, match="unstable") as caught:
        equilibrium(HINGE, BARE, np.stack([np.zeros(6)] * 2), [[0.0] * 6, [-1.01 * CRITICAL, 0, 0, 0, 0, 0]], False)
    assert caught.value.index == (1,) and caught.value.eigenvalue < 0
    assert caught.value.load_factor == pytest.approx(1.0, abs=0.01)
    with pytest.raises(DeflectionError, match="joint 2") as caught:
        equilibrium(HINGE, BARE, np.zeros(6), [0, 0, -0.5 * CRITICAL, 0, 0, 0], gravity=False)
    theta, share = caught.value.deflection, caught.value.load_factor
    assert theta == pytest.approx(share * 0.5 * np.cos(theta)) and theta > 0.2
    soft = ARM.replace(joint_compliance=np.full(6, 1e-2))  # too soft for its weight
    with pytest.raises((UnstableLoadError, EquilibriumError, DeflectionError), match="load"):
        equilibrium(soft, SPINDLE, PAPER * [1, 1, 1, 1, 1, 0])
    with pytest.raises(EquilibriumError):
        equilibrium(ARM, SPINDLE, PAPER, [np.nan, 0, 0, 0, 0, 0])
    away = pose(ARM, SPINDLE, PAPER)
    with pytest.raises((EquilibriumError, SingularityError)):
        wrench_for_pose(ARM, SPINDLE, PAPER, Pose(away.position + [0, -3.0, 0], away.rotation))
    column = ARM.replace(joint_compliance=np.full(6, 1e-18), base_compliance=np.array([0.0, 1e-5, 0.0]))
    with pytest.raises(DeflectionError, match="the base bends"):
        equilibrium(column, SPINDLE, np.radians([0.0, -10.0, 20.0, 0.0, 25.0, 0.0]), [0, 0, -1e4, 0, 0, 0])
    solved = equilibrium(ARM, SPINDLE, STRAIGHT, gravity=False)
    assert np.linalg.matrix_rank(compliance(solved, ARM), tol=1e-12) == 5
    assert singularity_measures(ARM, STRAIGHT)[2] == 0
    with pytest.raises(SingularityError, match="keep axis 5 away from 0"):
        stiffness(solved, ARM)
    with pytest.raises(SingularityError, match="wrist"):
        wrench_for_pose(ARM, SPINDLE, STRAIGHT, pose(ARM, SPINDLE, PAPER))


def kilonewton(moments: bool) -> np.ndarray:
    wrenches = np.random.default_rng(8).normal(size=(20, 6))
    wrenches[:, :3] *= 1000 / np.linalg.norm(wrenches[:, :3], axis=-1, keepdims=True)
    return wrenches * ([1] * 3 + [200.0 if moments else 0.0] * 3)


@check("{name}: compliance along {along}", "J diag(compliances of Table 1) J^T in the flange frame [derived]", "m/N",
       cases=("name along expected", [(n, a, v) for n, soft in zip(ARMS, SOFT, strict=True)
                                      for a, v in zip(ALONG, soft, strict=True)]))  # fmt: skip
def test_unloaded_compliance(name, along, expected):
    arm, axis = arm_of(name), (1, 2, 0)[ALONG.index(along)]
    in_base = compliance(equilibrium(arm, BARE, PAPER, gravity=False), arm)
    return expected, rotate_matrix(in_base, pose(arm, BARE, PAPER).rotation.T)[axis, axis], 0.6e-10


@check(
    "loaded compliance (17), weights and 1 kN, {moments} moments, {base} base", "numerical differentiation of whole "
    "equilibria", cases=("moments base", [("with", "rigid"), ("without", "rigid"), ("with", "tilting")]),
)  # fmt: skip
def test_differentiated(moments, base):
    wrenches, arm = kilonewton(moments == "with"), ARM if base == "rigid" else ON_BASE
    ours = compliance(equilibrium(arm, SPINDLE, NEAR[:20], wrenches), arm)
    quotient = np.empty_like(ours)
    for k in range(6):
        step = (20.0 if k < 3 else 10.0) * np.eye(6)[k]
        ahead, behind = (equilibrium(arm, SPINDLE, NEAR[:20], wrenches + s * step).pose for s in (1, -1))
        turn = Rotation.from_matrix(ahead.rotation @ np.swapaxes(behind.rotation, -1, -2)).as_rotvec()
        quotient[:, :, k] = np.concatenate([ahead.position - behind.position, turn], -1) / (2 * step[k])
    size = np.sqrt(np.einsum("nii,njj->nij", ours, ours))  # entries of mixed units, each beside its own diagonal
    return 0.0, (np.abs(quotient - ours) / size).max(), 1e-6


@check("reciprocity: K - K^T under weights and 1 kN", "Maxwell-Betti; forces have a potential")
def test_reciprocity():
    stiff = stiffness(equilibrium(ARM, SPINDLE, NEAR[:20], kilonewton(False)), ARM)
    assert np.all(np.linalg.eigvalsh(stiff) > 0)
    moments = stiffness(equilibrium(ARM, SPINDLE, NEAR[:20], kilonewton(True)), ARM)
    assert np.abs(moments - np.swapaxes(moments, -1, -2)).max((-1, -2)).min() > 1.0
    size = np.sqrt(np.einsum("nii,njj->nij", stiff, stiff))
    return 0.0, (np.abs(stiff - np.swapaxes(stiff, -1, -2)) / size).max(), 1e-9


@check("K_C C_C - 1 under weights, 1 kN and moments, {base} base", "self-consistent: (17) and its inverse",
       cases=("base", [("rigid",), ("tilting",)]))  # fmt: skip
def test_inverse_of_each_other(base):
    arm = ARM if base == "rigid" else ON_BASE
    solved = equilibrium(arm, SPINDLE, NEAR[:20], kilonewton(True))
    return 0.0, np.abs(stiffness(solved, arm) @ compliance(solved, arm) - np.eye(6)).max(), 1e-7


# --- a base that tilts ---
@check("base on three springs: loaded equilibrium", "0: pinocchio's gravity and frame Jacobian balance it", "N m")
def test_base_equilibrium():
    model, data, tool = pinocchio_arm(ON_BASE, SPINDLE, tubes=True)
    wrench = np.array([600.0, -640.0, 480.0, 30.0, -20.0, 10.0])
    solved = equilibrium(ON_BASE, SPINDLE, PAPER, wrench)
    chain = np.append(solved.tilt, solved.posture)
    turned = pin.computeFrameJacobian(model, data, chain, tool, pin.LOCAL_WORLD_ALIGNED)
    torque = turned.T @ wrench - pin.computeGeneralizedGravity(model, data, chain)
    bent = np.append(solved.tilt, solved.theta)
    return 0.0, np.abs(ON_BASE.spring_stiffness * bent - torque).max(), 1e-6


# --- the gravity compensator ---
SPRING = GravityCompensator(stiffness=50e3, preload=6e3, base_x=-0.69, base_z=0.12, arm_length=0.18)


def length(angle: float) -> float:
    """From the places of both hinges."""
    hinge = SPRING.arm_length * np.array([math.cos(angle), -math.sin(angle)])
    return float(np.linalg.norm(hinge - [SPRING.base_x, SPRING.base_z]))


def energy(angle: float) -> float:
    free = length(-math.pi / 2) - SPRING.preload / SPRING.stiffness
    return 0.5 * SPRING.stiffness * (length(angle) - free) ** 2


def test_the_moment_of_the_compensator_is_the_slope_of_its_energy_acts_on_joint_2_alone_and_is_in_the_hessian():
    for angle in np.radians(np.linspace(-140.0, -5.0, 4)):
        slope = (energy(angle + 1e-5) - energy(angle - 1e-5)) / 2e-5
        assert SPRING.moment(math.cos(angle), math.sin(angle)) == pytest.approx(-slope, rel=1e-7)
        pull = SPRING.stiffness * (length(-math.pi / 2) - SPRING.free_length)  # with the upper arm upright
        assert pull == pytest.approx(SPRING.preload)
    sprung = ARM.replace(compensator=SPRING)
    q = np.radians([[20.0, -70.0, 100.0, 30.0, 40.0, 50.0]])
    none, loads = np.zeros((1, 6)), link_loads(sprung, BARE)
    bare = load_torque(forward(ARM, BARE, q), none, link_loads(ARM, BARE))
    extra = load_torque(forward(sprung, BARE, q), none, loads) - bare
    moment = SPRING.moment(np.cos(q[0, 1]), np.sin(q[0, 1]))
    assert extra[0] == pytest.approx([0, moment, 0, 0, 0, 0], abs=1e-9)
    step = 1e-6 * np.eye(6)[1:2]
    torques = [load_torque(forward(sprung, BARE, q + s), none, loads)[0, 1] for s in (step, -step)]
    slope = load_hessian(forward(sprung, BARE, q), none, loads)[0, 1, 1]
    assert slope == pytest.approx((torques[0] - torques[1]) / 2e-6, rel=1e-6)
    assert not equilibrium(sprung, BARE, q, gravity=False).theta.any()
    with pytest.raises(ParameterError, match="keeps a length"):
        GravityCompensator(stiffness=1e3, base_x=-0.15, base_z=0.0, arm_length=0.15)


# --- the answer of the command stiffness ---
WRENCH = np.array([300.0, -150.0, 80.0, 20.0, -10.0, 5.0])


def test_the_analysis_has_lumped_mode_condition_number_and_warnings_and_reads_arm_and_mount_of_a_cell(tmp_path):
    answer = json.loads(json.dumps(analyse(ARM, BARE, PAPER, np.zeros(6))))
    assert answer["deflection"] == [0.0] * 6 and answer["warnings"] == []
    assert answer["mode_frequencies_hz"]["lumped"][0] == pytest.approx(6.69, abs=0.005)  # of the lumped mass
    values = np.linalg.svd(answer["jacobian"], compute_uv=False)
    assert answer["condition_number"] == pytest.approx(values[0] / values[-1])
    with pytest.raises(ParameterError, match="base, tool"):
        analyse(ARM, SPINDLE, PAPER, WRENCH, "world")
    (limit,) = analyse(ARM, BARE, np.radians([190, -50, 120, 180, 25, 180]), np.zeros(6))["warnings"]
    assert limit == "axis 1 at 190 deg is outside its limits, -185 to 185 deg"
    low = analyse(ARM, BARE, np.radians([0, -10, 100, 0, 30, 0]), np.zeros(6))
    assert any("mm below the floor" in warning for warning in low["warnings"])
    text = "/**: {ros__parameters: {includes: [kr270_2.yaml], mount: {mass_kg: 12.0}, workpiece: {anything: 1}}}\n"
    (tmp_path / "cell.yaml").write_text(text)
    arm, mount = read_arm(tmp_path / "cell.yaml")
    assert arm.name == "KR 270-2" and mount.mass == 12.0


def test_the_answers_in_both_frames_are_the_same_physics():
    base = analyse(ARM, SPINDLE, PAPER, WRENCH, "base", gravity=True)
    both = np.kron(np.eye(2), Rotation.from_quat(base["quaternion_xyzw"]).as_matrix().T)
    tool = analyse(ARM, SPINDLE, PAPER, both @ WRENCH, "tool", gravity=True)
    np.testing.assert_allclose(tool["joint_deflection_rad"], base["joint_deflection_rad"], atol=1e-14)
    np.testing.assert_allclose(tool["deflection"], both @ base["deflection"], atol=1e-14)
    np.testing.assert_allclose(tool["jacobian"], both @ base["jacobian"], atol=1e-12)
    for key, unit in (("stiffness", 1e-2), ("compliance", 1e-18)):
        np.testing.assert_allclose(tool[key], both @ base[key] @ both.T, rtol=1e-9, atol=unit)
    modes = (one["mode_frequencies_hz"]["consistent"] for one in (tool, base))
    np.testing.assert_allclose(*modes, rtol=1e-9)
