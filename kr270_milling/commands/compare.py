"""``kr270_milling compare``: a measured pass beside the simulated one, and what is to be identified anew."""

from __future__ import annotations

from pathlib import Path

from kr270_milling.commands.console import add_common, numbers
from kr270_milling.commands.identified import Outcome, Table, report
from kr270_milling.commands.progress import progress


def add_arguments(parser) -> None:
    parser.add_argument("recording", metavar="RECORDING", help="of a force sensor, a tracker, or both")
    parser.add_argument("cell", metavar="CELL.yaml", help="cell file, also a shipped one by its name")
    parser.add_argument(
        "--set", metavar="key=value", action="append", default=[], help="override a key, for example tool.teeth=2"
    )
    parser.add_argument("--reference", metavar="FILE.csv", help="the pass ran along this, as written by compensate")
    parser.add_argument("--force-topic", default="wrench", help="WrenchStamped (default: wrench)")
    parser.add_argument("--pose-topic", default="tool_pose", help="PoseStamped in workpiece axes (default: tool_pose)")
    abc = numbers(3, most=720.0)
    parser.add_argument("--sensor-abc", type=abc, metavar="A,B,C", help="force sensor in the workpiece [deg]")
    parser.add_argument("--sensor-on", choices=("tool", "part"), default="tool", help="a plate under the part: part")
    parser.add_argument("--out", metavar="DIR", help="write a report")
    add_common(parser)


def run(args) -> None:
    from kr270_milling.base.record import find_file
    from kr270_milling.cell.cell import read_cell

    cell = read_cell(find_file(args.cell), args.set)
    found = _compared(args, cell)
    result = _as_dict(found)
    lags = [f"the clock of the {name} is {1e3 * lag:.2f} ms behind that of the simulation"
            for name, lag in result["lag_s"].items()]  # fmt: skip
    title = f"Measured against simulated: {Path(args.recording).name} and {Path(args.cell).name}"
    table = Table("Measured against simulated", *_rows(result))
    report(args, Outcome("compare", title, result, [table], [*lags, *result["advice"]]), lambda: _figures(found))


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
    import numpy as np

    from kr270_milling.bag.reader import Recording
    from kr270_milling.base.frames import rotation_from_abc
    from kr270_milling.identification.comparison import Pass, Series
    from kr270_milling.identification.sensor import Sensor, force_series, pose_series

    with Recording(args.recording) as recording:
        last = [topic.rpartition("/")[2] for topic in recording.topics()] + list(recording.topics())
    turn = np.eye(3) if args.sensor_abc is None else rotation_from_abc(np.radians(args.sensor_abc))
    sensor = Sensor(args.force_topic, turn, args.sensor_on == "part")
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


def _rows(result: dict) -> tuple[list[str], list[list[str]]]:
    rows = []
    for channel in result["channels"]:
        unit = "um" if "offset_um" in channel else "n"
        numbers_ = [channel["gain"], channel["gain_ci95"], channel[f"offset_{unit}"], channel[f"residual_rms_{unit}"]]
        shown = [f"{v:.3f}" for v in numbers_[:2]] + [f"{v:.2f} {unit.replace('n', 'N')}" for v in numbers_[2:]]
        rows.append([channel["name"], *shown])
    return ["quantity", "measured / simulated", "95 % +-", "offset", "difference RMS"], rows


def _figures(found) -> list:
    from kr270_milling.identification.figures import points

    figures = []
    for channel in found.channels:
        thin = slice(None, None, max(1, len(channel.time) // 5000))
        series = {"measured": (channel.time[thin], channel.measured[thin]),
                  "simulated": (channel.time[thin], channel.simulated[thin])}  # fmt: skip
        figures.append(points(channel.name, "time [s]", f"[{channel.unit}]", series, tuple(series)))
    return figures
