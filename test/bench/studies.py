"""How near studies come to as many plain loops as there are cores: ``python -m bench.studies sweep|rows [N]``.

``sweep``: a sweep of 451 passes beside the same chunks in a plain loop, in turns. ``rows``: a map of N million rows and
the memory of its processes while they come.
"""

import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from kr270_milling.base.parameter_file import find_file
from kr270_milling.studies.maps.sweep import Sweep, parse_axis

VARY = "dynamics.damping_ratio=0.02:0.22:0.02", "path.depth_of_cut_mm=0.1:2.1:0.05"  # 11 x 41 passes
SHARE = 5  # of the chunks in a plain loop: one in so many


def bench_sweep(rounds: int) -> None:
    sweep = Sweep(str(find_file("paper.yaml").resolve()), (), tuple(map(parse_axis, VARY)))
    cores, shares = os.cpu_count() or 1, []
    words = [part for text in VARY for part in ("--vary", text)]
    line = [sys.executable, "-m", "kr270_milling.cli", "sweep", "paper.yaml", *words, "--json", "--out"]
    sweep(0)  # loads what is compiled
    for _ in range(rounds):
        numbers = range(0, sweep.chunks - 1, SHARE)
        start = time.monotonic()
        for number in numbers:
            sweep(number)
        one = (time.monotonic() - start) / (len(numbers) * sweep.chunk)
        with tempfile.TemporaryDirectory() as place:
            result = json.loads(subprocess.run([*line, place], check=True, capture_output=True, text=True).stdout)
        shares.append(result["rows"] / result["wall_s"] * one / cores)
        print(f"plain loop {1e3 * one:.1f} ms a pass; share of {cores} plain loops {shares[-1]:.3f}", flush=True)
    print(f"min / median / max: {min(shares):.2f} / {statistics.median(shares):.2f} / {max(shares):.2f}")


def bench_rows(millions: int) -> None:
    import psutil

    with tempfile.TemporaryDirectory() as place:
        grid = ["--x=1200:1800/50", "--y=-600:600/50", f"--tool-turn=-180:180/{50 * millions}"]  # 8 branches each
        line = [sys.executable, "-m", "kr270_milling.cli", "map", "paper.yaml", *grid, "--json", "--out", place]
        driver, peaks = psutil.Popen(line, stdout=subprocess.PIPE, text=True), [0.0, 0.0]
        print("rows | driver [MB] | largest worker [MB] | peaks so far")
        shown = 1
        while driver.poll() is None:
            now = memory(driver)
            peaks = [max(pair) for pair in zip(peaks, now, strict=True)]
            rows = 4000 * len(list(Path(place).glob("rows-*")))
            if rows >= shown * 1_000_000:
                print(f"{rows:9} | {now[0]:.0f} | {now[1]:.0f} | {peaks[0]:.0f}, {peaks[1]:.0f}", flush=True)
                shown += 1
            time.sleep(0.2)
        summary = json.loads(driver.stdout.read())
        peak = f"{peaks[0]:.0f}, {peaks[1]:.0f}"
        print(f"{summary['rows']} rows, {summary['postures_per_s']:.3g} postures/s, peaks with the summary {peak} MB")


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
    {"sweep": bench_sweep, "rows": bench_rows}[sys.argv[1]](number)
