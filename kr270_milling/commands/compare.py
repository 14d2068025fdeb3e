"""``kr270_milling compare``: a measured pass beside the simulated one, and what is to be identified anew."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import Answer
from kr270_milling.commands.options import add_cell, cell_of, option
from kr270_milling.commands.progress import progress
from kr270_milling.nodes.option_types import numbers

COLUMNS = ("quantity", "measured / simulated", "95 % +-", "offset", "difference RMS")


def add_arguments(parser) -> None:
    option(parser, "recording RECORDING", "of a force sensor, a tracker, or both")
    add_cell(parser)
    option(parser, "--reference FILE.csv", "the pass ran along this, as written by compensate")
    option(parser, "--force-topic", "WrenchStamped", default="wrench")
    option(parser, "--pose-topic", "PoseStamped in workpiece axes", default="tool_pose")
    option(parser, "--sensor-abc A,B,C", "force sensor in the workpiece [deg]", numbers(3, most=720.0))
    option(parser, "--sensor-on", "a plate under the part: part", default="tool", choices=("tool", "part"))
    option(parser, "--out DIR", "write a report")


def run(args) -> Answer:
    from kr270_milling.commands.identify import identified
    from kr270_milling.identification.outcome import Outcome

    found = _compared(args, cell_of(args))
    result = _as_dict(found)
    lags = [f"the clock of the {name} is {1e3 * lag:.2f} ms behind that of the simulation"
            for name, lag in result["lag_s"].items()]  # fmt: skip
    title = f"Measured against simulated: {Path(args.recording).name} and {Path(args.cell).name}"
    table = ("Measured against simulated", COLUMNS, _rows(result))
    said = [*lags, *result["advice"]]
    return identified(args, Outcome("compare", title, result, [table], said, lambda: _figures(found)))


def _compared(args, cell):
    import numpy as np

    from kr270_milling.cell.jobs import simulate
    from kr270_milling.identification.comparison import Pass, Series, compare
    from kr270_milling.trajectory.trajectory_csv import read_csv

    measured = _measured(args)
    reference = read_csv(Path(args.reference))[0] if args.reference else None
    with progress("milling") as report:
        ran = simulate(cell, reference, progress=report).result
    simulated = Pass(Series(ran.time, ran.wrench[:, :3]), Series(ran.time, ran.actual))
    feed = cell.target().sample_velocity(ran.time_ns)
    return compare(measured, simulated, ran.target, feed, 2 * np.pi / cell.tool.spindle_speed)


def _measured(args):
    """What the recording has of both topics."""
    from kr270_milling.bag.reader import Recording
    from kr270_milling.identification.comparison import Pass, Series
    from kr270_milling.identification.cuts import Sensor, force_series, turn_of
    from kr270_milling.identification.signals import pose_series

    with Recording(args.recording) as recording:
        last = [topic.rpartition("/")[2] for topic in recording.topics()] + list(recording.topics())
    sensor = Sensor(args.force_topic, turn_of(args.sensor_abc), args.sensor_on == "part")
    force = Series(*force_series(args.recording, sensor)) if args.force_topic in last else None
    pose = Series(*pose_series(args.recording, args.pose_topic)) if args.pose_topic in last else None
    return Pass(force, pose)


def _as_dict(found) -> dict:
    channels = []
    for channel in found.channels:
        scale, unit = (1e6, "um") if channel.unit == "m" else (1.0, "n")
        difference = channel.measured - channel.simulated
        channels.append({
            "name": channel.name,
            "gain": channel.line.gain,
            "gain_ci95": 1.96 * channel.line.gain_sigma,
            f"offset_{unit}": scale * channel.line.offset,
            f"residual_rms_{unit}": scale * float((difference**2).mean() ** 0.5),
            f"residual_rms_smoothed_{unit}": scale * channel.line.residual,
        })  # fmt: skip
    ringing = {name: {"frequency_hz": f, "damping_ratio": z} for name, (f, z) in found.ringing.items()}
    return {"channels": channels, "lag_s": found.lags, "ringing": ringing, "advice": found.advice}


def _rows(result: dict) -> list[list[str]]:
    rows = []
    for channel in result["channels"]:
        unit = "um" if "offset_um" in channel else "n"
        gains = [f"{channel[key]:.3f}" for key in ("gain", "gain_ci95")]
        rest = [f"{channel[f'{key}_{unit}']:.2f} {unit.replace('n', 'N')}" for key in ("offset", "residual_rms")]
        rows.append([channel["name"], *gains, *rest])
    return rows


def _figures(found) -> list:
    from kr270_milling.identification.outcome import points

    figures = []
    for channel in found.channels:
        thin = slice(None, None, max(1, len(channel.time) // 5000))
        series = {"measured": (channel.time[thin], channel.measured[thin]),
                  "simulated": (channel.time[thin], channel.simulated[thin])}  # fmt: skip
        figures.append(points(channel.name, "time [s]", f"[{channel.unit}]", series, tuple(series)))
    return figures
