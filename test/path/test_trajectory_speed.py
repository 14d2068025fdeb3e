"""The reader keeps pace with long programs: 200,000 blocks within 5 s."""

from __future__ import annotations

import math
import re
import time

from kr270_milling.path.cam.gcode.reader import read_gcode

BLOCKS = 6_000
WORD = re.compile(r"([A-Z])([-+]?[0-9]*\.?[0-9]+)")
#: a reader that takes 25 us a block, on a machine that finds the words of one in 3.5 us
MOST = 7.0


def program() -> list[str]:
    lines = ["G21 G90 G17 G54", "T1 M6", "S8000 M3", "G0 X40 Y0 Z5", "G1 Z0 F800"]
    for k in range(BLOCKS):
        x, y = 40 * math.cos(1e-3 * k), 40 * math.sin(1e-3 * k)
        lines.append(f"N{k} G2 X{x:.3f} Y{y:.3f} R41" if k % 10 == 9 else f"N{k} G1 X{x:.3f} Y{y:.3f} Z{-1e-4 * k:.4f}")
    return [*lines, "M30", ""]


def spent(job) -> float:
    """[s] of this process, whatever else the machine does."""
    began = time.process_time()
    job()
    return time.process_time() - began


def test_a_block_takes_a_few_times_what_finding_its_words_takes(tmp_path):
    lines = program()
    (tmp_path / "long.nc").write_text("\n".join(lines))
    ratios = []
    for _ in range(3):
        words = spent(lambda: [[(a, float(b)) for a, b in WORD.findall(line)] for line in lines])
        ratios.append(spent(lambda: read_gcode(tmp_path / "long.nc")) / words)
    assert min(ratios) < MOST, ratios
