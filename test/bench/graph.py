"""How fast the graph is, beside its yardsticks: the wall clock, and mcap's own writer."""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from bench.writer import bench_writer
from kr270_milling.base.parameter_file import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.exchange.replay.recorded import pass_from_recording
from kr270_milling.live.graph.graph import Graph
from kr270_milling.live.ros.environment import child_environment, require_ros
from kr270_milling.recordings.bag.reader import Recording

__all__ = ["bench_ros"]

SMALL_RATE, SMALL_SECONDS = 20_000, 10.0  # messages a second; seconds
LARGE, LARGE_COUNT = 1_000_000, 1000  # bytes; messages


def bench_ros(passes: int = 3) -> dict:
    """Paper's pass with four processes and recorder; graph up; recorder alone with small and with large messages."""
    require_ros()
    with tempfile.TemporaryDirectory() as directory:
        found = _passes(Path(directory, "graph"), passes)
        found |= _recorder_small(Path(directory, "small")) | _recorder_large(Path(directory, "large"))
    writer = bench_writer()
    found["plain_writer_small_per_s"] = writer["plain_small_per_s"]
    found["plain_writer_large_mb_per_s"] = writer["plain_large_mb_per_s"]
    found["recorder_large_share_of_plain"] = found["recorder_large_mb_per_s"] / writer["plain_large_mb_per_s"]
    return found


def _paper():
    return read_cell(find_file("paper.yaml"))


def _passes(out: Path, count: int) -> dict:
    out.mkdir()
    walls, lost = [], 0
    with Graph(_paper(), out) as graph:
        for number in range(count):
            ran = graph.run_pass(f"pass_{number + 1}")
            found = pass_from_recording(ran.recording)
            walls.append(ran.wall_s)
            lost += found.messages_lost
        up = graph.up_s
    duration = float(found.scored.result.time[-1])
    return {
        "graph_up_s": up,
        "pass_s": duration,
        "pass_wall_s": walls,
        "real_time_factor": duration / min(walls),
        "messages_lost": lost,
    }


def _recorder_small(out: Path) -> dict:
    """Poses at a given rate from another process into a recorder that has nothing else to do."""
    sent, seconds, _, received = _record(out, SMALL_RATE, round(SMALL_RATE * SMALL_SECONDS), 0)
    return {
        "recorder_small_per_s": sent / seconds,
        "recorder_small_sent": sent,
        "recorder_small_lost": sent - received,
    }


def _recorder_large(out: Path) -> dict:
    """Maps of 1 MB, as fast as they are taken."""
    sent, _, seconds, received = _record(out, 0, LARGE_COUNT, LARGE)
    return {
        "recorder_large_mb_per_s": received * LARGE * 1e-6 / seconds,
        "recorder_large_sent": sent,
        "recorder_large_lost": sent - received,
    }


def _record(out: Path, rate: int, count: int, size: int) -> tuple[int, float, float, int]:
    """Messages sent, seconds that took, seconds until they were written, messages in the recording."""
    environment = child_environment()
    node = [sys.executable, "-m", "kr270_milling.live.nodes", "recorder", "--ros-args", "-p", f"directory:={out}"]
    source = [sys.executable, str(Path(__file__).with_name("source.py")), str(rate), str(count), str(size)]
    quiet = {"env": environment, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([*node, "-p", "topics:=bench"], **quiet) as recorder:
        try:
            told = subprocess.run(source, stdout=subprocess.PIPE, text=True, timeout=120, check=True, **quiet).stdout
        finally:
            recorder.send_signal(signal.SIGINT)
    sent, seconds, written = told.split()
    with Recording(out) as recording:
        return int(sent), float(seconds), float(written), recording.topics()["/bench"].count
