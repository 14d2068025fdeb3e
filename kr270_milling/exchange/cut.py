"""Protocol of the cutting process: it answers each tool pose with the mean wrench of the path to this pose.

The node hands its messages to this object, and a recompute the recorded ones.
"""

from __future__ import annotations

import numpy as np

from kr270_milling.base.errors import MessageError
from kr270_milling.base.frames import WORKPIECE, tool_axis
from kr270_milling.base.samples import PoseSample, StockMap, WrenchSample
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import cut_of, path_of
from kr270_milling.exchange.inputs import ExchangeError, Output, checked_pose
from kr270_milling.path.trajectory import Trajectory
from kr270_milling.physics.cutting import CutModel
from kr270_milling.physics.motion.milling_pass import silent_periods


class CutProtocol:
    """tool_pose in; wrench and workpiece out. A pass needs a fresh workpiece: ``configure``."""

    def __init__(self, cell: Cell):
        self.cell = cell
        self.cut: CutModel | None = None  #: the tool on the workpiece
        self.step = -1  #: last exchange that was answered; -1 before the first one
        self.stamp_ns = 0  #: stamp of the last answer
        self.start_ns = 0  #: stamp of the first exchange of the pass
        self._end_ns = 0  # end of the pass, 0 where it is not known
        self.planned: tuple[int, int] | None = None  #: stamps of start and end of the next pass
        self._clock = path_of(cell).clock

    def reference(self, run: Trajectory) -> None:
        """Take the reference of the next pass, which states the start of the pass."""
        self.planned = run.start_ns, run.start_ns + run.duration_ns

    def configure(self) -> list[Output]:
        """Create a fresh workpiece and return its map, so that late subscribers do not see the previous part."""
        self.cut = cut_of(self.cell)
        self.cut.touch()
        self._silent, path = np.zeros(0, bool), path_of(self.cell)  # exchanges whose wrench is zero
        if path.drills:  # the force of drilling is not modelled; else the cut does not need the times of the path
            steps = np.arange(self._clock.steps(path.target.duration_ns) + 1)
            self._silent = silent_periods(path.drilling_at(self._clock.stamp(steps)))
        self.step, self.stamp_ns = -1, 0
        self._before = self._tool = np.zeros(3)  # tool centre of the previous exchange, and of the last one
        self._wrench = np.zeros(6)
        return [("workpiece", self.map_of_part())]

    def release(self) -> None:
        """Drop the workpiece."""
        self.cut, self.step = None, -1

    @property
    def under_way(self) -> bool:
        """Return whether a pass was started and has not reached the end of the reference trajectory."""
        return self.step >= 0 and self.stamp_ns < self._end_ns

    @property
    def at_end(self) -> bool:
        """Return whether the pass has reached the end of the reference trajectory."""
        return self.step > 0 and not self.under_way

    @property
    def removed_volume(self) -> float | None:
        """[m^3]; None without a workpiece."""
        return None if self.cut is None else float(self.cut.removed_volume)

    def pose(self, sample: PoseSample) -> list[Output]:
        """Answer a tool_pose. A repeated one gets the same answer.

        Raises MessageError or ExchangeError where the pose is refused.
        """
        checked_pose(sample)
        if self.cut is None:
            raise MessageError("no workpiece yet: configure first")
        tool = sample.position
        if self.cut.tilts:
            tool = np.hstack([tool, tool_axis(sample.quaternion)])
        self._answer(self.cut, sample.stamp, tool)
        self.stamp_ns = sample.stamp
        return [("wrench", WrenchSample(sample.stamp, WORKPIECE, self._wrench))]

    def _answer(self, cut: CutModel, stamp_ns: int, tool: np.ndarray) -> None:
        """Update the wrench. Raises ExchangeError for a stamp that is neither the next nor the last one."""
        if self.step < 0:
            self.start_ns, self._end_ns = self.planned or (0, 0)
        step = self._clock.step(stamp_ns - self.start_ns)
        if step == 0 and self.step <= 0:
            self.step, self._tool, self._wrench = 0, np.array(tool), np.zeros(6)
        elif step == 0 or (self.step >= 0 and self.planned is not None and stamp_ns == self.planned[0]):
            raise ExchangeError(stamp_ns, "a new pass needs a fresh workpiece: configure the cutting process again")
        elif self.step < 0:
            raise ExchangeError(stamp_ns, "the pass is under way, but this cutting process has not seen its start")
        elif step == self.step + 1:
            self._sweep(cut, step, self._tool, tool)
        elif step == self.step:
            if not np.array_equal(tool, self._tool):  # the exchange is iterated
                cut.restore()
                self._sweep(cut, step, self._before, tool)
        else:
            relation = "is older than" if 0 <= step < self.step else "does not follow"
            last = self.start_ns + int(self._clock.stamp(self.step))
            raise ExchangeError(stamp_ns, f"{relation} the last one, {last * 1e-9:.6f} s")

    def _sweep(self, cut: CutModel, step: int, start: np.ndarray, end: np.ndarray) -> None:
        n = self._clock.micro_steps
        wrench = cut.sweep(start, end, (step - 1) * n, n)
        self._wrench = np.zeros(6) if step < self._silent.size and self._silent[step] else wrench
        self.step, self._before, self._tool = step, start, np.array(end)

    def map_of_part(self) -> StockMap:
        """Return the thinned map of the part; raises MessageError."""
        if self.cut is None:
            raise MessageError("no workpiece yet: configure first")
        stock = self.cell.stock
        thinning = max(1, round(0.2e-3 / stock.grid_step))  # the published map has nodes every 0.2 mm
        _, _, surface = self.cut.heights(thinning=thinning)
        removed = (stock.max[2] - surface) / (stock.max[2] - stock.min[2])
        left = np.rint(100 * (1 - removed)).astype(np.int8)
        resolution = float(np.float32(thinning * stock.grid_step))  # the message has 32 bits for it
        return StockMap(self.stamp_ns, WORKPIECE, resolution, stock.min, left)
