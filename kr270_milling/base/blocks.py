"""Long series in blocks, so that what is computed on the way to a result does not grow with the series."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator

BLOCK = 65_536  #: rows


def blocks(count: int, size: int = BLOCK) -> Iterator[slice]:
    """All rows of a series of ``count``, ``size`` at a time."""
    return (slice(first, min(first + size, count)) for first in range(0, count, size))


def return_memory() -> None:
    """Give freed memory back to the system, where the C library can (glibc): each thread keeps what it has freed."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
