"""The compensation methods: one object each, in the table METHODS.

The command line reads the names here, so this file imports a library only when a method revises.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np

    from kr270_milling.path.trajectory import Trajectory
    from kr270_milling.physics.compensation.learning import Learner
    from kr270_milling.physics.compensation.models import CellModels
    from kr270_milling.physics.compensation.revision import PassRecord

__all__ = ["BEST", "LEARNED", "METHODS", "Correction", "Method", "RevisionTask", "method_of"]


@dataclass(frozen=True, eq=False)
class RevisionTask:
    """The input of one revision."""

    target: Trajectory
    reference: Trajectory  #: of the last pass
    ran: PassRecord  #: the last pass
    models: CellModels
    criterion: str  #: "min_max" or "least_squares", of methods that minimise
    smooth: bool  #: a spline joins the knots, of methods that can do both
    learner: Learner | None  #: of the last revision by this method


@dataclass(frozen=True, eq=False)
class Correction:
    """Reference minus target at the k knots of the target, before any limit."""

    offset: np.ndarray  #: [m], (k, 3)
    smooth: bool  #: a spline joins the knots; else straight lines
    rates: np.ndarray | None = None  #: slopes of the spline at the knots [m/s], (k, 3); None: those of the C2 spline
    quaternion: np.ndarray | None = None  #: orientations x, y, z, w, (k, 4); None: those of the target
    learner: Learner | None = None  #: the experience for the next revision, of a method that learns


class Method(Protocol):
    """A compensation method. The compensator limits the correction and chooses the best pass for every method."""

    @property
    def name(self) -> str: ...

    @property
    def needs_arm(self) -> bool:
        """Whether the method uses the models of arm and cut, not only the pass."""

    @property
    def repeats(self) -> bool:
        """Whether passes and revisions continue until a pass brings no improvement."""

    @property
    def smooth(self) -> bool:
        """Whether the reference is smooth between the knots, so that a robot program runs it as SPLINE."""

    def revise(self, task: RevisionTask) -> Correction:
        """Return the correction for the next pass; raise RevisionError where the pass does not allow one."""


@dataclass(frozen=True)
class SampledMethod:
    """The displacement of the last pass at each knot, with the sign changed, Fig. 14."""

    name: str
    smooth: bool
    needs_arm: bool = False
    repeats: bool = False

    def revise(self, task: RevisionTask) -> Correction:
        from kr270_milling.physics.compensation.revision import sampled_correction

        return Correction(sampled_correction(task.target, task.reference, task.ran), self.smooth)


@dataclass(frozen=True)
class MirrorMethod:
    """The static mirror (30)-(32) under the mean wrench of the last pass; straight lines where the target has them."""

    name: str
    smooth: bool = True
    needs_arm: bool = True
    repeats: bool = False

    def revise(self, task: RevisionTask) -> Correction:
        from kr270_milling.physics.compensation.revision import RevisionError

        if task.models.mirror is None:
            raise RevisionError(f"the method {self.name} needs the model of the arm")
        target = task.target
        modified = task.models.mirror(target, task.ran.mean_wrench(target.time_ns))
        offset, smooth = modified.position - target.position, target.velocity is not None
        return Correction(offset, smooth, quaternion=modified.quaternion)


@dataclass(frozen=True)
class ResponseMethod:
    """Weighted least squares over the response of the arm to every knot, the arm as the passes show it."""

    name: str
    repeats: bool
    smooth: bool = True
    needs_arm: bool = True

    def revise(self, task: RevisionTask) -> Correction:
        from kr270_milling.physics.compensation.learning import Learner

        learner = task.learner or Learner.of_model(task.target, task.models, task.criterion, task.smooth)
        learner = learner.with_pass(task.ran, task.reference)
        offset, rates = learner.correction()
        return Correction(offset, rates is not None, rates, learner=learner)


BEST = "best"  #: in place of a method: a comparison chooses the method
LEARNED = ResponseMethod("learned", repeats=True)

#: every method by its name, in the order in which the commands list them
METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        SampledMethod("linear", smooth=False),
        SampledMethod("spline", smooth=True),
        LEARNED,
        MirrorMethod("mirror"),
        ResponseMethod("inverse", repeats=False),
    )
}


def method_of(method: str | Method) -> Method:
    """Return a method by its name; a method object stays."""
    return METHODS[method] if isinstance(method, str) else method
