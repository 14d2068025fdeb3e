"""What the programmed path meets in the stock: depth of cut, rapid contact, material under the tool's middle.

The tool runs along its path without deflection through a coarse height map. That is blind to what the cut does to the
arm, and so tells a fault of the program from the little that a springy arm shaves off when it lifts out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from kr270_milling.cell.cell import Cell

__all__ = ["Engagement", "engagement"]

NODES_PER_RADIUS = 50  #: of the height map; a contact narrower than a fiftieth of the radius is not seen
MOST_VISITS = 2e9  #: of nodes, about a nanosecond each; a longer path takes a coarser map
CORE = 0.2  #: share of the radius about the axis where a cutter that is not centre-cutting has no edge


@dataclass(frozen=True, eq=False)
class Engagement:
    """At m places along the programmed path, workpiece frame."""

    position: np.ndarray  #: tool tip [m], (m, 3)
    time: np.ndarray  #: [s], (m,)
    rapid: np.ndarray  #: on a rapid move, (m,)
    depth: np.ndarray  #: deepest material above the tip within the tool's radius [m], (m,)
    inner: np.ndarray  #: the same within the radius less ``margin`` [m], (m,)
    core: np.ndarray  #: the same about the tool's axis, (m,)


def engagement(cell: Cell, margin: float) -> Engagement:
    """Run the programmed path through the stock; margin [m]: contacts no deeper than that are not in ``inner``."""
    position, time, rapid, step = _places(cell)
    low, high = cell.stock.min, cell.stock.max
    shape = np.maximum(1, np.ceil((high - low)[:2] / step)).astype(int)
    surface = np.full(tuple(shape), high[2])
    depth, inner, core = np.zeros((3, len(position)))
    radius = float(cell.tool.radii.max())
    radii = radius, max(radius - margin, 0.0), CORE * radius
    _mill(surface, low[:2] + step / 2, step, position, radii, margin, (depth, inner, core))
    return Engagement(position, time, rapid, depth, inner, core)


def _places(cell: Cell) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Tool tips, times and rapid flags half a node step apart, and the node step [m]."""
    target, timed = cell.target(), cell.timed_path
    radius = float(cell.tool.radii.max())
    length = timed.toolpath.length if timed else cell.path.length
    # length / (step / 2) places of pi (radius / step)^2 nodes each are to stay below MOST_VISITS
    step = max(radius / NODES_PER_RADIUS, (2.0 * np.pi * length * radius**2 / MOST_VISITS) ** (1.0 / 3.0))
    count = 2 + int(2.0 * length / step)
    if timed is None:
        time_ns = np.linspace(0, target.duration_ns, count).astype(np.int64)
        return target.sample(time_ns), time_ns * 1e-9, np.zeros(count, bool), step
    ends = np.cumsum(timed.toolpath.block_length)
    distance = np.sort(np.concatenate([np.linspace(0.0, timed.toolpath.length, count), ends[1:]]))  # every corner too
    block = np.clip(np.searchsorted(ends, distance), 1, len(ends) - 1)  # where two meet, the one that ends
    time = np.interp(distance, timed.distance_at(target.time_ns), target.time)
    return timed.toolpath.on_path(distance)[0], time, timed.toolpath.rapid[block], step


@njit(cache=True)
def _mill(surface, origin, step, position, radii, margin, found):
    """Lower the surface to the tool's end at each place, and note the deepest material that was there before."""
    depth, inner, core = found
    reach = int(radii[0] / step) + 1
    for k in range(position.shape[0]):
        x, y, z = position[k]
        middle_x, middle_y = int((x - origin[0]) / step), int((y - origin[1]) / step)
        for i in range(max(middle_x - reach, 0), min(middle_x + reach + 2, surface.shape[0])):
            away_x = origin[0] + i * step - x
            for j in range(max(middle_y - reach, 0), min(middle_y + reach + 2, surface.shape[1])):
                away = np.sqrt(away_x**2 + (origin[1] + j * step - y) ** 2)
                over = surface[i, j] - z
                if over <= 0.0 or away >= radii[0]:
                    continue
                depth[k] = max(depth[k], over)
                if away < radii[1] and over > margin:
                    inner[k] = max(inner[k], over)
                if away < radii[2]:
                    core[k] = max(core[k], over)
                surface[i, j] = z
