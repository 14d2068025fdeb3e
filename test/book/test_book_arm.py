"""Checks of the arm: kinematics, equilibrium (7)-(10), stiffness (14)-(17)."""

from __future__ import annotations

import numpy as np
import pytest
from book import check
from posture import PAPER, SPINDLE, arm_of, postures
from scipy.spatial.transform import Rotation

from kr270_milling.physics.robot import (
    BARE,
    compliance,
    equilibrium,
    forward,
    jacobian,
    link_loads,
    pose,
    rotate_matrix,
    stiffness,
    wrench_for_pose,
)
from kr270_milling.physics.robot.inverse import branches
from kr270_milling.physics.robot.loads import load_torque

KILONEWTON = 1000 * np.array([0.6, -0.64, 0.48, 0.0, 0.0, 0.0])
ARMS = ("kr270_2", "kr270_r2700_ultra")
FLANGES = ((0, -1.6407, 0.4924), (0, -1.6308, 0.2446))  # [m]
SOFT = ((0.7168e-6, 0.6369e-6, 0.1489e-6), (0.7099e-6, 0.7535e-6, 0.1313e-6))  # [m/N]
ALONG = ("the lateral axis", "the axis in plane", "the flange axis")


@check(
    "{name}: flange position", "data sheet chain at the posture of Table 1, rounded to 0.1 mm [derived]", "m",
    cases=("name expected", zip(ARMS, FLANGES, strict=True)),
)  # fmt: skip
def test_flange_position(name, expected):
    found = pose(arm_of(name + ".yaml"), BARE, PAPER).position
    return 0.0, np.abs(found - expected).max(), 5.1e-5


@check(
    "{name}: compliance along {along}", "J diag(compliances of Table 1) J^T in the flange frame [derived]", "m/N",
    cases=("name along expected", [(n, a, v) for n, soft in zip(ARMS, SOFT, strict=True)
                                   for a, v in zip(ALONG, soft, strict=True)]),
)  # fmt: skip
def test_unloaded_compliance(name, along, expected):
    arm, axis = arm_of(name + ".yaml"), (1, 2, 0)[ALONG.index(along)]
    in_base = compliance(equilibrium(arm, BARE, PAPER, gravity=False), arm)
    return expected, rotate_matrix(in_base, pose(arm, BARE, PAPER).rotation.T)[axis, axis], 0.6e-10


def _oracle():
    """The chain of the data sheet with the split link masses in pinocchio; its data; the frame of tool0."""
    pin = pytest.importorskip("pinocchio")
    arm, model, parent, at = arm_of(), pin.Model(), 0, np.zeros(3)
    axes = [(0, 0, -1), (0, 1, 0), (0, 1, 0), (-1, 0, 0), (0, 1, 0), (-1, 0, 0)]
    ends = [(arm.a1, 0, arm.d1), (arm.a2, 0, 0), (0, 0, arm.a3), (arm.d4, 0, 0), (0, 0, 0), (arm.d6, 0, 0)]
    for j, (axis, end) in enumerate(zip(axes, ends, strict=True)):
        joint = pin.JointModelRevoluteUnaligned(np.array(axis, float))
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), at), f"j{j}")
        at = np.array(end, float)
        inertia = pin.Inertia(arm.link_mass[j], arm.link_mass_centre[j] * at, np.zeros((3, 3)))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    rider = pin.Inertia(SPINDLE.mass, at + SPINDLE.mass_centre, np.zeros((3, 3)))
    model.appendBodyToJoint(parent, rider, pin.SE3.Identity())
    model.gravity.linear = np.array([0, 0, -9.80665])
    place = pin.SE3(pin.rpy.rpyToMatrix(0.0, np.pi / 2, 0.0), at + SPINDLE.xyz)
    frame = model.addFrame(pin.Frame("tool0", parent, 0, place, pin.FrameType.OP_FRAME))
    return pin, model, model.createData(), frame


@check("pose at 100 postures", "pinocchio", "m, rad")
def test_pinocchio_pose():
    pin, model, data, frame = _oracle()
    ours, worst = pose(arm_of(), SPINDLE, postures()), 0.0
    for i, q in enumerate(postures()):
        pin.framesForwardKinematics(model, data, q)
        gap = np.abs(ours.position[i] - data.oMf[frame].translation).max()
        worst = max(worst, gap, np.abs(ours.rotation[i] - data.oMf[frame].rotation).max())
    return 0.0, worst, 1e-9


@check("Jacobian at 100 postures", "pinocchio", "m/rad")
def test_pinocchio_jacobian():
    pin, model, data, frame = _oracle()
    theirs = [pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED) for q in postures()]
    return 0.0, np.abs(jacobian(arm_of(), SPINDLE, postures()) - theirs).max(), 1e-9


