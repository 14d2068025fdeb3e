"""YAML section ``compensation``."""

from __future__ import annotations

from dataclasses import dataclass

from kr270_milling.base.record import Record, parameter
from kr270_milling.physics.compensation.methods import BEST, methods


@dataclass(frozen=True, eq=False)
class CompensationSettings(Record):
    """YAML ``compensation``: method and limits of the revised reference trajectory."""

    method: str = parameter(
        text="method that revises the reference trajectory; best: compensate compares the methods, while a compensator "
        "that runs takes inverse, or learned with a tracker",
        choices=lambda: (BEST, *methods()),
    )
    tracker: bool = parameter(
        False, text="a tracker measures the tool on the real machine, so that learned can learn from its passes"
    )
    relaxation: float = parameter(0.9, above=0.0, high=1.0, text="alpha of (32)")
    sag_compensated: bool = parameter(True, text="the controller already compensates the sag under the link weights")
    criterion: str = parameter(
        "least_squares", text="what 'learned' and 'inverse' minimise", choices=("min_max", "least_squares")
    )
    interpolation: str = parameter(
        "spline", text="motion of 'inverse' and 'learned' between the knots", choices=("spline", "linear")
    )
    max_passes: int = parameter(6, low=1, high=1000, text="most passes of 'learned' and of ``repeat``")
    repeat: bool = parameter(
        False, text="simulate and revise until the path error stops improving; 'learned' always does"
    )
    max_correction: float = parameter(2e-3, unit="mm", above=0.0, high=50.0, text="largest allowed correction")
    # 0.1 mm in 12 ms is 8.3 mm/s, an eighth of the paper's feed: loads build up in a tenth of a second and need
    # less, so a faster change is noise or a mistake. 12 ms is the interpolation cycle of a KR C4, 4 ms its fast one.
    max_change_per_tick: float = parameter(
        0.1e-3, unit="mm", above=0.0, high=50.0, text="largest change of the correction within one tick_ms"
    )
    feed: str = parameter(
        "keep",
        choices=("keep", "schedule"),
        text="schedule: compensate sets the feed of each stretch, so that 90 % of the robots meet the tolerance",
    )
    feed_most: float = parameter(1.0, low=1.0, high=5.0, text="schedule: highest feed, of the programmed one")
    turn: str = parameter(
        "keep",
        choices=("keep", "best"),
        text="best: compensate turns the tool about its axis, by one angle everywhere",
    )
    finish: int = parameter(
        0, low=0, high=3, text="further passes along the same path, a finishing or spring pass, which cut what is left"
    )
    tick: float = parameter(12e-3, unit="ms", low=1.0, high=1000.0, text="cycle in which the controller corrects")

    @property
    def planned_method(self) -> str:
        """The method where nothing compares."""
        if self.method != BEST:
            return self.method
        return "learned" if self.tracker else "inverse"

    @property
    def scheduled(self) -> bool:
        """Return whether ``compensate`` sets the feeds."""
        return self.feed == "schedule"

    @property
    def tick_ns(self) -> int:
        return round(self.tick * 1e9)

    @property
    def smooth(self) -> bool:
        """Return whether a spline joins the knots of methods that use the response of the arm."""
        return self.interpolation == "spline"
