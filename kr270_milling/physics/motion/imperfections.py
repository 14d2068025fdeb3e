"""What a real arm adds to a pass and no model knows: noise of the measured pose, repeatability, backlash."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kr270_milling.base.record import Record, parameter

__all__ = ["Imperfections"]

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
        np.zeros(6), unit="arcsec", size=6, low=0.0, high=18000.0,
        text="backlash of each joint of this plant, which shows where the load on the joint reverses",
    )  # fmt: skip
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
