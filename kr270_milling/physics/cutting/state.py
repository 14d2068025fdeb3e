"""Input (Params) and state (State) of the sweep of the teeth: plain arrays in named tuples, for compiled code."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from kr270_milling.base.errors import ParameterError
from kr270_milling.physics.cutting.grid import MAX_TILES, TILE, Stock, tile_count
from kr270_milling.physics.cutting.lanes import LANES
from kr270_milling.physics.cutting.laws import Cutting
from kr270_milling.physics.cutting.tool import Tool

# Places in State.ints
TILES = 0  # tiles in use
LOGGED = 1  # levels in the undo log
LOG_LOST = 2  # 1: the log overflowed
NEXT_STEP = 3  # micro-step up to which the history reaches
RUN = 4  # first micro-step of the present run of whole sectors, -1: none
RUN_LEVEL = 5  # shallowest level in this run
FLOOR = 6  # every node well inside the tool is cut at least to this level
FAILED = 7  # 1: no tile left
TALLIED = 8  # levels of the log that are in the tally
LOGGED_RUNS = 9  # runs of nodes in the undo log
NODES_CUT = 10  # nodes cut into so far, at whatever depth
INTS = 11
# Places in State.floats
LEVEL_SUM = 0  # depth removed, summed over the nodes [m]
UNDERCUT = 1  # depth removed above a leaning tool, summed over the nodes [m]
FLOATS = 2

BLOCK = 64  # columns of a sector whose ends are computed together


class Params(NamedTuple):
    """Constants of a cut; lengths in metres."""

    directions: np.ndarray  # (teeth, steps + 1, 2), of each tooth at each micro-step of a revolution
    middles: np.ndarray  # (teeth, steps, 2), half a micro-step later
    radii: np.ndarray  # (teeth,)
    shortest: float  # shortest radius
    pitch_steps: np.ndarray  # (teeth,), whole micro-steps to the tooth ahead
    steps: int  # micro-steps of a revolution
    sense: float
    micro_step: float  # [rad]
    spacing: float  # distance of nodes
    origin_x: float  # place of node 0
    origin_y: float
    nx: int
    ny: int
    top: float
    thickness: float
    level_step: float
    tolerance: int  # levels that the tool may sink before its footprint is swept again
    window: int  # micro-steps within which some tooth passes any point that the tool covers
    law: np.ndarray  # ``ForceLaw.table``
    nominal: bool  # the angle of a tooth is that of the spindle alone
    moments: bool  # forces turn the tool about its tip
    end_share: float  # share of the end edge that presses on the floor
    edge_radius: float  # below this layer the force of the end edge is in proportion to the layer
    lag: float  # tan(helix) per micro-step of spindle angle: an edge lags lag z / R micro-steps at z above the tip


class State(NamedTuple):
    """The grid and the tool's recent history."""

    pool: np.ndarray  # uint16, (tiles * TILE * TILE,): the tiles, x major, in order of first use
    table: np.ndarray  # int32, tile -> place in the pool or -1
    history: np.ndarray  # (power of 2, 3): x, y, path length at a micro-step, at its number modulo the size
    ints: np.ndarray  # int64, (INTS,)
    floats: np.ndarray  # (FLOATS,)
    saved_ints: np.ndarray  # as they were before the last sweep
    saved_floats: np.ndarray
    log_runs: np.ndarray  # int32, (any, 2): first node and length of each run of nodes visited in the last sweep
    log_level: np.ndarray  # uint16: the levels of these nodes before, run after run; LANES of it are only for overhang
    spans: np.ndarray  # int32, (2, BLOCK): scratch: first and last node of each column of a sector
    tally: np.ndarray  # int64, (4,): of one tooth and micro-step: nodes, level differences, lowest level, new nodes
    chips: np.ndarray  # (teeth,): largest chip thickness of each tooth in the last sweep [m]
    loads: np.ndarray  # (power of 2, 6): F_x, F_y, F_z, M_x, M_y, torque in a micro-step, at its number modulo the size
    saved_loads: np.ndarray  # as they were before the last sweep, if edges lag


