"""The compensator's work on recorded messages: which reference trajectory follows from a recorded pass."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.frames import rotation_from_quaternion
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.jobs import commanded_joints, compensator, pass_record
from kr270_milling.compensation.compensator import LEAST_GAIN, Compensator, PassListener
from kr270_milling.compensation.parameters import METHODS
from kr270_milling.compensation.revision import PassRecord
from kr270_milling.messages import encode
from kr270_milling.replay.compare import Channel
from kr270_milling.replay.inputs import TOOL, Sample, trajectory_of
from kr270_milling.replay.models import JOINT_NAMES, WORKPIECE
from kr270_milling.trajectory.trajectory import Trajectory

__all__ = ["CompensatorModel", "Report", "read_report"]

ROUNDING = 1e-10  # [m], of the remaining errors in the compensator's diagnostics


@dataclass(frozen=True)
class Report:
    """What the compensator told of itself in /diagnostics."""

    method: str
    errors: tuple[float, ...]  #: [m], remaining error of each pass
    finished: bool


def read_report(values: dict[str, str]) -> Report | None:
    """From the keys and values of a diagnostic status; None where it is not the compensator's."""
    try:
        errors = tuple(float(e) * 1e-6 for e in values["remaining_error_um"].split())
        finished = {"True": True, "False": False}[values["finished"]]
    except (KeyError, ValueError):
        return None
    return Report(values["method"], errors, finished) if values.get("method") in METHODS else None


def reference_bytes(reference: Trajectory) -> encode.Encoded:
    return encode.trajectory_bytes(
        reference.frame, TOOL, reference.time_ns, reference.position, reference.quaternion, reference.velocity
    )


