"""The limit depth of cut that the time-domain model finds for a tool with one flexible mode along the feed.

The published benchmark [Insperger2004] by first-order semi-discretisation. It has no cutter diameter, because there
the delay is constant and the chip is the feed and the vibration projected on the tooth. Here a chip is
A_i / (R dphi_i) (Fig. 6) with the tooth's angle as seen from where the centre was: a vibration along the tooth's motion
is no chip. With the nominal angle it would be one, and damp.
"""

import dataclasses
import math

import numpy as np
import pytest
from book import check
from semi_discretisation import MASS, OMEGA, ZETA, directional, drifting_limit, limit, multipliers, semi_discretisation

from kr270_milling.physics.cutting import Cut, Cutting, LinearEdgeLaw, Stock, Tool
from kr270_milling.physics.motion.arm_model import arm_model
from kr270_milling.physics.motion.dynamics import modes
from kr270_milling.physics.motion.milling_pass import CompliantArm

GRID = 1e-6  # [m]
MICRO_STEP = math.radians(1.0)
PERIODS = 50  # tooth periods of a run at most
MOST_TURNS = 200  # of run-in
LOST, LARGE = 0.03, 0.35  # of the feed per tooth: below, the grid's noise reigns; above, teeth leave the cut


@dataclasses.dataclass(frozen=True)
class Milling:
    """A two-tooth cutter fed along +x into a straight wall, a half immersion or a slot."""

    spindle_rpm: float
    immersion: str  #: slot, up, down: half immersion up- or down-milling
    radius: int = 1000  #: R / f_z

    @property
    def feed(self) -> float:
        """A tooth [m], in whole nodes of the grid: the area of a sector is a few hundred nodes."""
        return max(5, 4000 // self.radius) * GRID


class _Run:
    """One cut from the periodic motion on, disturbed by a fifth of the feed per tooth."""

    def __init__(self, milling: Milling, depth: float):
        radius = milling.radius * milling.feed
        law = LinearEdgeLaw(tangential_cutting=6e8, tangential_edge=0.0, radial_cutting=2e8, radial_edge=0.0)
        low, high = np.multiply({"slot": (-1.1, 1.1), "up": (0.0, 1.1), "down": (-1.1, 0.0)}[milling.immersion], radius)
        end = 1.1 * radius + (PERIODS + 2 * MOST_TURNS) * milling.feed
        stock = Stock(min=np.array([-1.1 * radius, low, -0.05]), max=np.array([end, high, 0]), grid_step=GRID)
        tool = Tool(diameter=2 * radius, teeth=2, spindle_speed=milling.spindle_rpm * 2 * np.pi / 60)
        self.cut = Cut(tool, Cutting(law="linear_edge", linear_edge=law), stock, MICRO_STEP)
        # eq. (1) with inertia along x alone; exchange period: one micro-step
        along_x = modes(np.diag([1.0 / (MASS * OMEGA**2)] + [1e-12] * 5)[None], np.diag([MASS] + [0.0] * 5)[None])[0]
        self.model = arm_model([along_x], ZETA, MICRO_STEP / tool.spindle_speed)
        self.turn = self.cut.params.steps
        self.feed = 2 * milling.feed  # a turn
        self.start, self.step = np.array([0.0, 0.0, -depth]), 0
        self.cut.sweep(self.start, self.start, 0, self.turn)  # a hole as large as the tool, without feed
        self.start = self.start - [self.feed, 0.0, 0.0]
        self.step = self.turn
        self._rigid(2)
        self.orbit = self._periodic(self._rigid(1))
        self.arm = CompliantArm(self.model)
        kick = 0.1 * self.feed * np.array([1.0, OMEGA]) / np.sqrt(2)
        self.arm.state = self.orbit[0] + kick
        # the surface that the undisturbed motion leaves, in turns until each point ahead is the orbit's: its whole
        # width over the feed, and one
        turns = min(MOST_TURNS, 2 + math.ceil(np.ptp(self.orbit[:, 0]) / self.feed))
        steps = self.step + np.arange(turns * self.turn + 1)
        x = self.feed * steps / self.turn + self.orbit[steps % self.turn, 0]
        places = self.start + np.outer(x, [1.0, 0.0, 0.0])
        self.cut.along(places, steps)
        self.before, self.step = places[-1], int(steps[-1])

    def _periodic(self, force: np.ndarray) -> np.ndarray:
        """The periodic state (n + 1, 2) under the periodic force (n,) [N] of a rigid tool.

        On it the teeth follow each other's way, so that the chips are those of the rigid tool.
        """
        a, b = self.model.transition[0], self.model.input[0][:, 0]
        state = np.zeros((force.size + 1, 2))
        for _ in range(2):  # from rest first, whose end is where the periodic state starts
            for n, f in enumerate(force):
                state[n + 1] = a @ state[n] + b * f
            if not state[0].any():
                state[0] = np.linalg.solve(np.eye(2) - np.linalg.matrix_power(a, force.size), state[-1])
        return state

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


# --- checks ---
#: period doubling, Hopf in a slot; Hopf at the foot of a lobe, Hopf within a lobe, a narrow lobe
LOBES = (Milling(15000.0, "down"), Milling(12000.0, "slot"), Milling(15000.0, "up"), Milling(14000.0, "up"),
         Milling(5000.0, "slot"))  # fmt: skip
SHARE = {5000.0: 0.05}  #: else 0.02; at 5000 rpm a lobe is narrow
#: At 14,000 rpm the growth a period changes by 0.0013 only in 2 % of the depth, while terms of f_z / R, which the
#: oracle leaves out, are worth K_t a f_z T / (2 m omega R) = 0.004 at R / f_z = 1000: 6 % of the depth, and half of
#: it at 2000. So this limit is that of R / f_z = 1000 and 2000, extrapolated.
FLAT = 14000.0


@check("stability limit, {case.spindle_rpm:.0f} rpm, {case.immersion}: where growth changes its sign",
       "first-order semi-discretisation of the benchmark of [Insperger2004], test/book/semi_discretisation.py", "m",
       cases=("case", [(case,) for case in LOBES]), long=3)  # fmt: skip
def test_limit_depth(case):
    expected, share = semi_discretisation(case)[0], SHARE.get(case.spindle_rpm, 0.02)
    if case.spindle_rpm != FLAT:
        return expected, limit_depth(case, expected, share), share * expected
    near, far = (
        limit_depth(dataclasses.replace(case, radius=radius), (1.0 - 60.0 / radius) * expected, share)
        for radius in (1000, 2000)
    )
    return expected, 2.0 * far - near, share * expected


#: R / f_z of an ordinary cutter; the tolerance: what the grid's noise makes of a narrow lobe
SMALL = {Milling(5000.0, "slot", 80): 0.04, Milling(15000.0, "up", 80): 0.02}


@check(
    "stability limit at R / f_z = 80, {case.spindle_rpm:.0f} rpm, {case.immersion}: chips over the angle seen from the "
    "previous centre", "semi-discretisation with the delay between two trochoids [derived], "
    "test/book/semi_discretisation.py", "m", cases=("case", [(case,) for case in SMALL]), long=1,
)  # fmt: skip
def test_limit_depth_of_a_small_radius(case):
    """With the nominal angle the slot's limit would be 40 % high."""
    expected = drifting_limit(case)
    return expected, limit_depth(case, expected, 0.03), SMALL[case] * expected


def test_disturbances_grow_and_die_as_fast_as_the_multiplier_says_and_a_drifting_delay_tends_to_the_tooth_period():
    for share in (0.9, 1.1):
        case = Milling(15000.0, "up")
        depth = share * semi_discretisation(case)[0]
        largest = np.abs(multipliers(depth, 0.002, directional("up", 160))).max()
        assert growth(case, depth) == pytest.approx(np.log(largest), rel=0.12)
    wide, limit_of_the_period = Milling(12000.0, "slot", 100_000), semi_discretisation(LOBES[1])[0]
    assert drifting_limit(wide, 160) == pytest.approx(limit_of_the_period, rel=2e-3)
    assert drifting_limit(Milling(12000.0, "slot", 80), 160) > 1.05 * limit_of_the_period


# --- the oracle itself ---
def test_semi_discretisation_finds_the_closed_form_of_turning():
    """Constant h: the borderline frequency w_c gives a h = (w_c^2 - w^2) / 2 + 2 (zeta w w_c)^2 / (w_c^2 - w^2)."""
    beyond = OMEGA * 1.02
    rise = beyond**2 - OMEGA**2
    strength = rise / 2 + 2 * (ZETA * OMEGA * beyond) ** 2 / rise
    for lobe in (1, 4):
        phase = np.arctan2(rise, 2 * ZETA * OMEGA * beyond)
        delay = 2 * (lobe * np.pi - phase) / beyond
        depth, multiplier = limit(delay, np.full(40, 1e9), np.full(160, 1e9), np.geomspace(1e-5, 1e-2, 30))
        assert depth * 1e9 / MASS == pytest.approx(strength, rel=2e-3)
        assert abs(multiplier.imag) > 0.01
