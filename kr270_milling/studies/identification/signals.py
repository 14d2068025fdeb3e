"""Channels over time: topics of recordings; vibrations out of CSV tables, recordings and UFF files, evenly sampled."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.base.extras import require_extra
from kr270_milling.base.table import read_table
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.series import FIXED, series

__all__ = ["AXES", "Signals", "pose_series", "read_signals", "read_topic", "resampled"]

AXES = ("x", "y", "z", "rx", "ry", "rz")
FORCE = "force_n"
COLUMNS = ("time_s", *AXES, FORCE)
UFF = (".uff", ".unv", ".58")
FEWEST = 16
MOST_BYTES = 256 * 1024 * 1024  #: of a UFF file, which is read as a whole


@dataclass(frozen=True, eq=False)
class Signals:
    """Displacements (or speeds, or accelerations: modes are the same) at one point, evenly sampled."""

    step: float  #: [s]
    values: np.ndarray  #: (n, channels)
    names: tuple[str, ...]  #: of the channels, of AXES where they are known
    force: np.ndarray | None = None  #: of the hammer [N], (n,)

    def along_axes(self, shape: np.ndarray) -> np.ndarray:
        """A shape of the channels along x, y, z, rx, ry, rz, (6,); 0 where nothing was measured."""
        six = np.zeros(6)
        for name, value in zip(self.names, shape, strict=True):
            if name in AXES:
                six[AXES.index(name)] = value
        return six

    def window(self, start: float | None, stop: float | None) -> Signals:
        """The seconds between two, after the first sample."""
        first = 0 if start is None else max(0, round(start / self.step))
        last = len(self.values) if stop is None else min(len(self.values), round(stop / self.step))
        if last - first < FEWEST:
            raise InputError("window", f"holds {max(0, last - first)} samples, but modes need at least {FEWEST}")
        force = None if self.force is None else self.force[first:last]
        return Signals(self.step, self.values[first:last], self.names, force)


def read_signals(path, topic: str = "deflection") -> Signals:
    """A CSV table with time_s, any of x to rz and force_n; a recording; or a UFF file. Raises InputError.

    Gaps are bridged by straight lines.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".csv":
        table = read_table(path, COLUMNS, ("time_s",))
        names = tuple(name for name in (*AXES, FORCE) if name in table)
        if not set(names) & set(AXES):
            raise InputError(path, f"has none of the columns {', '.join(AXES)}", 1)
        time, values = table.number("time_s"), table.numbers(names)
    elif suffix in UFF:
        time, names, values = _read_uff(path)
    else:
        time, values = read_topic(path, topic, FIXED)
        names = AXES[: 6 if values.shape[1] == 6 else 3]
    order = np.argsort(time, kind="stable")
    steps = np.diff(time[order])
    if len(time) < FEWEST or not steps.any():
        raise InputError(path, f"holds {len(time)} samples, but modes need at least {FEWEST}")
    step = float(np.median(steps[steps > 0.0]))
    if steps.max() > 10 * step:
        raise InputError(path, f"has a gap of {steps.max():.3g} s where samples come every {step:.3g} s")
    values = resampled(time[order], values[order, : len(names)], step)
    if names[-1] == FORCE:
        return Signals(step, values[:, :-1], names[:-1], values[:, -1])
    return Signals(step, values, names)


def resampled(time: np.ndarray, values: np.ndarray, step: float) -> np.ndarray:
    """On an even grid from the first to the last time, (m, columns), by straight lines."""
    grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step + 1e-6) + 1)
    return np.stack([np.interp(grid, time, column) for column in values.T], -1)


def _read_uff(path) -> tuple[np.ndarray, tuple[str, ...], np.ndarray]:
    """Seconds, names and values of the time histories (function type 1) of data set 58."""
    require_extra(f"{path}", "uff", "pyuff")
    import pyuff

    try:
        if not Path(path).is_file() or Path(path).stat().st_size > MOST_BYTES:
            raise InputError(path, f"is no UFF file of at most {MOST_BYTES} bytes")
        sets = [s for s in np.atleast_1d(pyuff.UFF(str(path)).read_sets()) if s.get("type") == 58]
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise InputError(path, f"is no UFF file that pyuff reads ({error})") from None
    histories = [s for s in sets if s.get("func_type") == 1]
    if not histories:
        raise InputError(path, "holds no time history (data set 58, function type 1)")
    length = min(len(s["data"]) for s in histories)
    directions = [int(s["rsp_dir"]) for s in histories]
    names = tuple(AXES[abs(d) - 1] if 1 <= abs(d) <= 6 else f"channel {i}" for i, d in enumerate(directions))
    data = [np.real(s["data"][:length]) for s in histories]
    values = np.stack(data, -1) * np.where(np.array(directions) < 0, -1.0, 1.0)
    return np.asarray(histories[0]["x"], float)[:length], names, values


def read_topic(path, name: str, kinds) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of the stamps (n,), ascending, and the numbers (n, columns) of a topic of one of these types.

    name: full, or the last parts where only one topic ends so. Raises RecordingError.
    """
    with Recording(path) as recording:
        topics = recording.topics()
        matches = [name] if name in topics else [t for t in topics if t.endswith("/" + name)]
        if len(matches) != 1:
            what = f"has several topics {name} ({', '.join(matches)})" if matches else f"has no topic {name}"
            raise RecordingError(recording.path, f"{what}; it holds {', '.join(sorted(topics)) or 'nothing'}")
        if topics[matches[0]].type not in kinds:
            what = f"{matches[0]} is of type {topics[matches[0]].type}, not {' or '.join(sorted(kinds))}"
            raise RecordingError(recording.path, what)
        read = series(recording, matches[0])
    if len(read.stamp) < 2:
        raise RecordingError(path, f"{matches[0]} has no two messages")
    stamp, first = np.unique(read.stamp, return_index=True)
    return stamp * 1e-9, read.values[first]


def pose_series(path, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of the stamps, (n,), and places [m], (n, 3)."""
    time, values = read_topic(path, topic, ("geometry_msgs/msg/PoseStamped",))
    return time, values[:, :3]
