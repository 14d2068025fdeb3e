"""Checks of the mass matrices (18)-(25) and of the natural frequencies."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from book import check
from posture import PAPER, SPINDLE, arm_of, postures
from rigid_arm import rigid_arm

from kr270_milling.physics.robot import (
    BARE,
    beam_mass,
    cartesian_mass,
    compliance,
    equilibrium,
    forward,
    joint_mass,
    mode_frequencies,
    rigid_joint_mass,
)
from kr270_milling.physics.robot.loads import GRAVITY
from kr270_milling.physics.robot.mass import assembled_mass

MASS, LENGTH, RHO_I = 7.0, 1.7, (0.9, 0.4, 0.6)  # [kg], [m], [kg m]


def _rigid(x: float) -> np.ndarray:
    """Motion (6, 6) of a point at (x, 0, 0) from that of the origin, right-handed: v + omega x r."""
    move = np.eye(6)
    move[:3, 3:] = [[0, 0, 0], [0, 0, x], [0, -x, 0]]
    return move


@check("beam mass matrix (23)", "Gauss quadrature of the kinetic energy (18)-(22)")
def test_beam():
    points, weights = np.polynomial.legendre.leggauss(4)
    integral, inertia = np.zeros((12, 12)), np.diag([MASS / LENGTH] * 3 + list(RHO_I))
    for s, weight in zip((points + 1) / 2, weights * LENGTH / 2, strict=True):
        shape = np.diag([s, *[s**2 * (3 - s) / 2] * 2, s, *[2 * s - s**2] * 2])
        motion = np.hstack([_rigid(s * LENGTH) - shape @ _rigid(LENGTH), shape])
        integral += weight * motion.T @ inertia @ motion
    return 0.0, np.abs(beam_mass(MASS, LENGTH, *RHO_I) - integral).max() / MASS, 1e-13


@check("beam, translated as a rigid body", "m", "kg")
def test_translated():
    motion = np.tile(np.eye(6)[1], 2)
    return MASS, motion @ beam_mass(MASS, LENGTH, *RHO_I) @ motion, 1e-12


@check("beam, turned about its base", "m L^2 / 3 + rho I_z L [derived]", "kg m^2")
def test_turned():
    motion = np.concatenate([np.eye(6)[5], _rigid(LENGTH)[:, 5]])
    return MASS * LENGTH**2 / 3 + RHO_I[2] * LENGTH, motion @ beam_mass(MASS, LENGTH, *RHO_I) @ motion, 1e-11


@check("assembled arm (24), translated as a rigid body", "sum of Table 1's link masses + 60 kg of spindle", "kg")
def test_assembled():
    motion = np.tile(np.eye(6)[2], 7)
    return 790.4 + 60.0, motion @ assembled_mass(arm_of(), SPINDLE, forward(arm_of(), SPINDLE, PAPER)) @ motion, 1e-9


def _modes(model: str) -> np.ndarray:
    soft = compliance(equilibrium(arm_of(), BARE, PAPER, gravity=False), arm_of())
    return mode_frequencies(soft, cartesian_mass(arm_of(), BARE, PAPER, model))


@check("first mode, all link masses at the tool", "sqrt(1 / (0.7168 um/N 790.4 kg)) / 2 pi [derived]", "Hz")
def test_lumped():
    return np.sqrt(1 / (0.7168e-6 * 790.4)) / (2 * np.pi), _modes("lumped")[0], 1e-3


@check("first mode, energy-consistent mass", "between 11 and 14 Hz [derived]", "Hz")
def test_consistent():
    return 12.5, _modes("consistent")[0], 1.5


@check("energy-consistent modes (25), at the tool and at the joints", "M_theta against K_theta - H: the same arm")
def test_both_forms():
    solved = equilibrium(arm_of(), SPINDLE, PAPER)
    mass = cartesian_mass(arm_of(), SPINDLE, solved.posture, "consistent")
    at_tool = mode_frequencies(compliance(solved, arm_of()), mass)
    springs = np.diag(arm_of().joint_stiffness) - solved.hessian
    at_joints = mode_frequencies(np.linalg.inv(springs), joint_mass(arm_of(), SPINDLE, solved.posture))
    return 0.0, np.abs(at_tool / at_joints - 1).max(), 1e-9


@check("rigid links: M_theta at 100 postures, heavy spindle", "pinocchio's crba", "kg m^2")
def test_rigid_joint_mass():
    spindle = SPINDLE.replace(inertia=np.array([0.6, 0.5, 0.3]))
    model = rigid_arm(arm_of(), spindle)
    data, worst = model.createData(), 0.0
    for q in postures():
        upper = np.triu(pin.crba(model, data, q))
        worst = max(worst, np.abs(rigid_joint_mass(arm_of(), spindle, q) - upper - np.triu(upper, 1).T).max())
    return 0.0, worst, 1e-9


def _tilting():
    return arm_of().replace(base_compliance=np.array([0.08e-6, 0.12e-6, 0.03e-6]))


@check("base on three springs: M_theta of nine axes at 100 postures", "pinocchio's crba", "kg m^2")
def test_base_mass():
    model = rigid_arm(_tilting(), SPINDLE)
    data, worst = model.createData(), 0.0
    for q in postures():
        chain = np.append(np.array([0.02, -0.01, 0.03]), q)
        upper = np.triu(pin.crba(model, data, chain))
        worst = max(worst, np.abs(rigid_joint_mass(_tilting(), SPINDLE, chain) - upper - np.triu(upper, 1).T).max())
    return 0.0, worst, 1e-9


@check("base on three springs: loaded equilibrium", "0: pinocchio's gravity and frame Jacobian balance it", "N m")
def test_base_equilibrium():
    model, wrench = rigid_arm(_tilting(), SPINDLE), np.array([600.0, -640.0, 480.0, 30.0, -20.0, 10.0])
    solved = equilibrium(_tilting(), SPINDLE, PAPER, wrench)
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    chain = np.append(solved.tilt, solved.posture)
    tool = model.addFrame(pin.Frame("tool", model.njoints - 1, 0, pin.SE3(np.eye(3), arm_of().link_vectors[5]
                          + SPINDLE.xyz), pin.FrameType.OP_FRAME))  # fmt: skip
    data = model.createData()
    turned = pin.computeFrameJacobian(model, data, chain, tool, pin.LOCAL_WORLD_ALIGNED)
    torque = turned.T @ wrench - pin.computeGeneralizedGravity(model, data, chain)
    bent = np.append(solved.tilt, solved.theta)
    return 0.0, np.abs(_tilting().spring_stiffness * bent - torque).max(), 1e-6


@check("rigid links: first mode at the paper's posture", "composite rigid bodies on the joint springs [derived]", "Hz")
def test_rigid_mode():
    return 13.5, _modes("rigid")[0], 0.07
