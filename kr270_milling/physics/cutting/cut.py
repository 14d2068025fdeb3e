"""Cut of a workpiece by a tool: poses in, wrenches out."""

from __future__ import annotations

import math

import numpy as np

from kr270_milling.base.errors import MillingError
from kr270_milling.physics.cutting.cut_step import cut_undo, engage, sweep_teeth
from kr270_milling.physics.cutting.engagement import (
    BINS,
    EngagementParams,
    EngagementState,
    make_engagement_params,
    make_engagement_state,
)
from kr270_milling.physics.cutting.grid import TILE, Stock, levels_in_window
from kr270_milling.physics.cutting.lanes import LANES
from kr270_milling.physics.cutting.laws import Cutting
from kr270_milling.physics.cutting.state import (
    FAILED,
    LEVEL_SUM,
    NODES_CUT,
    TILES,
    UNDERCUT,
    Params,
    State,
    log_size,
    make_log,
    make_params,
    make_state,
)
from kr270_milling.physics.cutting.sweep import NO_FORCES
from kr270_milling.physics.cutting.tool import Tool


class CutModel:
    """The cutting process: one interface for both models; compiled loops take its fields.

    tool, cutting, stock: records of the parameter file; the grid of ``stock`` is that of the model.
    """

    params: Params | EngagementParams
    state: State | EngagementState
    #: arguments of ``cut_undo``, not fields of params: so all combinations share the compiled parts below ``engage``
    teeth: bool | None
    mean: tuple[bool | None, bool | None] | None
    tilts = False  #: poses have the axis of the tool after the position of its tip, (6,)

    def __init__(self, tool: Tool, cutting: Cutting, stock: Stock):
        self.tool, self.cutting, self.stock = tool, cutting, stock
        self.torque = 0.0  #: mean spindle torque of the last sweep [N m]

    def sweep(self, pose_from, pose_to, first: int, n: int, forces: np.ndarray = NO_FORCES) -> np.ndarray:
        """Move the tool tip straight from one position (3,) [m] to another in n micro-steps, workpiece frame.

        first: number of the first micro-step, counted from the pass's start; forces: (n, 3), filled if given [N].
        Of a tool that tilts, each position may have the axis after it, (6,). Returns the mean wrench (6,) on the tool,
        moments about its tip [N, N m]. Raises MillingError.
        """
        start, end = np.array(pose_from, float), np.array(pose_to, float)
        if self.tilts and start.shape == end.shape == (3,):
            start, end = self.poses(np.vstack([start, end]), None)
        size = 6 if self.tilts else 3
        sound = start.shape == end.shape == (size,) and all(map(math.isfinite, start.tolist() + end.tolist()))
        if not sound or first < 0 or n < 1 or forces.shape not in ((n, 3), (0, 3)):
            raise MillingError(
                f"a sweep from {pose_from} to {pose_to} in {n} micro-steps from number {first} must have positions of "
                "three finite numbers, at least one micro-step, no negative number, and room for each force if wanted"
            )
        self._make_room(n, math.dist(start[:3].tolist(), end[:3].tolist()))
        wrench, torque, volume = np.empty((2, 6)), np.empty(2), np.empty(2)
        steps = np.array([first, first + n], np.int64)
        self._cut(self.state, self.params, np.array([start, end]), steps, forces, (wrench, torque, volume))
        self.refuse_failure()
        self.torque = float(torque[1])
        return wrench[1]

    def along(
        self, positions: np.ndarray, steps: np.ndarray, predicted: bool = False, axes: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Move the tool tip through positions (n, 3) [m], reached at micro-steps (n,) from the pass's start.

        predicted: whether the positions are those that the robot predicted, as in ``sweep``; axes: unit vectors from
        the tip to the holder, (n, 3), default upright.

        Returns the mean wrench (n, 6) [N, N m], the mean spindle torque (n,) [N m] and the volume removed (n,) [m^3] on
        the way to each position; 0 for the first. Raises MillingError.
        """
        positions, steps = self.poses(positions, axes), np.ascontiguousarray(steps, np.int64)
        wrench, torque, volume = np.zeros((len(positions), 6)), np.zeros(len(positions)), np.zeros(len(positions))
        params = self.params if predicted else self.final_params
        self._cut(self.state_of_pass, params, positions, steps, NO_FORCES, (wrench, torque, volume))
        self.refuse_failure()
        return wrench, torque, volume

    def _cut(self, state, params, poses: np.ndarray, steps: np.ndarray, forces: np.ndarray, out: tuple) -> None:
        """Cut from each pose to the next, reached at micro-steps (n,); out: see ``engage``."""
        if self.mean:
            engage(state, params, params.flat, params.profile, *self.mean, poses, steps, *out)
        else:
            sweep_teeth(state, params, poses, steps, forces, *out)

    def poses(self, positions: np.ndarray, axes: np.ndarray | None) -> np.ndarray:
        """Return the rows that a cut takes: positions (n, 3) [m]; with the axes (n, 3) where the tool tilts."""
        if not self.tilts:
            return np.ascontiguousarray(positions, float)
        upright = np.broadcast_to([0.0, 0.0, 1.0], np.shape(positions))
        return np.hstack([positions, upright if axes is None else axes])

    @property
    def final_params(self) -> Params | EngagementParams:
        """Parameters for positions that no correction changes."""
        return self.params

    def _make_room(self, n: int, distance: float) -> None:
        """Have an undo log for n micro-steps over a distance [m]."""

    def continue_from(self, before: CutModel) -> None:
        """Begin with the workpiece that another cut left on the same grid; its removed volume is not counted."""
        used = before.tiles * TILE**2
        self.state.pool[:used] = before.state.pool[:used]
        self.state.table[:] = before.state.table
        self.state.ints[TILES] = before.tiles

    def touch(self, most: int = 1 << 26) -> None:
        """Have the memory of the stock, up to so many bytes, so that no sweep waits for the system to clear a page."""
        used = self.state.ints[TILES] * TILE**2
        self.state.pool[used : most // self.state.pool.itemsize].fill(0)

    @property
    def state_of_pass(self) -> State | EngagementState:
        """The state for a pass in which no step is taken back."""
        return self.state

    def restore(self) -> None:
        """Take the last sweep back, once. Raises MillingError."""
        self.refuse_failure(cut_undo(self.state, self.teeth, self.mean))

    def refuse_failure(self, undone: bool = True) -> None:
        """Raise MillingError where no tile of the grid is left; undone: whether all could be taken back."""
        if self.state.ints[FAILED]:
            raise MillingError(
                f"the cut area fills more than {self.state.pool.size // TILE**2} tiles of the grid; a larger "
                "stock.grid_step_um would fit"
            )
        if not undone:
            raise MillingError(f"the last sweep cleared more nodes than the {self.undo_size} that can be taken back")

    @property
    def undo_size(self) -> int:
        """Nodes that ``restore`` can put back."""
        return self.state.log_level.size

    @property
    def removed_area(self) -> float:
        """Area that was cut into so far, at whatever depth [m^2]."""
        return int(self.state.ints[NODES_CUT]) * self.params.spacing**2

    @property
    def removed_volume(self) -> float:
        """[m^3]."""
        return float(self.state.floats[LEVEL_SUM]) * self.params.spacing**2

    @property
    def undercut_volume(self) -> float:
        """Return the part of the removed volume that was above a leaning tool [m^3]."""
        return float(self.state.floats[UNDERCUT]) * self.params.spacing**2

    @property
    def tiles(self) -> int:
        """Tiles of the grid in use."""
        return int(self.state.ints[TILES])

    def heights(self, low=None, high=None, thinning: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nodes' x (m,) and y (k,) and the part's surface z (m, k) [m], workpiece frame.

        low, high: corners (2,) of a window, default the whole stock; thinning: take one node in so many each way.
        """
        axes = []
        for axis, count in enumerate(self.stock.nodes):
            places = (np.arange(count) + 0.5) * self.stock.grid_step + self.stock.min[axis]
            first = 0 if low is None else np.searchsorted(places, low[axis])
            last = count if high is None else np.searchsorted(places, high[axis], side="right")
            numbers = np.arange(first, last)[min(thinning, last - first) // 2 :: thinning]  # one at least
            axes.append((numbers, places[numbers]))
        (ix, x), (iy, y) = axes
        levels = levels_in_window(self.state.pool, self.state.table, ix, iy)
        return x, y, self.stock.max[2] - levels * self.params.level_step

    @property
    def map_thinning(self) -> int:
        """Nodes of the grid from one node of ``map_heights`` to the next."""
        return max(1, round(max(self.stock.nodes) / 400))

    def map_heights(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """``heights`` of the whole stock, thinned to some 400 nodes along its longer side."""
        return self.heights(thinning=self.map_thinning)


class Cut(CutModel):
    """The sweep of the teeth: each tooth in each micro-step of the spindle angle.

    micro_step: of the spindle angle [rad], a whole part of a revolution; log_size: nodes that restore() can put back,
    default: enough for any sweep of up to a revolution.
    """

    params: Params
    state: State
    teeth, mean = True, None

    def __init__(self, tool: Tool, cutting: Cutting, stock: Stock, micro_step: float, log_size: int | None = None):
        super().__init__(tool, cutting, stock)
        self.params = make_params(tool, cutting, stock, micro_step)
        self.state = make_state(self.params, stock, log_size or 1 << 22)
        self._log_grows = log_size is None
        self._room = (0, 0.0)  # micro-steps and distance [m] of a sweep that the log has room for

    def _make_room(self, n: int, distance: float) -> None:
        """Have an undo log for n micro-steps over twice the distance [m], so that this is seldom needed."""
        if not self._log_grows or n > self.params.steps:
            return
        if n > self._room[0] or distance > self._room[1]:
            self._room = max(n, self._room[0]), max(2.0 * distance, self._room[1])
            size = log_size(self.params, *self._room)
            if size > self.undo_size:
                self.state = self.state._replace(**make_log(size))

    @property
    def undo_size(self) -> int:
        return self.state.log_level.size - LANES  # the vector step writes that far beyond the last node


class EngagementCut(CutModel):
    """The mean force of the engagement, for steps of some milliseconds: ``engagement`` has the equations.

    stock: with the coarse grid of this model; micro_step [rad]: the unit in which a step counts spindle angle; bins: of
    the angle about the tool; give: displacement of the tip along z in a step by a unit force [m/N], where ``sweep``
    gets predicted poses. ``along`` gets final poses. bounce: ``mean_thrusts`` of the arm, default: the tip is steady. A
    tool whose end is not flat takes the part of ``revolution``; tilts: the axis of the tool leaves z of the workpiece;
    upright: the axis is z of the workpiece in some step that cuts.
    """

    params: EngagementParams
    state: EngagementState
    teeth = None

    def __init__(
        self,
        tool: Tool,
        cutting: Cutting,
        stock: Stock,
        micro_step: float,
        bins: int = BINS,
        give: float = 0.0,
        tilts: bool = False,
        bounce: np.ndarray | None = None,
        upright: bool = True,
    ):
        super().__init__(tool, cutting, stock)
        self.tilts, self.mean = tilts, (tilts or None, upright or None)
        self.params = make_engagement_params(tool, cutting, stock, micro_step, bins, give, tilts, bounce, upright)
        self.state = make_engagement_state(self.params, stock)

    def continue_from(self, before: CutModel) -> None:
        super().continue_from(before)
        if self.params.profile is not None:
            used = before.tiles * TILE**2
            self.state.rest[:used] = self.state.pool[:used]

    @property
    def final_params(self) -> EngagementParams:
        return self.params._replace(give=0.0)

    @property
    def state_of_pass(self) -> EngagementState:
        """Without an undo log, whose writing takes time."""
        nodes = np.empty(0, np.uint16)
        return self.state._replace(log_place=np.empty(0, np.int64), log_level=nodes, log_rest=nodes)
