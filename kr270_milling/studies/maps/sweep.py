"""Full passes of a cell with other values of its keys: a grid of them, or a Latin hypercube."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import MillingError, ParameterError, nearest
from kr270_milling.cell.cell_file import read_cell
from kr270_milling.cell.jobs import ScoredPass, mean_force, simulate
from kr270_milling.cell.keys import keys_of
from kr270_milling.physics.motion.periods import Exchange
from kr270_milling.studies.maps.engine import StudyRows

MOST_ROWS = 10_000_000
SPEED, PERIOD = "tool.spindle_speed_rpm", "exchange.period_ms"
SCORES = (
    "static_deviation_um", "max_deviation_um", "mean_fx_n", "mean_fy_n", "mean_fz_n", "max_torque_n_m",
    "max_power_w", "removed_volume_mm3", "duration_s",
)  # fmt: skip


@dataclass(frozen=True)
class Axis:
    """A key and the values that it takes."""

    key: str
    values: tuple[float | str, ...]


def parse_axis(text: str) -> Axis:
    """``key=LOW:HIGH:STEP``, ``key=LOW:HIGH/COUNT`` or ``key=A,B,C``; raises ParameterError."""
    key, equals, listed = text.partition("=")
    wrong = ParameterError("--vary", text, "key=LOW:HIGH:STEP, key=LOW:HIGH/COUNT or key=A,B,C")
    if not equals or not key:
        raise wrong
    if ":" not in listed:
        values = tuple(listed.split(","))
        if not all(values):
            raise wrong
        return Axis(key, tuple(map(_value, values)))
    ends, slash, last = listed.rpartition("/")
    try:
        low, high, number = map(float, (*ends.split(":"), last) if slash else listed.split(":"))
    except ValueError:
        raise wrong from None
    if not (math.isfinite(low) and math.isfinite(high) and low <= high and 0.0 < number < math.inf):
        raise wrong
    if slash and number % 1.0:
        raise wrong
    count = int(number) if slash else math.floor((high - low) / number + 1e-9) + 1
    if count > MOST_ROWS:
        raise ParameterError("--vary", text, f"at most {MOST_ROWS} values")
    step = (high - low) / max(1, count - 1) if slash else number
    return Axis(key, tuple(low + step * i for i in range(count)))


def _value(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _text(value: float | str) -> str:
    """Return the value as text of a parameter file; a whole number is also a float."""
    if isinstance(value, str):
        return value
    return str(int(value)) if value.is_integer() else repr(value)


@dataclass(frozen=True)
class Sweep(StudyRows):
    """Keys, scores, and the sentence of what failed, for each combination of values."""

    cell: str  #: file
    settings: tuple[str, ...]  #: ``key=value`` for all rows
    axes: tuple[Axis, ...]
    samples: int | None = None  #: number of a Latin hypercube; None: the grid, the last axis fastest
    seed: int = 1
    chunk: int = 0  #: rows a file; 0: as many as make 64 to 20,000 files, 1 to 8 where that allows

    def __post_init__(self):
        if self.chunk == 0:
            object.__setattr__(self, "chunk", max(1, min(8, len(self) // 64), len(self) // 20_000))
        known = [row["key"] for row in keys_of()]
        keys = [axis.key for axis in self.axes]
        for key in keys:
            if key not in known:  # else every row would have this error
                raise ParameterError("--vary", key, f"a key of a cell{nearest(key, known)}")
        if self.samples is not None and not 1 <= self.samples <= MOST_ROWS:
            raise ParameterError("--samples", self.samples, f"from 1 to {MOST_ROWS}")
        if len(self) > MOST_ROWS:
            raise ParameterError("--vary", keys, f"at most {MOST_ROWS} combinations")
        if self.samples is not None and any(isinstance(v, str) for axis in self.axes for v in axis.values):
            raise ParameterError("--vary", keys, "numbers where --latin draws between them")

    def __len__(self) -> int:
        return self.samples or math.prod(len(axis.values) for axis in self.axes)

    def values(self, index: int) -> tuple:
        """The values of one row."""
        if self.samples is not None:
            return tuple(_hypercube(self)[index].tolist())
        places = np.unravel_index(index, [len(axis.values) for axis in self.axes])
        return tuple(axis.values[int(i)] for axis, i in zip(self.axes, places, strict=True))

    def columns(self, first: int, last: int) -> dict[str, list]:
        rows = [self.row(index) for index in range(first, last)]
        columns = {name: [row[name] for row in rows] for name in rows[0]}
        mixed = [axis.key for axis in self.axes if any(isinstance(value, str) for value in axis.values)]
        return columns | {key: list(map(str, columns[key])) for key in mixed}

    def row(self, index: int) -> dict:
        """A pass of the sweep."""
        chosen = dict(zip([axis.key for axis in self.axes], self.values(index), strict=True))
        chosen |= self._period(chosen)
        scores, error = dict.fromkeys(SCORES, math.nan), ""
        try:
            texts = (f"{key}={_text(value)}" for key, value in chosen.items())
            cell = read_cell(Path(self.cell), (*self.settings, *texts))
            scores = _scores(simulate(cell), cell.tool.spindle_speed)
        except MillingError as refusal:
            error = str(refusal)
        return {"index": index, **chosen, **scores, "error": error}

    def _period(self, chosen: dict) -> dict[str, float]:
        """The exchange period [ms] of a row whose spindle speed is varied and whose period is not.

        It is the whole number of micro-steps that comes nearest to the period of the cell: most speeds do not fit that
        one.
        """
        if SPEED not in chosen or PERIOD in chosen:
            return {}
        exchange, speed = _exchange(self), chosen[SPEED]
        if not isinstance(speed, float) or not speed > 0.0:
            return {PERIOD: 1e3 * exchange.period}  # the row says what is wrong with the speed
        unit = math.degrees(exchange.micro_step) / (6.0 * speed)  # [s]; 1 rpm is 6 deg/s
        return {PERIOD: 1e3 * unit * max(1, round(exchange.period / unit))}


class SweepSummary:
    """The rows of a sweep with the least and the largest deviation, and rows for a picture; chunk by chunk."""

    def __init__(self, sweep: Sweep, count: int = 5):
        self.keys = [axis.key for axis in sweep.axes]
        self.count, self.failed = count, 0
        self.best: list[dict] = []
        self.worst: list[dict] = []
        self.shown: list[dict] = []
        most_shown = 5000  # rows of a picture
        self._every = -(-len(sweep) // most_shown)

    def add(self, table) -> None:
        """Add the rows of an Arrow table."""
        complete = [row for row in table.to_pylist() if not row["error"]]
        self.failed += len(table) - len(complete)
        order = "max_deviation_um"
        self.best = sorted([*self.best, *complete], key=lambda row: row[order])[: self.count]
        others = [row for row in [*self.worst, *complete] if row not in self.best]
        self.worst = sorted(others, key=lambda row: -row[order])[: self.count]
        self.shown += [row for row in complete if row["index"] % self._every == 0]


@functools.lru_cache(maxsize=1)
def _hypercube(sweep: Sweep) -> np.ndarray:
    """Between the first and the last value of each axis, (samples, axes)."""
    from scipy.stats import qmc

    low, high = np.array([(float(axis.values[0]), float(axis.values[-1])) for axis in sweep.axes]).T
    unit = qmc.LatinHypercube(len(sweep.axes), seed=np.random.default_rng(sweep.seed)).random(sweep.samples)
    return low + unit * (high - low)


@functools.lru_cache(maxsize=1)
def _exchange(sweep: Sweep) -> Exchange:
    return read_cell(Path(sweep.cell), sweep.settings).exchange


def _scores(scored: ScoredPass, spindle_speed: float) -> dict[str, float]:
    torque = float(scored.result.torque.max())
    deviations = 1e6 * scored.scores.static_deviation, 1e6 * scored.scores.max_deviation
    removed = 1e9 * scored.result.removed_volume
    power = torque * spindle_speed
    values = *deviations, *mean_force(scored.result).tolist(), torque, power, removed, float(scored.result.time[-1])
    return dict(zip(SCORES, values, strict=True))
