"""How near studies come to as many plain loops as there are cores: ``python -m bench.studies sweep|tasks|rows [N]``.

``sweep``: a sweep of 451 passes beside the same chunks in a plain loop, in one process and in as many at once as there
are cores, in turns. ``tasks``: chunks that sleep instead of computing, through the same engine: what a task takes of
the one process that holds driver and scheduler, and how busy so many workers are. ``rows``: a map of N million rows
and the memory of its processes while they come.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

from kr270_milling.base.record import find_file
from kr270_milling.studies.maps import engine
from kr270_milling.studies.maps.sweep import Sweep, parse_axis

VARY = "dynamics.damping_ratio=0.02:0.22:0.02", "path.depth_of_cut_mm=0.1:2.1:0.05"  # 11 x 41 passes
SHARE = 5  # of the chunks in a plain loop: one in so many
WORKERS = 2, 4, 8, 16, 32
SLEEPS = 0.0, 0.1, 0.5, 2.0  # [s]
SIZE = 4096  # bytes of a chunk's answer, as a file of a sweep has


def study() -> Sweep:
    return Sweep(str(find_file("paper.yaml").resolve()), (), tuple(map(parse_axis, VARY)))


def plain() -> None:
    """Seconds a row of a plain loop, after a first chunk that loads what is compiled."""
    sweep = study()
    sweep(0)
    numbers = range(0, sweep.chunks - 1, SHARE)
    begun = time.monotonic()
    for number in numbers:
        sweep(number)
    print((time.monotonic() - begun) / (len(numbers) * sweep.chunk))


def plain_loops(count: int) -> float:
    """Median seconds a row of ``count`` plain loops at once."""
    line = [sys.executable, "-m", "bench.studies", "plain"]
    loops = [subprocess.Popen(line, stdout=subprocess.PIPE, text=True) for _ in range(count)]
    return statistics.median(float(loop.communicate()[0]) for loop in loops)


def swept() -> tuple[float, float, float]:
    """Rows a second of the whole command, of the study, and between its first and its last file from the workers."""
    with tempfile.TemporaryDirectory() as place:
        words = [part for text in VARY for part in ("--vary", text)]
        line = [sys.executable, "-m", "kr270_milling.cli", "sweep", "paper.yaml", *words, "--json", "--out", place]
        begun = time.monotonic()
        done = subprocess.run(line, check=True, capture_output=True, text=True)
        whole = time.monotonic() - begun
        found = json.loads(done.stdout)
        times = sorted(path.stat().st_mtime for path in Path(place).glob("rows-*"))
    first, last = len(times) // 4, len(times) - 3
    rate = (last - first) * study().chunk / (times[last] - times[first])
    return found["rows"] / whole, found["rows"] / found["wall_s"], rate


def bench_sweep(rounds: int) -> None:
    cores, shares = os.cpu_count() or 1, []
    for _ in range(rounds):
        one, rates = plain_loops(1), swept()
        shares.append([one / plain_loops(cores), *(rate * one / cores for rate in rates)])
        print(f"plain loop {1e3 * one:.1f} ms a pass; shares", *(f"{share:.3f}" for share in shares[-1]), flush=True)
    print(f"share of {cores} x the plain loop, min / median / max:")
    for k, name in enumerate(("plain loops at once", "command", "study", "at work")):
        values = [share[k] for share in shares]
        print(f"{name:20} {min(values):.2f} / {statistics.median(values):.2f} / {max(values):.2f}")


def asleep(seconds: float, number: int) -> bytes:
    time.sleep(seconds)
    return bytes(SIZE)


def bench_tasks(_: int) -> None:
    print("workers | sleep [s] | tasks/s | driver and scheduler [ms of processor a task] | workers busy")
    for workers in WORKERS:
        with mock.patch("os.cpu_count", return_value=workers), engine._client(None) as client:
            client.wait_for_workers(workers)
            address = client.scheduler.address
            for seconds in SLEEPS:
                count = 600 if seconds == 0.0 else max(workers * 3, round(6 * workers / seconds))
                tasks(address, 3 * workers, 0.0)
                wall, own = tasks(address, count, seconds)
                busy = count * seconds / (workers * wall)
                shown = f"{workers:7} | {seconds:9} | {count / wall:7.1f} | {1e3 * own / count:.2f} | {busy:.3f}"
                print(shown, flush=True)


def tasks(address: str, count: int, seconds: float) -> tuple[float, float]:
    """Seconds of the clock, and of the processor in this process."""
    with tempfile.TemporaryDirectory() as place:
        own = time.process_time()
        wall = engine.run_chunks(engine.Study(place, {}), count, functools.partial(asleep, seconds), address)
        return wall, time.process_time() - own


def bench_rows(millions: int) -> None:
    import psutil

    with tempfile.TemporaryDirectory() as place:
        grid = ["--x=1200:1800/50", "--y=-600:600/50", f"--tool-turn=-180:180/{50 * millions}"]  # 8 branches each
        line = [sys.executable, "-m", "kr270_milling.cli", "map", "paper.yaml", *grid, "--json", "--out", place]
        driver, peaks = psutil.Popen(line, stdout=subprocess.PIPE, text=True), [0.0, 0.0]
        print("rows | driver [MB] | largest worker [MB] | peaks until then")
        shown = 1
        while driver.poll() is None:
            now = memory(driver)
            peaks = [max(pair) for pair in zip(peaks, now, strict=True)]
            rows = 4000 * len(list(Path(place).glob("rows-*")))
            if rows >= shown * 1_000_000:
                print(f"{rows:9} | {now[0]:.0f} | {now[1]:.0f} | {peaks[0]:.0f}, {peaks[1]:.0f}", flush=True)
                shown += 1
            time.sleep(0.2)
        found = json.loads(driver.stdout.read())
        peak = f"{peaks[0]:.0f}, {peaks[1]:.0f}"
        print(f"{found['rows']} rows, {found['postures_per_s']:.3g} postures/s, peaks with the summary {peak} MB")


def memory(driver) -> list[float]:
    """Resident, of the driver and of the largest process that it started [MB]."""
    import psutil

    sizes = []
    for process in (driver, *driver.children(recursive=True)):
        with contextlib.suppress(psutil.Error):
            sizes.append(process.memory_info().rss / 1e6)
    return [sizes[0], max(sizes[1:], default=0.0)] if sizes else [0.0, 0.0]


if __name__ == "__main__":
    number = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    {"plain": lambda _: plain(), "sweep": bench_sweep, "tasks": bench_tasks, "rows": bench_rows}[sys.argv[1]](number)
