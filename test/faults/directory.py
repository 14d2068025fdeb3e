"""The output directory of a self test."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

from kr270_milling.live.graph.plan import fresh_directory

__all__ = ["output_directory"]


@contextlib.contextmanager
def output_directory(out: str | None) -> Iterator[Path]:
    """A directory of the user's, in which nothing is overwritten, or one that is removed at the end."""
    if out is None:
        with tempfile.TemporaryDirectory(prefix="kr270_milling_") as directory:
            yield Path(directory)
        return
    directory = fresh_directory(out)
    (directory / "cell.yaml").touch()  # the next run finds that this one is taken
    yield directory
