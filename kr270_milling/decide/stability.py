"""Stability statement of a cell: depth of cut against the limit of each feature, with the modes of arm and tool.

Every distinct engagement of a feature (angles, feed and its direction) is evaluated in the posture of its deepest cut.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kr270_milling.base.column import column, computed
from kr270_milling.base.errors import ParameterError
from kr270_milling.base.frames import rotation_from_abc
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.models import arm_of, modal_model_of, path_of
from kr270_milling.cell.paths import CellPath
from kr270_milling.decide.arcs import Arcs, arcs_along
from kr270_milling.decide.findings import Finding, violation
from kr270_milling.physics.motion.dynamics import ModalModel
from kr270_milling.physics.motion.stability import DEEPEST, Lobe, Modes, stability_limit

FULL = math.radians(75.0)  #: beyond this angle a tooth is taken as cutting to 90 deg, where its chip ends
FEWEST_TEETH = 10  #: teeth of an engagement; vibration has no time to grow in fewer
POSTURES = 0.025  #: [m], between two places whose postures are modelled; the modes change little in between


@dataclass(frozen=True)
class FeatureLimit:
    """The engagement of one feature that comes nearest to its limit, or goes farthest beyond."""

    name: str = column("feature", short="feature")
    limit: Lobe = column("*")
    time: float = column("")  #: at the place [s]
    #: depth of the cut [m]
    depth: float = column("depth_mm", 1e3, unit="mm", digits=3, short="depth")
    #: angle of a tooth [rad], from the feed in the sense of rotation
    entry: float = column("entry_deg", 180.0 / math.pi, unit="deg", digits=0, short="from")
    exit: float = column("exit_deg", 180.0 / math.pi, unit="deg", digits=0, short="to")  #: [rad]

    @computed("word")
    def word(self) -> str:
        """ "chatter" above the limit, "near the limit" within 20 % below, else "stable"."""
        if self.depth > self.limit.depth_limit:
            return "chatter"
        margin = 0.8  # share of the limit depth above which a cut gets a warning
        return "near the limit" if self.depth > margin * self.limit.depth_limit else "stable"

    @property
    def numbers(self) -> str:
        """Depth, limit, chatter frequency, and the angles of a tooth for which they hold."""
        hertz = self.limit.chatter_frequency / (2.0 * math.pi)
        limit = f"limit {1e3 * self.limit.depth_limit:.3g} mm, chatter at {hertz:.4g} Hz"
        if math.isinf(self.limit.depth_limit):
            limit = f"limit above {1e3 * DEEPEST:.0f} mm"
        entry, leave = np.round(np.degrees([self.entry, self.exit])) + 0.0  # no -0
        return f"{1e3 * self.depth:.3g} mm, {limit}, teeth in cut from {entry:.0f} to {leave:.0f} deg"

    @property
    def share_of_limit(self) -> float:
        """Depth over its limit; infinite where every depth chatters."""
        return self.depth / self.limit.depth_limit if self.limit.depth_limit else math.inf

    @computed("stable", short="stable")
    def stable(self) -> bool:
        """Return whether the depth is below its limit."""
        return self.depth <= self.limit.depth_limit


@dataclass(frozen=True)
class Stability:
    """Statement for the whole path."""

    features: tuple[FeatureLimit, ...] = column("features")
    with_tool: bool = column("tool_modes")  #: the modes of tool and spindle are known
    shape: str = column("", default="")  #: clause about a tool that is not flat or not upright: no limit is known

    @property
    def worst(self) -> FeatureLimit | None:
        """The feature with the largest depth against its limit; None where nothing is milled."""
        return max(self.features, key=lambda limit: limit.share_of_limit, default=None)

    @computed("word")
    def word(self) -> str:
        """ "stable", "near the limit", "chatter" or "unknown"."""
        return self.worst.word if self.worst else "unknown"

    def word_at(self, path: CellPath, time: float) -> str:
        """The word of the feature that is milled at a time [s], of the whole path where that feature has none."""
        timed, name = path.timed, "straight cut"
        if timed:
            name = timed.toolpath.features[timed.toolpath.feature[int(timed.block_at(round(1e9 * time)))]] or "unnamed"
        return next((limit.word for limit in self.features if limit.name == name), self.word)

    @computed("text")
    def text(self) -> str:
        """Return one line, the same in every output."""
        known = "unknown (nothing is milled)"
        if self.worst:
            known = f"{self.word} ({self.worst.name}: {self.worst.numbers})"
        if self.shape:
            known = f"not judged (the limits hold for upright flat ends, and {self.shape})"
        if self.with_tool:
            return f"stability: arm, tool and spindle: {known}"
        return f"stability: arm: {known}; tool and spindle: unknown (no tool.modes)"


@functools.lru_cache(maxsize=1)  # ``compensate`` computes it beside other work
def stability_statement(cell: Cell) -> Stability:
    """The statement of a cell whose arm can follow the path."""
    with_tool = bool(cell.tool.modes.frequency.size)
    if not cell.tool.has_flat_end:
        return Stability((), with_tool, shape=f"tool.type is {cell.tool.type}")
    if path_of(cell).tilts:
        return Stability((), with_tool, shape="the tool is tilted")
    return Stability(tuple(feature_limits(cell)), with_tool)


def chatter_violations(stability: Stability, time: np.ndarray) -> list[Finding]:
    """A stop for each feature above its limit, a warning for each within 20 % below; time: of the points [s], (n,)."""
    offences = [violation("stability not judged", 0.0, 0.0, shape=stability.shape)] if stability.shape else []
    for milled in stability.features:
        if milled.word == "stable":
            continue
        point = int(np.clip(np.searchsorted(time, milled.time - 1e-6), 0, len(time) - 1)) + 1
        above = milled.word == "chatter"
        words = "above the stability limit" if above else "less than 20 % below the stability limit"
        hertz = milled.limit.chatter_frequency / (2.0 * math.pi)
        offences.append(
            violation(
                "chatter",
                milled.depth,
                milled.limit.depth_limit,
                point,
                severity="stop" if above else "warning",
                subject=milled.name,
                words=words,
                hertz=hertz,
            )
        )
    return offences


def modes_of(cell: Cell, arm: bool = True, model: ModalModel | None = None) -> Modes:
    """The modes of the arm, and those of ``tool.modes``; arm: False leaves out the former.

    model: of the arm in another posture than where the path starts. Raises ParameterError where that leaves no mode.
    """
    tool = cell.tool.modes
    own = Modes(2.0 * np.pi * tool.frequency, tool.damping_ratio, tool.shapes.reshape(-1, 3))
    if not arm and not tool.frequency.size:
        raise ParameterError("tool.modes", [], "given where the arm is left out: there is no mode that could chatter")
    if not arm:
        return own
    model = model or modal_model_of(cell)
    ratio = np.full(model.frequency.size, cell.dynamics.damping_ratio) if model.damping is None else model.damping
    return Modes(
        np.append(own.frequency, model.frequency),
        np.append(own.damping_ratio, ratio),
        np.vstack([own.shape, (model.output[:3] @ model.shape).T]),
    )


def refuse_without_limit(path: CellPath) -> None:
    """Raise ParameterError for an end that is not flat and for a tilted tool."""
    if not path.tool.has_flat_end:
        raise ParameterError("tool.type", path.tool.type, "flat: the limits of the depth of cut hold for flat ends")
    if path.tilts:
        raise ParameterError("path.file", path.path.file, "upright: the limits do not hold for a tilted tool")


def feature_limits(cell: Cell, arm: bool = True) -> list[FeatureLimit]:
    """The engagement of each feature with the largest depth against its limit, in the order of the path.

    arm: False leaves out the modes of the arm. Raises ParameterError where no limit holds.
    """
    tool = cell.tool
    refuse_without_limit(path_of(cell))
    arcs = arcs_along(path_of(cell), cell.earlier)
    groups = _groups(arcs, FEWEST_TEETH * path_of(cell).feed_rate * 2.0 * np.pi / (tool.spindle_speed * tool.teeth))
    limits: list[FeatureLimit] = []
    models: dict[tuple, ModalModel] = {}
    for number in dict.fromkeys(arcs.feature.tolist()):
        places = [rows for key, rows in groups.items() if key[0] == number]
        if places:
            limits.append(_feature_limit(cell, arm, arcs, places, models))
    return limits


def _groups(arcs: Arcs, shortest: float) -> dict[tuple, np.ndarray]:
    """Places (m,) of each distinct engagement that lasts for ``shortest`` [m]; the deepest and widest place first.

    Where no engagement of a feature lasts so long, all count.
    """
    direction = math.radians(30.0)  # unit to which feed directions are rounded
    angle = math.radians(10.0)  # unit to which angles of engagement are rounded
    entry = np.where(arcs.entry < -FULL, -9, np.round(arcs.entry / angle)).astype(int)
    leave = np.where(arcs.exit > FULL, 9, np.round(arcs.exit / angle)).astype(int)
    entry, leave = np.minimum(entry, 8), np.maximum(leave, np.minimum(entry, 8) + 1)
    turn = np.round(arcs.heading / direction).astype(int) % round(2.0 * np.pi / direction)
    feed = 1e-4  # [m/s], to which feeds are rounded
    keys = np.column_stack([arcs.feature, entry, leave, turn, np.round(arcs.feed / feed).astype(int)])
    groups: dict[tuple, list[int]] = {}
    for row, key in enumerate(map(tuple, keys.tolist())):
        groups.setdefault(key, []).append(row)
    long = {key: rows for key, rows in groups.items() if len(rows) * arcs.spacing >= shortest}
    some = {key[0] for key in long}
    long |= {key: rows for key, rows in groups.items() if key[0] not in some}
    width = arcs.exit - arcs.entry
    return {key: np.array(rows)[np.lexsort((-width[rows], -arcs.depth[rows]))] for key, rows in long.items()}


def _feature_limit(
    cell: Cell, arm: bool, arcs: Arcs, places: Sequence[np.ndarray], models: dict[tuple, ModalModel]
) -> FeatureLimit:
    """The worst of the engagements of one feature.

    Another engagement is worse where its limit is below its own depth times the least ratio of limit to depth so far.
    """
    width = arcs.exit - arcs.entry
    deepest_first = sorted((int(rows[0]) for rows in places), key=lambda k: (-arcs.depth[k], -width[k]))
    worst, limit, ratio = deepest_first[0], (math.inf, math.nan), math.inf
    for place in deepest_first:
        depth = float(arcs.depth[place])
        candidate = _limit_at(cell, arm, arcs, place, models, min(depth * ratio, max(depth, DEEPEST)))
        if candidate[0] < math.inf:
            worst, limit, ratio = place, candidate, candidate[0] / depth
    entry, leave = _angles(arcs, worst)
    lobe = Lobe(cell.tool.spindle_speed, *limit)
    name = arcs.features[int(arcs.feature[worst])]
    return FeatureLimit(name, lobe, float(arcs.time[worst]), float(arcs.depth[worst]), entry, leave)


def _angles(arcs: Arcs, place: int) -> tuple[float, float]:
    """Entry and exit [rad] of a place; an arc that nearly reaches the side of the tool reaches it."""
    entry, leave = float(arcs.entry[place]), float(arcs.exit[place])
    return (-0.5 * math.pi if entry < -FULL else entry), (0.5 * math.pi if leave > FULL else leave)


def _limit_at(
    cell: Cell,
    arm: bool,
    arcs: Arcs,
    place: int,
    models: dict[tuple, ModalModel] | None = None,
    deepest: float = DEEPEST,
) -> tuple[float, float]:
    """``stability_limit`` of arm, tool and cut at one place.

    models: of the arm, by place in steps of ``POSTURES``; the first place of a step is modelled.
    """
    models = {} if models is None else models
    model = None
    if arm:
        turn = path_of(cell).target.sample_orientation(np.array([round(1e9 * float(arcs.time[place]))]))
        key = tuple(np.rint(arcs.position[place] / POSTURES).tolist() + np.round(turn[0], 3).tolist())
        if key not in models:
            models[key] = arm_of(cell).modes_at(arm_of(cell).joints_at(arcs.position[place][None], turn))[0]
        model = models[key]
    modes = modes_of(cell, arm, model)
    along = rotation_from_abc(np.array([arcs.heading[place], 0.0, 0.0]))
    turned = Modes(modes.frequency, modes.damping_ratio, modes.shape @ along)  # rows: Rz(-heading) phi
    tool = cell.tool
    feed_per_tooth = 2.0 * math.pi * float(arcs.feed[place]) / (tool.spindle_speed * tool.teeth)
    angles = _angles(arcs, place)
    return stability_limit(turned, tool, cell.cutting, feed_per_tooth, *angles, tool.spindle_speed, deepest)
