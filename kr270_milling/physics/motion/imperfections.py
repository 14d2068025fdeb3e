"""What a real arm adds to a pass and no model knows: noise of the measured pose, repeatability, backlash."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.base.record import Record, parameter

__all__ = ["Imperfections", "play"]

#: of a Maxwell-distributed distance with standard deviation 1 along each axis: mean 1.596 + 3 times its deviation 0.673
REPEATABILITY_SPREAD = np.sqrt(8.0 / np.pi) + 3.0 * np.sqrt(3.0 - 8.0 / np.pi)


@dataclass(frozen=True, eq=False)
class Imperfections(Record):
    """YAML ``imperfections``, of the plant: what it adds to each pass, drawn from ``seed``."""

    pose_noise: float = parameter(
        0.0, unit="um", low=0.0, high=1e4, text="standard deviation of each measured tool position along each axis"
    )
    # ISO 9283: mean distance from the barycentre + 3 standard deviations of it, as data sheets state
    repeatability: float = parameter(
        0.0, unit="um", low=0.0, high=1e4, text="position repeatability (ISO 9283): shifts each pass as a whole"
    )
    backlash: np.ndarray = parameter(
        np.zeros(6), unit="deg", size=6, low=0.0, high=5.0, text="play of each joint, which shows where it reverses"
    )
    seed: int = parameter(1, low=0, high=2**31 - 1, text="of noise and repeatability")
    first_pass: int = parameter(0, low=0, high=1_000_000, text="passes whose random numbers are drawn already")

    def generator(self, number: int) -> np.random.Generator:
        """The random numbers of pass ``number``, from 0."""
        return np.random.default_rng([self.seed, self.first_pass + number])

    def shift(self, number: int) -> np.ndarray:
        """[m], (3,): by how much pass ``number`` as a whole lies beside the commanded one."""
        deviation = self.repeatability / REPEATABILITY_SPREAD
        return deviation * self.generator(number).standard_normal(3)

    def measured(self, position: np.ndarray, number: int) -> np.ndarray:
        """Tool positions (n, 3) [m] of pass ``number`` as the tracker reports them."""
        if not self.pose_noise:
            return position
        generator = self.generator(number)
        generator.standard_normal(3)  # those of ``shift``
        return position + self.pose_noise * generator.standard_normal(position.shape)


def play(angle: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Joint angles after their play: angle (n, 6) [rad] of the motors, width (6,) [rad] of the whole play.

    An arm follows its motor at the distance of half the play and rests while the motor crosses it:
    q_k = min(max(q_(k-1), m_k - b/2), m_k + b/2).
    """
    stands = np.array(angle, float)
    stands[0] += 0.5 * width * _first_sense(angle)
    _follow(stands, 0.5 * np.asarray(width, float))
    return stands


@njit(cache=True, nogil=True)
def _follow(stands: np.ndarray, half: np.ndarray) -> None:
    """From the second row on motors (n, 6) become joints."""
    for k in range(1, stands.shape[0]):
        for axis in range(stands.shape[1]):
            motor = stands[k, axis]
            stands[k, axis] = min(max(stands[k - 1, axis], motor - half[axis]), motor + half[axis])


def _first_sense(angle: np.ndarray) -> np.ndarray:
    """-1, 0 or 1 (6,): on which side of its play each joint starts, so that its first motion takes it along."""
    moved = np.diff(angle, axis=0)
    first = np.argmax(moved != 0.0, axis=0)
    return -np.sign(moved[first, np.arange(angle.shape[1])])