def make_params(tool: Tool, cutting: Cutting, stock: Stock, micro_step: float) -> Params:
    """Micro_step [rad] must divide a revolution. Raises ParameterError."""
    steps = round(2 * math.pi / micro_step) if 0.0 < micro_step <= math.radians(15.0) else 0
    if not steps or abs(steps * micro_step - 2 * math.pi) > 1e-6:
        raise ParameterError("micro_step_deg", math.degrees(micro_step), "at most 15 and a whole part of 360")
    micro_step = 2 * math.pi / steps
    pitch_steps = np.rint(tool.pitches / micro_step).astype(np.int64)
    return Params(
        **common_params(tool, cutting, stock, micro_step),
        directions=_directions(tool, micro_step * (np.arange(steps + 1) % steps)),
        middles=_directions(tool, micro_step * (np.arange(steps) + 0.5)),
        radii=np.array(tool.radii),
        shortest=float(tool.radii.min()),
        pitch_steps=pitch_steps,
        steps=steps,
        tolerance=int(stock.floor_tolerance / stock.level_step),
        window=int(np.max(pitch_steps)) + int(0.126 / micro_step) + 6,
        nominal=cutting.chip_angle == "nominal",
        lag=math.tan(tool.helix) / micro_step,
    )


def common_params(tool: Tool, cutting: Cutting, stock: Stock, micro_step: float) -> dict:
    """Return the fields that the constants of both models of the cut have."""
    nx, ny = stock.nodes
    return {
        "sense": tool.sense,
        "micro_step": micro_step,
        "spacing": stock.grid_step,
        "origin_x": float(stock.min[0]) + 0.5 * stock.grid_step,
        "origin_y": float(stock.min[1]) + 0.5 * stock.grid_step,
        "nx": nx,
        "ny": ny,
        "top": float(stock.max[2]),
        "thickness": stock.thickness,
        "level_step": stock.level_step,
        "law": cutting.active.table,
        "moments": cutting.moments,
        "end_share": cutting.end_share,
        "edge_radius": tool.edge_radius,
    }


def _directions(tool: Tool, turn: np.ndarray) -> np.ndarray:
    """(teeth, turn.size, 2): a tooth at phi points to (cos phi, sense sin phi), exactly so at right angles."""
    phi = tool.angles[:, None] + turn
    out = np.stack([np.cos(phi), tool.sense * np.sin(phi)], -1)
    out[np.abs(out) < 1e-14] = 0.0
    return out


def log_size(params: Params, n: int, distance: float) -> int:
    """Nodes that n micro-steps over a distance [m] visit at most: whole sectors, and strips where the tool jumps."""
    reach = float(params.radii.max())
    area = params.radii.size * reach * (n * reach * params.micro_step + 2.0 * distance)
    columns = 2.0 * params.radii.size * n * (reach + distance / n) / params.spacing
    return int(min(area / params.spacing**2 + 4.0 * columns, 2.0**28)) + 4096


def make_log(size: int) -> dict:
    """The fields of State that hold the undo log; address space only, until it is written."""
    return {"log_runs": np.empty((size // 4, 2), np.int32), "log_level": np.empty(size + LANES, np.uint16)}


def make_state(params: Params, stock: Stock, size: int = 1 << 22) -> State:
    """An untouched stock. The pool is only address space until the tool comes to a tile; size: of the undo log."""
    tiles = tile_count(stock)
    longest = params.lag * stock.thickness / params.shortest  # [micro-steps]
    loads = np.zeros((1 << (int(min(longest, 2.0**20)) + 2).bit_length(), 6))
    ints = np.zeros(INTS, np.int64)
    ints[NEXT_STEP] = ints[RUN] = ints[FLOOR] = -1
    return State(
        pool=np.zeros(min(tiles[0] * tiles[1], MAX_TILES) * TILE**2 + LANES, np.uint16),
        table=np.full(tiles, -1, np.int32),
        history=np.zeros((1 << (params.window + params.steps + 8).bit_length(), 3)),
        ints=ints,
        floats=np.zeros(FLOATS),
        saved_ints=ints.copy(),
        saved_floats=np.zeros(FLOATS),
        **make_log(size),
        spans=np.zeros((2, BLOCK), np.int32),
        tally=np.zeros(4, np.int64),
        chips=np.zeros(len(params.radii)),
        loads=loads,
        saved_loads=np.zeros_like(loads),
    )
