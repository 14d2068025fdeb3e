"""A compensation method: what it receives, what it returns, and its interface.

The command line reads the names of the methods, so a method imports a library only when it revises.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import numpy as np

    from kr270_milling.path.trajectory import Trajectory
    from kr270_milling.physics.compensation.learning import CellModels, Learner
    from kr270_milling.physics.compensation.revision import PassRecord


@dataclass(frozen=True, eq=False)
class RevisionTask:
    """The input of one revision."""

    target: Trajectory
    reference: Trajectory  #: reference of the last pass
    ran: PassRecord  #: the last pass
    models: CellModels
    criterion: str  #: "min_max" or "least_squares", of methods that minimise
    smooth: bool  #: a spline joins the knots, of methods that can do both
    learner: Learner | None  #: learner of the last revision by this method


@dataclass(frozen=True, eq=False)
class Correction:
    """Reference minus target at the k knots of the target, before any limit."""

    offset: np.ndarray  #: [m], (k, 3)
    smooth: bool  #: a spline joins the knots; else straight lines
    quaternion: np.ndarray | None = None  #: orientations x, y, z, w, (k, 4); None: those of the target
    learner: Learner | None = None  #: the experience for the next revision, of a method that learns


class Method(Protocol):
    """A compensation method. The compensator limits the correction and chooses the best pass for every method."""

    @property
    def name(self) -> str: ...

    @property
    def repeats(self) -> bool:
        """Return whether passes and revisions continue until a pass brings no improvement."""

    @property
    def smooth(self) -> bool:
        """Return whether the reference is smooth between the knots, so that a robot program runs it as SPLINE."""

    @property
    def recommended(self) -> bool:
        """Return whether ``best`` and the verdict compare it; a method of another package need not state it."""

    def revise(self, task: RevisionTask) -> Correction:
        """Return the correction for the next pass; raise ModelError where the pass does not allow one."""
