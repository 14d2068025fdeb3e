"""How fast the graph and the recorder are: ``python -m bench``, in this folder's parent."""

from __future__ import annotations

import os
import time

from bench.graph import bench_ros

begun = time.monotonic()
for key, value in bench_ros().items():
    print(f"{key:32} {value}")
print(f"{os.cpu_count()} cores, {time.monotonic() - begun:.1f} s")