class CompensatorModel:
    """tool_pose and wrench of a pass in; the revised reference_trajectory and joint_trajectory out.

    The first reference in the recording is what was run. Whether an earlier pass made it is told by the reports:
    the first in the file (``opening``) and the latest before the pass was complete.
    """

    def __init__(self, cell: Cell, outputs: dict[str, Channel], stop, opening: Report | None):
        self.cell, self._out, self._stop, self._opening = cell, outputs, stop, opening
        self.report: Report | None = None
        self.target = cell.target()
        self._state: Compensator | None = None  # of the node, where the recording tells it
        self._ran: list[Sample] | None = None  # the poses of the complete pass
        self._ran_report: Report | None = None

    def run(self, data: bytes) -> None:
        """The reference that the next pass runs, as it was recorded."""
        self.reference = trajectory_of(data, as_sent=True)
        clock = self.cell.clock
        self._listener = PassListener(int(clock.stamp(clock.steps(self.reference.duration_ns))))
        self._wrenches: dict[int, np.ndarray] = {}  # stamp -> (6,), workpiece axes

    def hear_target(self, data: bytes) -> None:
        self.target, self._state = trajectory_of(data), None

    def wrench(self, heard: Sample) -> None:
        if not self._listener.stamps or heard.frame not in (WORKPIECE, TOOL) or not heard.finite:
            return
        values = np.array(heard.values)
        if heard.frame == TOOL:
            turn = rotation_from_quaternion(np.array(self._listener.items[-1].values[3:]))
            values = np.concatenate([turn @ values[:3], turn @ values[3:]])
        self._wrenches[heard.stamp] = values

    @property
    def complete(self) -> bool:
        """Whether a pass was heard to its end since the last reference."""
        return self._ran is not None

    def pose(self, heard: Sample) -> None:
        listener = self._listener
        if heard.frame != WORKPIECE or not heard.finite:
            return
        if heard.stamp == 0 and listener.stamps != [0]:
            self._wrenches = {}
        if listener.stamps and heard.stamp == listener.stamps[-1]:
            listener.items[-1] = heard  # the exchange is iterated, or the robot asked again
        elif listener.hear(heard.stamp, heard):
            self._ran, self._ran_report = listener.items, self.report

    def hear_reference(self, data: bytes, first: bool) -> None:
        """A recorded reference: compare it with what the pass before it gives, then go on from it."""
        channel, candidates = self._out["reference_trajectory"], self._candidates(first)
        found = next((c for c in candidates if reference_bytes(c.reference).same(data)), None)
        if found is None and self._ran and not first and candidates[1:]:
            found = candidates[0]
        if found is None:
            channel.take(data)
        else:
            channel.made(0, reference_bytes(found.reference))
            channel.heard(0, data)
        self._state, self._ran = found, None
        if not first:
            self.run(data)
        if found is not None:  # what is run next is what was sent
            found.reference = self.reference
        if "joint_trajectory" in self._out:
            joints = commanded_joints(self.cell, self.reference)
            message = encode.joint_trajectory_bytes("base_link", JOINT_NAMES, self.reference.time_ns, joints)
            self._out["joint_trajectory"].made(0, message)

    def _candidates(self, first: bool) -> list[Compensator]:
        """States that the node may be in now, the likely one first; the last is that after a reset."""
        states = []
        if self._ran and not first:
            states = self.revise()
        return [*states, compensator(self.cell, self.target, self.method)]

    def revise(self, method: str | None = None) -> list[Compensator]:
        """The compensator after the complete pass; none if the recording does not decide it.

        The wrench that answers the last pose may have come before the revision, or not in time.
        """
        before = self._before(method)
        if before is None:
            return []
        states = []
        for last_wrench in (True, False):
            state = copy.copy(before)
            state.errors = list(before.errors)
            state.revise(self._record(last_wrench))
            states.append(state)
        decided = [s for s in states if s.reference is not None and (before.finished or self._decided(s))]
        if len(decided) < len(states):
            self._stop(
                self._ran[-1].stamp,
                f"whether {before.method} goes on or back to an earlier pass is not decidable from this file",
            )
        return decided

    @property
    def method(self) -> str:
        """The method that the node used, as it told, or that of the cell."""
        report = self._ran_report or self.report or self._opening
        return report.method if report else self.cell.compensation.method

    def _before(self, method: str | None) -> Compensator:
        """The state in which the node was when the pass was complete."""
        if self._state is not None and method is None:
            return self._state
        state = compensator(self.cell, self.target, method or self.method)
        if reference_bytes(self.reference).same(reference_bytes(self.target).data):
            return state
        report = self._ran_report or self._opening
        if report is None and state.repeats:
            self._stop(self._ran[-1].stamp, "nothing in the recording tells how good the passes before this one were")
            return None
        earlier = report.errors if report else ()
        if report and self._ran_report is None:  # the report came behind this pass
            earlier = earlier[:-1]
        state.reference, state.errors = self.reference, list(earlier)
        if report and report.finished and self._ran_report is not None:
            state.finished, state._best = True, (min(earlier), self.reference, ())  # noqa: SLF001
        elif earlier:
            state._best = (min(earlier), None, ())  # that trajectory is not in this recording  # noqa: SLF001
        return state

    def _decided(self, state: Compensator) -> bool:
        """Whether the rounding of earlier errors in the diagnostics leaves no doubt about "learned"."""
        if not state.repeats or len(state.errors) < 2:
            return True
        earlier, last = min(state.errors[:-1]), state.errors[-1]
        exact = self._state is not None
        return exact or min(abs(last - earlier), abs(last - (1.0 - LEAST_GAIN) * earlier)) > ROUNDING

    def _record(self, last_wrench: bool) -> PassRecord:
        stamps = np.array([p.stamp for p in self._ran])
        positions = np.array([p.values[:3] for p in self._ran])
        return pass_record(self.cell, stamps, positions, self._wrench_series(last_wrench))

    def _wrench_series(self, last_wrench: bool) -> np.ndarray:
        """(n, 6) at the stamps of the poses, as the node makes it of what it heard."""
        times = np.array(sorted(t for t in self._wrenches if last_wrench or t < self._ran[-1].stamp))
        if not times.size:
            return np.zeros((len(self._ran), 6))
        values = np.array([self._wrenches[stamp] for stamp in times.tolist()])
        return np.column_stack([np.interp([p.stamp for p in self._ran], times, axis) for axis in values.T])
