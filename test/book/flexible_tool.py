"""The limit depth of cut that the time-domain model finds for a tool with one flexible mode along the feed.

The published benchmark [Insperger2004]: two teeth, 922 Hz, damping 0.011, 0.03993 kg, K_t = 6e8, K_n = 2e8 N/m^2,
forces linear in the chip. It has no cutter diameter, because there the delay is constant and the chip is the feed and
the vibration projected on the tooth. Here a chip is A_i / (R dphi_i) (Fig. 6) with the tooth's angle as seen from where
the centre was: a vibration along the tooth's motion is no chip. With the nominal angle it would be one, and damp.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from semi_discretisation import MASS, OMEGA, ZETA

from kr270_milling.physics.cutting import Cut, Cutting, LinearEdgeLaw, Stock, Tool
from kr270_milling.physics.motion.arm_model import arm_model
from kr270_milling.physics.motion.dynamics import ArmModel, modes
from kr270_milling.physics.motion.milling_pass import CompliantArm

__all__ = ["Milling", "growth", "limit_depth"]

GRID = 1e-6  # [m]
MICRO_STEP = math.radians(1.0)
PERIODS = 50  # tooth periods of a run at most
MOST_TURNS = 200  # of run-in
LOST, LARGE = 0.03, 0.35  # of the feed per tooth: below, the grid's noise reigns; above, teeth leave the cut


@dataclass(frozen=True)
class Milling:
    """A two-tooth cutter fed along +x into a straight wall, a half immersion or a slot."""

    spindle_rpm: float
    immersion: str  #: slot, up, down: half immersion up- or down-milling
    radius: int = 1000  #: R / f_z

    @property
    def chip(self) -> int:
        """Nodes of the grid in a feed per tooth: the area of a sector is a few hundred nodes."""
        return max(5, 4000 // self.radius)

    @property
    def feed(self) -> float:
        """A tooth [m]."""
        return self.chip * GRID

    @property
    def wall(self) -> tuple[float, float]:
        """Material from y to y as shares of the radius."""
        return {"slot": (-1.1, 1.1), "up": (0.0, 1.1), "down": (-1.1, 0.0)}[self.immersion]


def _workpiece(milling: Milling) -> Cut:
    radius = milling.radius * milling.feed
    law = LinearEdgeLaw(tangential_cutting=6e8, tangential_edge=0.0, radial_cutting=2e8, radial_edge=0.0)
    low, high = np.multiply(milling.wall, radius)
    end = 1.1 * radius + (PERIODS + 2 * MOST_TURNS) * milling.feed
    stock = Stock(min=np.array([-1.1 * radius, low, -0.05]), max=np.array([end, high, 0]), grid_step=GRID)
    tool = Tool(diameter=2 * radius, teeth=2, spindle_speed=milling.spindle_rpm * 2 * np.pi / 60)
    return Cut(tool, Cutting(law="linear_edge", linear_edge=law), stock, MICRO_STEP)


def _model(spindle_speed: float) -> ArmModel:
    """Eq. (1) with inertia along x alone; exchange period: one micro-step."""
    soft = 1.0 / (MASS * OMEGA**2)
    along_x = modes(np.diag([soft] + [1e-12] * 5), np.diag([MASS] + [0.0] * 5))
    return arm_model([along_x], ZETA, MICRO_STEP / spindle_speed)


def _orbit(model: ArmModel, force: np.ndarray) -> np.ndarray:
    """The periodic state (n + 1, 2) under the periodic force (n,) [N] of a rigid tool.

    On it the teeth follow each other's way, so that the chips are those of the rigid tool.
    """
    a, b = model.transition[0], model.input[0][:, 0]
    state = np.zeros((force.size + 1, 2))
    for _ in range(2):  # from rest first, whose end is where the periodic state starts
        for n, f in enumerate(force):
            state[n + 1] = a @ state[n] + b * f
        if not state[0].any():
            state[0] = np.linalg.solve(np.eye(2) - np.linalg.matrix_power(a, force.size), state[-1])
    return state


class _Run:
    """One cut from the periodic motion on, disturbed by a fifth of the feed per tooth."""

    def __init__(self, milling: Milling, depth: float):
        self.cut = _workpiece(milling)
        self.turn = self.cut.params.steps
        self.feed = 2 * milling.feed  # a turn
        self.start, self.step = np.array([0.0, 0.0, -depth]), 0
        self.model = _model(self.cut.tool.spindle_speed)
        self.cut.sweep(self.start, self.start, 0, self.turn)  # a hole as large as the tool, without feed
        self.start = self.start - [self.feed, 0.0, 0.0]
        self.step = self.turn
        self._rigid(2)
        self.orbit = _orbit(self.model, self._rigid(1))
        self.arm = CompliantArm(self.model)
        kick = 0.1 * self.feed * np.array([1.0, OMEGA]) / np.sqrt(2)
        self.arm.state = self.orbit[0] + kick
        self.before = self._course(self.step) + [self.orbit[0, 0], 0.0, 0.0]
        for _ in range(self._run_in() * self.turn):  # the surface that the undisturbed motion leaves
            self._to(self._course(self.step + 1) + [self.orbit[(self.step + 1) % self.turn, 0], 0.0, 0.0])

    def _run_in(self) -> int:
        """Turns until every point of the surface ahead is the orbit's own: its whole width over the feed, and one."""
        return min(MOST_TURNS, 2 + math.ceil(np.ptp(self.orbit[:, 0]) / self.feed))

    def _course(self, step: int) -> np.ndarray:
        return self.start + [self.feed * step / self.turn, 0.0, 0.0]

    def _rigid(self, turns: int) -> np.ndarray:
        """Force along x (n,) [N] on the undeflected tool."""
        n, forces = turns * self.turn, np.zeros((turns * self.turn, 3))
        self.cut.sweep(self._course(self.step), self._course(self.step + n), self.step, n, forces)
        self.step += n
        return forces[:, 0]

    def _to(self, tool: np.ndarray) -> np.ndarray:
        wrench = self.cut.sweep(self.before, tool, self.step, 1)
        self.before, self.step = tool, self.step + 1
        return wrench

    def period(self) -> float:
        """Mill one tooth period; rms deviation from the periodic motion per feed per tooth."""
        total, half = 0.0, self.turn // 2
        for _ in range(half):
            tool = self._course(self.step + 1) + self.arm.predict()[:3]  # predict, answer, correct: Fig. 7
            deflection = self.arm.correct(self._to(tool))
            total += (deflection[0] - self.orbit[(self.step - 1) % self.turn + 1, 0]) ** 2
        return math.sqrt(total / half) / (0.5 * self.feed)


def growth(milling: Milling, depth: float) -> float:
    """Logarithmic growth of a small disturbance per tooth period at a depth of cut [m]; negative: it dies out."""
    run, levels = _Run(milling, depth), []
    while len(levels) < PERIODS and (len(levels) < 6 or LOST < levels[-1] < LARGE):
        levels.append(run.period())
    late = np.arange(len(levels))[len(levels) // 3 :]
    return float(np.polyfit(late, np.log(np.array(levels)[late]), 1)[0])


def limit_depth(milling: Milling, near: float, share: float = 0.02) -> float:
    """Depth of cut [m] at which disturbances neither grow nor die: growth(near (1 -+ share)) joined by a straight line.

    It lies between the two depths where, and only where, disturbances die at the first and grow at the second; NaN
    where they grow no faster at the second.
    """
    depths = near * np.array([1.0 - share, 1.0 + share])
    rates = [growth(milling, depth) for depth in depths]
    if not rates[0] < rates[1]:
        return math.nan
    return float(depths[0] - rates[0] * (depths[1] - depths[0]) / (rates[1] - rates[0]))