@check("torque of the link weights at 100 postures", "pinocchio", "N m")
def test_pinocchio_gravity():
    pin, model, data, _ = _oracle()
    theirs = [-pin.computeGeneralizedGravity(model, data, q) for q in postures()]
    frames = forward(arm_of(), SPINDLE, postures())
    return 0.0, np.abs(load_torque(frames, np.zeros((100, 6)), link_loads(arm_of(), SPINDLE)) - theirs).max(), 1e-9


@check("inverse kinematics, every branch", "self-consistent: forward kinematics of every solution", "m, rad")
def test_inverse_round_trip():
    arm, worst = arm_of(), 0.0
    for q in postures(20):
        target = pose(arm, SPINDLE, q)
        found, _ = branches(arm, SPINDLE, target, q)
        back = pose(arm, SPINDLE, found[np.isfinite(found).all(-1)])
        worst = max(worst, np.abs(back.position - target.position).max(), np.abs(back.rotation - target.rotation).max())
    return 0.0, worst, 1e-9


@check("equilibrium (7): largest torque out of balance", "0: torques of weights and 1 kN balance, 100 postures", "N m")
def test_residual():
    near = PAPER + np.random.default_rng(3).uniform(-0.3, 0.3, (100, 6))
    return 0.0, equilibrium(arm_of(), SPINDLE, near, KILONEWTON).residual.max(), 1e-9


@check(
    "wrench of a loaded pose, f of (31) after f^-1 of (30)", "self-consistent: the wrench that bent the arm", "N, N m"
)
def test_both_ways():
    wrench = KILONEWTON + [0, 0, 0, 80.0, -120.0, 40.0]
    there = equilibrium(arm_of(), SPINDLE, PAPER, wrench)
    return 0.0, np.abs(wrench_for_pose(arm_of(), SPINDLE, PAPER, there.pose).wrench - wrench).max(), 1e-4


def _hinge():
    """An arm with only joint 2 soft, 1e6 N m/rad, stretched along x; its length [m]."""
    soft = np.array([1e-12, 1e-6, 1e-12, 1e-12, 1e-12, 1e-12])
    return arm_of().replace(a3=0.0, joint_compliance=soft), 1.25 + 1.1 + 0.23


@check("column on one hinge: H / K at half its critical load", "H = F L, critical at F L = K")
def test_column():
    arm, length = _hinge()
    solved = equilibrium(arm, BARE, np.zeros(6), [-0.5e6 / length, 0, 0, 0, 0, 0], gravity=False)
    return 0.5, solved.hessian[1, 1] / 1e6, 1e-9


@check("hinge under a dead side load", "K theta = F L cos(theta)", "rad")
def test_dead_load():
    arm, length = _hinge()
    theta = equilibrium(arm, BARE, np.zeros(6), [0, 0, -0.15e6 / length, 0, 0, 0], gravity=False).theta[1]
    return 0.15 * np.cos(theta), theta, 1e-8


@check("loaded compliance (17), weights, 1 kN and moments", "numerical differentiation of whole equilibria")
def test_differentiated():
    arm, wrench = arm_of(), KILONEWTON + [0, 0, 0, 80.0, -120.0, 40.0]
    ours = compliance(equilibrium(arm, SPINDLE, PAPER, wrench), arm)
    quotient = np.empty((6, 6))
    for k in range(6):
        step = (20.0 if k < 3 else 10.0) * np.eye(6)[k]
        ahead, behind = (equilibrium(arm, SPINDLE, PAPER, wrench + s * step).pose for s in (1, -1))
        turn = Rotation.from_matrix(ahead.rotation @ behind.rotation.T).as_rotvec()
        quotient[:, k] = np.concatenate([ahead.position - behind.position, turn]) / (2 * step[k])
    size = np.sqrt(np.outer(np.diag(ours), np.diag(ours)))
    return 0.0, (np.abs(quotient - ours) / size).max(), 1e-6


@check("reciprocity: C - C^T under weights and 1 kN", "Maxwell-Betti; forces have a potential")
def test_reciprocity():
    arm = arm_of()
    soft = compliance(equilibrium(arm, SPINDLE, PAPER, KILONEWTON), arm)
    return 0.0, (np.abs(soft - soft.T) / np.sqrt(np.outer(np.diag(soft), np.diag(soft)))).max(), 1e-10


@check("K_C C_C - 1 under weights, 1 kN and moments", "self-consistent: (17) and its inverse")
def test_inverse_of_each_other():
    solved = equilibrium(arm_of(), SPINDLE, PAPER, KILONEWTON + [0, 0, 0, 80.0, -120.0, 40.0])
    return 0.0, np.abs(stiffness(solved, arm_of()) @ compliance(solved, arm_of()) - np.eye(6)).max(), 1e-8
