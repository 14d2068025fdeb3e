"""The gravity compensator: its moment is the slope of its energy, and the equivalent spring is the published one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import find_file
from kr270_milling.physics.robot.analysis import read_arm
from kr270_milling.physics.robot.arm import GravityCompensator
from kr270_milling.physics.robot.elastostatics import equilibrium
from kr270_milling.physics.robot.kinematics import forward
from kr270_milling.physics.robot.loads import link_loads, load_hessian, load_torque

SPRING = GravityCompensator(stiffness=50e3, preload=6e3, base_x=-0.69, base_z=0.12, arm_length=0.18)
ANGLES = np.radians(np.linspace(-140.0, -5.0, 28))


def length(angle: float) -> float:
    """From the places of both hinges."""
    hinge = SPRING.arm_length * np.array([math.cos(angle), -math.sin(angle)])
    return float(np.linalg.norm(hinge - [SPRING.base_x, SPRING.base_z]))


def energy(angle: float) -> float:
    free = length(-math.pi / 2) - SPRING.preload / SPRING.stiffness
    return 0.5 * SPRING.stiffness * (length(angle) - free) ** 2


@pytest.mark.parametrize("angle", ANGLES[::9])
def test_the_moment_is_the_negative_slope_of_the_energy(angle):
    step = 1e-5
    slope = (energy(angle + step) - energy(angle - step)) / (2 * step)
    assert SPRING.moment(math.cos(angle), math.sin(angle)) == pytest.approx(-slope, rel=1e-7)


@pytest.mark.parametrize("angle", ANGLES[::9])
def test_its_spring_is_the_equivalent_one_of_the_literature(angle):
    """k a L eta [Klimchik2013b], with psi from the scalar product of both hinges."""
    base = np.array([SPRING.base_x, SPRING.base_z])
    hinge = SPRING.arm_length * np.array([math.cos(angle), -math.sin(angle)])
    product = np.linalg.norm(base) * SPRING.arm_length
    cosine = base @ hinge / product
    s, free = length(angle), length(-math.pi / 2) - SPRING.preload / SPRING.stiffness
    eta = free / s * (product * (1 - cosine**2) / s**2 - cosine) + cosine
    slope = SPRING.moment_slope(math.cos(angle), math.sin(angle))
    assert slope == pytest.approx(-SPRING.stiffness * product * eta, rel=1e-9)


def test_the_preload_is_the_pull_with_the_upper_arm_upright():
    pull = SPRING.stiffness * (length(-math.pi / 2) - SPRING.free_length)
    assert pull == pytest.approx(SPRING.preload)


def test_only_joint_2_feels_it_and_its_slope_stands_in_the_hessian():
    arm, mount = read_arm(find_file("kr270_2.yaml"))
    sprung = arm.replace(compensator=SPRING)
    q = np.radians([[20.0, -70.0, 100.0, 30.0, 40.0, 50.0]])
    none, loads = np.zeros((1, 6)), link_loads(sprung, mount)
    extra = load_torque(forward(sprung, mount, q), none, loads) - load_torque(
        forward(arm, mount, q), none, link_loads(arm, mount)
    )
    moment = SPRING.moment(np.cos(q[0, 1]), np.sin(q[0, 1]))
    assert extra[0] == pytest.approx([0, moment, 0, 0, 0, 0], abs=1e-9)
    step = np.zeros((1, 6))
    step[0, 1] = 1e-6
    torques = [load_torque(forward(sprung, mount, q + s), none, loads)[0, 1] for s in (step, -step)]
    slope = load_hessian(forward(sprung, mount, q), none, loads)[0, 1, 1]
    assert slope == pytest.approx((torques[0] - torques[1]) / 2e-6, rel=1e-6)


def test_a_balanced_arm_sags_less_and_without_weights_there_is_no_compensator():
    arm, mount = read_arm(find_file("kr270_2.yaml"))
    q = np.radians([0.0, -40.0, 90.0, 0.0, 30.0, 0.0])
    bent = equilibrium(arm, mount, q).theta[1]
    moment = bent / arm.joint_compliance[1]
    per_newton = GravityCompensator(1e3, 1e3, -0.69, 0.12, 0.18).moment(math.cos(q[1]), math.sin(q[1]))
    sprung = arm.replace(compensator=SPRING.replace(preload=1e3, stiffness=1e3))
    assert moment * per_newton < 0.0  # it works against the weights
    assert 0.0 < equilibrium(sprung, mount, q).theta[1] < bent
    assert np.all(equilibrium(sprung, mount, q, gravity=False).theta == 0.0)


def test_a_spring_whose_length_may_vanish_is_refused():
    with pytest.raises(ParameterError, match="keeps a length"):
        GravityCompensator(stiffness=1e3, base_x=-0.15, base_z=0.0, arm_length=0.15)
