"""Channels over time: topics of recordings; vibrations out of CSV tables, recordings and UFF files, evenly sampled."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import InputError, RecordingError
from kr270_milling.base.extensions import require_extra
from kr270_milling.base.table import read_table
from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.messages.cdr import FIXED
from kr270_milling.recordings.passes import own_topics, series

AXES = ("x", "y", "z", "rx", "ry", "rz")
FORCE = "force_n"
COLUMNS = ("time_s", *AXES, FORCE)
UFF = (".uff", ".unv", ".58")
FEWEST = 16
MOST_BYTES = 256 * 1024 * 1024  #: size of a UFF file, which is read as a whole


@dataclass(frozen=True, eq=False)
class Signals:
    """Displacements (or speeds, or accelerations: modes are the same) at one point, evenly sampled."""

    step: float  #: [s]
    values: np.ndarray  #: (n, channels)
    names: tuple[str, ...]  #: axes of the channels, from AXES where they are known
    force: np.ndarray | None = None  #: force of the hammer [N], (n,)
    quantity: str = ""  #: displacement, velocity or acceleration; empty: the file does not state the quantity
    drive: str = ""  #: from AXES, where the file states the direction of the force, or the other point that was hit
    notes: tuple[str, ...] = ()  #: sentences about stamps and channels

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
        return dataclasses.replace(self, values=self.values[first:last], force=force)


def read_signals(path, topic: str = "deflection") -> Signals:
    """A CSV table with time_s, any of x to rz and force_n; a recording; or a UFF file. Raises InputError.

    Gaps are bridged by straight lines.
    """
    suffix, lines = Path(path).suffix.lower(), None
    stated: dict = {}
    if suffix == ".csv":
        table = read_table(path, COLUMNS, ("time_s",))
        names = tuple(name for name in (*AXES, FORCE) if name in table)
        time, values, lines = table.number("time_s"), table.numbers(names or ("time_s",)), table.lines
    elif suffix in UFF:
        time, names, values, stated = _read_uff(path)
    else:
        time, values = read_topic(path, topic, FIXED)
        names = AXES[: 6 if values.shape[1] == 6 else 3]
    if not any(name != FORCE for name in names):
        raise InputError(path, f"has none of the columns {', '.join(AXES)}", 1)
    time, step, note = even_stamps(path, time, lines)
    values = resampled(time, values, step)
    notes = (*stated.pop("notes", ()), *([note] if note else []))
    force = values[:, -1] if names[-1] == FORCE else None
    channels = len(names) - (force is not None)
    return Signals(step, values[:, :channels], names[:channels], force, notes=notes, **stated)


def even_stamps(path, time: np.ndarray, lines) -> tuple[np.ndarray, float, str]:
    """Times [s], (n,), their step [s], and a sentence about stamps that are not even. Raises InputError.

    Stamps that differ from even ones by their last digit are rounded; the samples then are even. lines: of the file.
    """
    steps = np.diff(time)
    if len(time) < FEWEST or not steps.any():
        raise InputError(path, f"holds {len(time)} samples, but modes need at least {FEWEST}")
    late = int(np.argmin(steps)) + 1
    line = None if lines is None else lines[late]
    if steps.min() < 0.0:
        raise InputError(path, f"the time goes back from {time[late - 1]:.9g} to {time[late]:.9g} s", line)
    if steps.min() == 0.0:
        share = f"{int((steps == 0.0).sum())} of {len(time)} samples have the stamp of the sample before them"
        raise InputError(path, f"{share}, as {time[late]:.9g} s: write the stamps with all their digits", line)
    step = float(np.median(steps))
    longest_gap = 10.0  # steps that are bridged by a straight line: assumed
    if steps.max() > longest_gap * step:
        raise InputError(path, f"has a gap of {steps.max():.3g} s where samples come every {step:.3g} s")
    uneven = float(np.abs(steps - step).max())
    even = np.linspace(time[0], time[-1], len(time))
    digit = next((d for d in 10.0 ** -np.arange(10) if np.abs(time - d * np.rint(time / d)).max() < 1e-3 * d), 0.0)
    # share of a step by which stamps may be uneven without a word: assumed, 3 degrees at 10 samples a period
    noticed = 0.1
    if np.abs(time - even).max() <= 1.01 * digit:
        note = f"the stamps are rounded to {digit:g} s: the samples are taken as even, every {even[1] - even[0]:.6g} s"
        return even, float(even[1] - even[0]), note if uneven > noticed * step else ""
    note = f"the stamps are uneven, {steps.min():.3g} to {steps.max():.3g} s: straight lines give even samples"
    return time, step, note if uneven > noticed * step else ""


def resampled(time: np.ndarray, values: np.ndarray, step: float) -> np.ndarray:
    """On an even grid from the first to the last time, (m, columns), by straight lines."""
    grid = time[0] + step * np.arange(int((time[-1] - time[0]) / step + 1e-6) + 1)
    return np.stack([np.interp(grid, time, column) for column in values.T], -1)


def _read_uff(path) -> tuple[np.ndarray, tuple[str, ...], np.ndarray, dict]:
    """Seconds, names, values and the stated fields of ``Signals`` of the time histories (function type 1) of set 58."""
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
    force_types = (9, 13)  # specific data types: reaction force, excitation force
    forces = [s for s in histories if s.get("ordinate_spec_data_type") in force_types]
    moves = [s for s in histories if s.get("ordinate_spec_data_type") not in force_types]
    histories = [*moves, *forces]  # the force is the last column
    turns = [abs(int(s["rsp_dir"])) for s in histories]
    axes = [AXES[axis - 1] if 1 <= axis <= 6 else f"channel {i}" for i, axis in enumerate(turns)]
    names = (*axes[: len(moves)], *[FORCE] * len(forces))
    nodes = list(dict.fromkeys(int(s["rsp_node"]) for s in moves))
    times = [np.asarray(s["x"], float) for s in histories]
    rates = list(dict.fromkeys(f"{1 / (x[1] - x[0]):.6g} from {x[0]:g} s" for x in times if len(x) > 1))
    quantities = {8: "displacement", 11: "velocity", 12: "acceleration"}  # specific data type of a UFF file -> quantity
    kinds = list(dict.fromkeys(quantities.get(s.get("ordinate_spec_data_type"), "") for s in moves))
    for kind, several in (("nodes", nodes), ("sampling rates, a second:", rates), ("quantities", kinds)):
        if len(several) > 1:
            listed = ", ".join(str(value) or "unknown" for value in several)
            raise InputError(path, f"holds {kind} {listed}: modes need one file for each")
    if repeated := {name for name in names if names.count(name) > 1}:
        raise InputError(path, f"holds several histories of {', '.join(sorted(repeated))}")
    drive = axes[-1] if forces else ""
    if forces and moves and int(forces[0]["rsp_node"]) != nodes[0]:
        drive = f"node {int(forces[0]['rsp_node'])}, not node {nodes[0]}"
    labels = [str(s.get("ordinate_axis_units_lab") or "").strip() for s in histories]
    si_labels = ("", "NONE", "M", "M/S", "M/S2", "M/S^2", "M/S**2", "N", "RAD")  # labels of units of a UFF file
    foreign = (
        f"{name} in {label}" for name, label in zip(names, labels, strict=True) if label.upper() not in si_labels
    )
    notes = tuple(f"the file states {text}: its numbers are taken as SI units" for text in foreign)
    length = min(len(s["data"]) for s in histories)
    signs = [-1.0 if int(s["rsp_dir"]) < 0 else 1.0 for s in histories]
    values = np.stack([np.real(s["data"][:length]) for s in histories], -1) * signs
    stated = {"quantity": kinds[0] if kinds else "", "drive": drive, "notes": notes}
    return times[0][:length], names, values, stated


def read_topic(path, name: str, kinds) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of the stamps (n,), ascending, and the numbers (n, columns) of a topic of one of these types.

    name: full, or the last parts where only one topic ends so, or one next to the reference trajectory. Raises
    RecordingError.
    """
    with Recording(path) as recording:
        topics = recording.topics()
        matches = [name] if name in topics else own_topics(recording, name)
        if len(matches) != 1:
            what = f"has several topics {name} ({', '.join(matches)})" if matches else f"has no topic {name}"
            raise RecordingError(recording.path, f"{what}; it holds {', '.join(sorted(topics)) or 'nothing'}")
        if topics[matches[0]].type not in kinds:
            what = f"{matches[0]} is of type {topics[matches[0]].type}, not {' or '.join(sorted(kinds))}"
            raise RecordingError(recording.path, what)
        read = series(recording, matches[0])
    if len(read.stamp) < 2:
        raise RecordingError(path, f"{matches[0]} has no two messages")
    stamp, first, place = np.unique(read.stamp, return_index=True, return_inverse=True)
    others = int((read.values != read.values[first[place]]).any(1).sum())  # a repeated answer has the same values
    conflicts = 0.01  # share of the messages that may repeat a stamp with other values: assumed
    if others > conflicts * len(place):
        reason = f"{others} of {len(place)} messages of {matches[0]} have the stamp of another message"
        raise RecordingError(path, f"{reason}: stamp each sample with its own time")
    return stamp * 1e-9, read.values[first]


def pose_series(path, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Seconds of the stamps, (n,), and places [m], (n, 3)."""
    time, values = read_topic(path, topic, ("geometry_msgs/msg/PoseStamped",))
    return time, values[:, :3]
