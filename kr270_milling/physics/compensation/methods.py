"""The compensation methods: one object each, in the table METHODS."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from kr270_milling.base.errors import ModelError, ParameterError, nearest
from kr270_milling.base.extensions import load_as, refused, registered
from kr270_milling.physics.compensation.method import Correction, Method, RevisionTask


@dataclass(frozen=True)
class SampledMethod:
    """The displacement of the last pass at each knot, with the sign changed, Fig. 14."""

    name: str
    smooth: bool
    recommended: bool = True
    repeats: bool = False

    def revise(self, task: RevisionTask) -> Correction:
        from kr270_milling.physics.compensation.revision import sampled_correction

        return Correction(sampled_correction(task.target, task.reference, task.ran), self.smooth)


class MirrorMethod:
    """The static mirror (30)-(32) under the mean wrench of the last pass; straight lines where the target has them."""

    name, smooth, repeats, recommended = "mirror", True, False, False

    def revise(self, task: RevisionTask) -> Correction:
        if task.models.mirror is None:
            raise ModelError(f"the method {self.name} needs the model of the arm")
        target = task.target
        modified = task.models.mirror(target, task.ran.mean_wrench(target.time_ns))
        offset, smooth = modified.position - target.position, target.velocity is not None
        return Correction(offset, smooth, quaternion=modified.quaternion)


@dataclass(frozen=True)
class ResponseMethod:
    """Weighted least squares over the response of the arm to every knot, the arm as the passes show it."""

    name: str
    repeats: bool = False
    robust: bool = False  #: in the mean of simulated robots, and not for the model alone
    smooth: bool = True
    recommended: bool = True

    def revise(self, task: RevisionTask) -> Correction:
        from kr270_milling.physics.compensation.learning import Learner

        learner = task.learner or Learner.of_model(task.target, task.models, task.criterion, task.smooth)
        learner = learner.with_pass(task.ran, task.reference)
        offset = learner.robust_correction() if self.robust else learner.correction()
        return Correction(offset, task.smooth, learner=learner)


BEST = "best"  #: in place of a method: a comparison chooses the method
LEARNED = ResponseMethod("learned", repeats=True)

#: every method of this package by its name, in the order in which the commands list them
METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        SampledMethod("linear", smooth=False, recommended=False),
        SampledMethod("spline", smooth=True),
        LEARNED,
        MirrorMethod(),
        ResponseMethod("inverse"),
        ResponseMethod("robust", robust=True),
    )
}


def _is_method(kind) -> bool:
    return isinstance(kind, type) and hasattr(kind, "revise")


def _is_object_with_revise(method) -> bool:
    return not isinstance(method, type) and all(hasattr(method, n) for n in ("name", "smooth", "repeats", "revise"))


@functools.cache
def _plugged() -> dict[str, Method]:
    """Return the methods of other packages; raises ConfigError."""
    loaded = {}
    for point in registered("methods", METHODS):
        loaded[point.name] = method = load_as(point, _is_method, "class with the function revise")()
        if method.name != point.name:
            raise refused(point, f"the method is named {method.name}; give both the same name")
    return loaded


def methods() -> dict[str, Method]:
    """Return METHODS and the methods of other packages, which are loaded at the first call; raises ConfigError."""
    return METHODS | _plugged()


def method_of(method: str | Method) -> Method:
    """Return a method by its name; a method object stays. Raises ParameterError for an unknown name or no method."""
    if not isinstance(method, str):
        if not _is_object_with_revise(method):
            wanted = "a name, or an object with name, smooth, repeats and the function revise"
            raise ParameterError("method", method, wanted)
        return method
    known = methods()
    if method not in known:
        raise ParameterError("method", method, f"one of {', '.join(known)}{nearest(method, known)}")
    return known[method]
