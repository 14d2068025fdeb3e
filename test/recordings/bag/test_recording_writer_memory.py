"""The memory of the writer of recordings."""

from __future__ import annotations

import numpy as np
from test_recording_samples import POSE, pose, raw

from kr270_milling.recordings.bag.writer import BagWriter


def test_memory_of_the_writer_stays_flat(tmp_path):
    import tracemalloc

    with BagWriter(tmp_path / "a") as writer:
        writer.add_topic("/p", POSE)
        data = raw(pose(0, np.arange(7)))
        peaks = []
        tracemalloc.start()
        for part in range(3):
            for i in range(15_000):
                writer.write("/p", data, 0, log_time=part * 10**9 + i)
            peaks.append(tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    assert peaks[2] - peaks[1] < 2_000_000  # between zero and one chunk of 1 MB and its index are waiting
