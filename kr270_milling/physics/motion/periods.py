"""The exchange between robot and cutting process: one period H, an integer number of micro-steps of the spindle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.base.record import Record, parameter


@dataclass(frozen=True, eq=False)
class Exchange(Record):
    """YAML ``exchange``: how often robot and cutting process exchange pose and wrench."""

    period: float = parameter(
        math.nan,
        unit="ms",
        above=0.0,
        high=20.0,
        text="exchange period H; default: 0.25 ms, 0.125 ms above a cutting.end_share of 0.5, in whole micro-steps",
    )
    micro_step: float = parameter(np.radians(1.0), unit="deg", low=0.01, high=15.0, text="spindle angle a micro-step")
    engagement_period: float = parameter(
        math.nan,
        unit="ms",
        above=0.0,
        high=20.0,
        text="exchange period where cutting.detail is engagement, rounded to whole micro-steps; default: 4 ms, and "
        "1.25 ms for an end that is not flat and for a tilted axis",
    )
    iterations: int = parameter(1, low=1, high=20, text="exchanges a period; above 1 the correction is fed back")
    warn_correction: float = parameter(
        0.05, above=0.0, high=1.0, text="share of the feed per tooth above which a correction is reported"
    )
    # The paper's cut with arms up to 16 times lighter: up to 36 % of the feed per tooth the deviation is off by at most
    # 6 %. Above a half the wrench belongs to chips that are not those of the pass.
    stop_correction: float = parameter(
        0.5, above=0.0, high=10.0, text="share of the feed per tooth above which a path must not be run"
    )

    def for_engagement(self, spindle_speed: float, level: bool) -> Exchange:
        """Return the exchange of the mean-force model at a spindle speed [rad/s]: its period in whole micro-steps.

        level: the end of the tool is flat and level, so that the contact with the floor is solved within a period.
        Other ends are pushed out by their whole area: over 4 ms the predicted tip of a leaning ball is off by 4 um.
        """
        usual = 4e-3 if level else 1.25e-3  # [s], convergence in guide/contributing/models.md
        return self.rounded(usual if math.isnan(self.engagement_period) else self.engagement_period, spindle_speed)

    def for_teeth(self, spindle_speed: float, end_share: float) -> Exchange:
        """Return the exchange of the sweep of the teeth at a spindle speed [rad/s]; a period that is given stays.

        end_share: of the end edge that presses on the floor: an arm that bounces there needs a shorter period.
        """
        usual = 0.25e-3 if end_share <= 0.5 else 0.125e-3  # [s], convergence in guide/numbers.md
        return self.rounded(usual, spindle_speed) if math.isnan(self.period) else self

    def rounded(self, period: float, spindle_speed: float) -> Exchange:
        """Return the exchange with a period [s] in whole micro-steps at a spindle speed [rad/s]."""
        unit = self.micro_step / spindle_speed
        return self.replace(period=unit * max(1, round(period / unit)))

    def steps_of(self, period: float) -> int:
        """Exchange periods that make ``period`` [s] at least."""
        return max(1, math.ceil(period / self.period - 1e-9))

    def clock(self, spindle_speed: float) -> Clock:
        """Raises ParameterError where the period is not a whole number of micro-steps at spindle_speed [rad/s]."""
        steps = spindle_speed * self.period / self.micro_step
        whole = round(steps)
        if whole < 1 or abs(steps - whole) > 1e-6 * whole:
            unit = self.micro_step / spindle_speed * 1e3
            near = ", ".join(f"{n * unit:.9g}" for n in sorted({max(1, int(steps)), int(steps) + 1}))
            allowed = f"a whole number of micro-steps at this spindle speed, for example {near}"
            raise ParameterError("exchange.period_ms", self.period * 1e3, allowed)
        return Clock(self.period, whole)


@dataclass(frozen=True, eq=False)
class Publish(Record):
    """YAML ``publish``: topics that are published less often than every exchange, unlike pose and wrench."""

    every: int = parameter(
        0,
        low=0,
        high=1_000_000,
        text="exchange periods from one deflection, and one joint state, to the next; 1: all; 0: as many as make 10 ms",
    )
    clock: bool = parameter(
        False,
        text="publish clock every 10 ms of the pass; at the root it drives every node with use_sim_time",
    )

    def steps(self, exchange: Exchange) -> int:
        """Exchange periods from one published deflection to the next."""
        return self.every or exchange.steps_of(0.01)


@dataclass(frozen=True)
class Clock:
    """Steps are counted, seconds are not added: step n of a pass is at the stamp round(n H)."""

    period: float  #: H [s]
    micro_steps: int  #: in one period

    def stamp(self, step):
        """[ns], of a step count or an array of them."""
        return np.rint(np.multiply(step, self.period * 1e9)).astype(np.int64)

    def step(self, stamp_ns: int) -> int:
        """The step whose stamp this is, or -1 if it is no step's stamp."""
        period_ns = self.period * 1e9
        step = round(stamp_ns / period_ns)
        return step if step >= 0 and round(step * period_ns) == stamp_ns else -1  # as ``stamp``, in a tenth of the time

    def steps(self, duration_ns: int) -> int:
        """Exchange periods that cover a duration [ns]."""
        steps = int(np.ceil(duration_ns / (self.period * 1e9) - 1e-6))
        return steps - 1 if steps > 0 and self.stamp(steps - 1) >= duration_ns else steps  # a stamp is rounded
