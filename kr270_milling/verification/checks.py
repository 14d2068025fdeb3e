"""The list of physical checks: what each one expects and why, what it got, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from kr270_milling.base.errors import MillingError

__all__ = ["CHECKS", "Check", "Outcome", "Skipped", "UnknownCheckError", "check", "chosen", "run"]


class Skipped(Exception):
    """Raised by a check that cannot run here; the text is the reason."""


class UnknownCheckError(MillingError):
    """--only with a name that no check has."""

    def __init__(self, name: str, known: list[str]):
        self.name, self.known = name, known
        super().__init__(f"no check's name contains {name!r}; the names are: " + "; ".join(known))


@dataclass(frozen=True)
class Check:
    """One line of the verification book."""

    name: str
    source: str  #: where the expected value comes from
    unit: str  #: of expected, got and tolerance; empty: a ratio or a count
    at_most: bool  #: got may be anything up to expected + tolerance
    function: Callable[[], tuple[float, float, float]]  #: -> expected, got, tolerance


@dataclass(frozen=True)
class Outcome:
    """What became of a check; expected, got and tolerance are NaN where it was skipped."""

    check: Check
    expected: float
    got: float
    tolerance: float
    reason: str = ""  #: why it was skipped or could not be finished

    @property
    def verdict(self) -> str:
        """ok, FAILED or skipped; a number that is not finite fails."""
        if self.reason.startswith("skipped"):
            return "skipped"
        error = self.got - self.expected if self.check.at_most else abs(self.got - self.expected)
        return "ok" if not self.reason and error <= self.tolerance and math.isfinite(self.got) else "FAILED"


CHECKS: list[Check] = []  #: filled by the modules beside this one, in the order of the paper


def check(name: str, source: str, unit: str = "", at_most: bool = False, arguments: tuple = ()):
    """Decorator: put a function that returns (expected, got, tolerance) on the list, called with ``arguments``."""

    def register(function):
        CHECKS.append(Check(name, source, unit, at_most, lambda: function(*arguments)))
        return function

    return register


def chosen(only: str | None) -> list[Check]:
    """The checks whose name contains the text, in any case; all without one. Raises UnknownCheckError."""
    found = [c for c in CHECKS if only is None or only.lower() in c.name.lower()]
    if not found:
        raise UnknownCheckError(only, [c.name for c in CHECKS])
    return found


def run(one: Check) -> Outcome:
    """Run one check; one that raises an error of ours has failed, not the run."""
    nothing = float("nan")
    try:
        return Outcome(one, *map(float, one.function()))
    except Skipped as skipped:
        return Outcome(one, nothing, nothing, nothing, f"skipped: {skipped}")
    except MillingError as error:
        return Outcome(one, nothing, nothing, nothing, str(error))
