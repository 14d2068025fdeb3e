"""What ``check`` allows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.record import Record, parameter

__all__ = ["Limits"]


@dataclass(frozen=True, eq=False)
class Limits(Record):
    """YAML ``limits``: beyond these a path is not to be run, or is told to be doubtful.

    wrist_angle: A4 and A6 turn 1 / sin(A5) times as fast as the tool, 19 times at 3 deg, and the least correction
    across the wrist makes them swing. elbow_angle: the nearly stretched arm turns A3 by 11 times what its reach asks
    for at 5 deg. shoulder_distance: at 0.1 m a feed of 4 m/min turns A1 by 38 deg/s.
    """

    wrist_angle: float = parameter(math.radians(3.0), unit="deg", low=0.0, high=90.0, text="least size of A5")
    elbow_angle: float = parameter(
        math.radians(5.0), unit="deg", low=0.0, high=90.0, text="least angle between upper arm and forearm"
    )
    shoulder_distance: float = parameter(
        0.1, unit="mm", low=0.0, high=5000.0, text="least distance of the wrist centre from axis 1"
    )
    # assumed: one minute of arc, what makers of cycloidal gears promise; nothing is known of this arm
    backlash: np.ndarray = parameter(
        np.full(6, math.radians(1.0 / 60.0)), unit="deg", size=6, low=0.0, high=5.0, text="backlash of each joint"
    )
    blending_share: float = parameter(
        0.5, above=0.0, high=10.0, text="share of the correction that the blending of LIN motions may round off"
    )
    rapid_contact: float = parameter(
        20e-6, unit="um", low=0.0, high=1e4,
        text="deepest contact of a rapid move beyond the spring-back of the arm",
    )  # fmt: skip
    below_stock: float = parameter(
        0.0, unit="mm", low=0.0, high=1e3, text="how far the tool may go below the stock, into a sacrificial plate"
    )
    # assumed: a milling spindle of the size that a heavy arm carries
    spindle_torque: float = parameter(10.0, unit="n_m", above=0.0, high=1e4, text="most that the spindle gives")
    spindle_power: float = parameter(10e3, unit="kw", above=0.0, high=1e3, text="most that the spindle gives")
