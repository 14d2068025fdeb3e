"""Compute the revised reference trajectory from a recorded pass, by the same compensator as on line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from kr270_milling.base.errors import RecordingError
from kr270_milling.cell.arm import PlacedArm, commanded_joints
from kr270_milling.cell.models import arm_of, path_of
from kr270_milling.exchange.replay.attached import recorded_cells
from kr270_milling.exchange.replay.recompute import pass_over, record_difference, robots_of, usable
from kr270_milling.exchange.replay.revisions import Revisions
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.compensation.compensator import Compensator
from kr270_milling.physics.compensation.settings import CompensationSettings
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.passes import read_graph

__all__ = ["Revised", "compensate_recording"]


@dataclass(frozen=True, eq=False)
class Revised:
    """The revision after the last complete pass of one robot in a recording."""

    robot: str  #: namespace
    method: str
    reference: Trajectory
    joints: np.ndarray  #: [rad], (n, 6), at its knots
    remaining_error: float  #: [m], of the recorded pass
    largest_correction: float  #: [m], of a knot against the target
    published: bool | None  #: the live node published the same bits; None: not recorded, or another method was chosen

    def as_dict(self) -> dict:
        return dict(
            robot=self.robot or "/",
            method=self.method,
            remaining_error_um=self.remaining_error * 1e6,
            largest_correction_um=self.largest_correction * 1e6,
            identical_to_published=self.published,
            time_ns=self.reference.time_ns,
            position_m=self.reference.position,
            quaternion_xyzw=self.reference.quaternion,
            velocity_m_per_s=self.reference.velocity,
            joints_rad=self.joints,
        )


def compensate_recording(
    path, method: str | None = None, progress=None, remap: Mapping[str, str] = MappingProxyType({}), cell_file=None
) -> list[Revised]:
    """Return one revision per robot; ``method`` takes the place of the recorded one.

    remap: see ``Recording``; cell_file: see ``recorded_cells``.

    Raises RecordingError where no pass is complete, or where the pass cannot be revised.
    """
    revised = []
    with Recording(path, remap=remap) as recording:
        cells = recorded_cells(recording, cell_file)
        cell, _ = cells
        namespaces = robots_of(recording)
        for number, namespace in enumerate(namespaces, 1):
            graph = read_graph(recording, path_of(cell).clock, namespace, on_damage=pass_over)
            with usable(recording):
                revision = Revisions(recording, cells, graph).revise(method)
            if revision is not None:
                revised.append(_revised(arm_of(cell), cell.compensation, namespace, *revision))
            if progress:
                progress(number, len(namespaces))
        if not revised:
            raise RecordingError(recording.path, "holds no complete pass along a recorded reference trajectory")
    return revised


def _revised(
    arm: PlacedArm,
    settings: CompensationSettings,
    namespace: str,
    compensator: Compensator,
    target: Trajectory,
    published: Trajectory | None,
) -> Revised:
    shift = compensator.reference.position - target.sample(compensator.reference.time_ns)
    return Revised(
        namespace,
        compensator.method,
        compensator.reference,
        commanded_joints(arm, settings, compensator.reference),
        compensator.errors[-1],
        float(np.linalg.norm(shift, axis=1).max()),
        None if published is None else record_difference(published, compensator.reference) is None,
    )
