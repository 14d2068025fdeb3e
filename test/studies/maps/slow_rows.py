"""Rows for the tests of the engine, in a file that workers can import."""

from __future__ import annotations

import os
import time


def slow_rows(seconds: float, number: int) -> bytes:
    """What a chunk might hold, after some time."""
    time.sleep(seconds)
    return f"rows of chunk {number}".encode()


def rows_and_maker(number: int) -> bytes:
    """The process that made the chunk."""
    time.sleep(0.2)
    return str(os.getpid()).encode()
