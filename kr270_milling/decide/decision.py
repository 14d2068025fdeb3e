"""The decision on a compensated path, made once: terminal, JSON, report, manifest and programs print this object."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kr270_milling.base.column import as_dict, column, computed
from kr270_milling.decide.check import Checked
from kr270_milling.decide.limits import Limit, limit_line, measurements
from kr270_milling.decide.tolerance import Judgement, um_text
from kr270_milling.decide.verdict import NO_METHOD, MethodComparison, Verdict
from kr270_milling.physics.compensation.methods import LEARNED

YES, CAUTION, NO = "yes", "caution", "no"
ENOUGH, HALF = 0.9, 0.5  #: shares of the robots that must meet the tolerance for ``yes`` and for ``caution``
NEEDS_TRACKER = "learned needs a tracker on the real machine: here it learned from simulated passes"


@dataclass(frozen=True)
class Decision:
    """Whether a compensated path is to be run.

    ``yes``: no stop, and at least 90 % of the robots meet the tolerance. ``no``: a stop, or the model or more than half
    of the robots miss the tolerance. ``caution``: everything else, also where the tolerance or the verdict is missing.
    """

    as_programmed: Judgement = column("as_programmed")
    compensated: Judgement = column("compensated")
    method: str = column("method")  #: that was run and is written; "none": the path as programmed
    stops: tuple[str, ...] = ()  #: sentences of the findings that forbid to run the path
    verdict: Verdict | None = None  #: of plants that are not the model; None: not run
    #: where the method was chosen by ``best``
    comparison: MethodComparison | None = column("comparison", default=None)
    notes: tuple[str, ...] = column("notes", default=())  #: what a user of the method must know
    backlash: str = column("backlash", default="")  #: whether the figures include the backlash of the joints
    limits: tuple[Limit, ...] = ()  #: the unknowns by their share of the band; empty: not known or not needed

    @computed("may_be_run")
    def may_be_run(self) -> bool:
        """Return whether no finding forbids it."""
        return not self.stops

    @computed("decision")
    def level(self) -> str:
        """``yes``, ``caution`` or ``no``."""
        if self.stops or self.compensated.passes is False:
            return NO
        if self.verdict is None or self.verdict.within is None or self.compensated.passes is None:
            return CAUTION
        share = self.verdict.within / len(self.verdict.compensated)
        return YES if share >= ENOUGH else CAUTION if share >= HALF else NO

    @property
    def exit_code(self) -> int:
        """0, or 1 for ``no``."""
        return int(self.level == NO)

    @computed("recommended_method")
    def recommended_method(self) -> str | None:
        """The method that a comparison recommends; None without a comparison."""
        if self.comparison:
            return self.comparison.best
        return self.verdict.compared if self.verdict else None

    @computed("quantity")
    def _quantity(self) -> str:
        return self.compensated.quantity

    @computed("limits")
    def _limits(self) -> list[dict]:
        shares = self.verdict.shares if self.verdict else None
        return [as_dict(row) | {"within": None if shares is None else row.within(shares)} for row in self.limits]

    @computed("sentence")
    def sentence(self) -> str:
        """Why, and what is missing."""
        model = self.compensated.sentence("on the model")
        if self.stops:
            more = f", and {len(self.stops) - 1} more" if len(self.stops) > 1 else ""
            return f"the path must not be run: {self.stops[0]}{more}; {model}"
        if math.isnan(self.compensated.error):
            return model
        parts = [model + self._plants]
        if self.compensated.passes is None:
            parts.append("no tolerance is given: set part.tolerance_um")
        if self.verdict is None:
            parts.append("no verdict of simulated robots: kr270_milling compensate --verdict 32 runs them")
        elif self.limits:
            parts += measurements(self.limits, self.verdict.shares)[:1]
        return "; ".join(parts)

    @property
    def _plants(self) -> str:
        """The plants, in the same quantity."""
        if self.verdict is None:
            return ""
        count, median = len(self.verdict.compensated), f"median {um_text(self.verdict.band('compensated')[1])}"
        if self.verdict.within is None:
            return f", {median} in {count} simulated robots"
        within = self.verdict.within
        return f" and in {within} of {count} simulated robots ({100 * within / count:.0f} %, {median})"

    @property
    def text(self) -> str:
        """One line: level and sentence."""
        return f"decision: {self.level}: {self.sentence}"

    @property
    def method_text(self) -> str:
        """One line: the method that is written, and the one that a comparison recommends."""
        if self.comparison:
            return f"recommended method: {self.comparison.sentence}"
        if self.method == NO_METHOD and math.isnan(self.compensated.error):
            return f"method: {NO_METHOD}, the tool only drills"
        chosen = f"method: {self.method}, as set"
        return f"{chosen}; recommended method: {self.recommended_method}" if self.recommended_method else chosen

    @property
    def headline(self) -> str:
        """One line with both passes."""
        backlash = f"; {self.backlash}" if self.backlash else ""
        return f"{self.text}{backlash}; as programmed: {self.as_programmed.words}; {self.method_text}"

    def lines(self) -> list[str]:
        """The lines that terminal, manifest and programs print."""
        more = [self.backlash] if self.backlash else []
        if self.limits and self.verdict:
            more += [limit_line(self.limits), *measurements(self.limits, self.verdict.shares)[1:]]
        return [self.text, *more, f"as programmed: {self.as_programmed.words}", self.method_text, *self.notes]


def decided(
    before: Judgement, after: Judgement, method: str, checked: Checked, verdict: Verdict | None = None,
    comparison: MethodComparison | None = None, backlash: str = "", limits: tuple[Limit, ...] = (),
) -> Decision:  # fmt: skip
    """The decision on a pass as programmed and one along the reference of a method.

    checked: findings of the path of the second one; backlash: whether the figures include it.
    """
    stops = tuple(finding.sentence for finding in checked.findings if finding.severity == "stop")
    notes = [NEEDS_TRACKER] if method == LEARNED.name else []
    if after.error > before.error:
        errors = f"{um_text(after.error)} against {um_text(before.error)}"
        notes.append(f"{method} makes the part worse than no compensation ({errors})")
    return Decision(before, after, method, stops, verdict, comparison, tuple(notes), backlash, limits)
