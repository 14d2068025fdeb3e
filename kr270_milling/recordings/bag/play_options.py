"""Options of a playback; a small module, which the command line imports for its help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = ["MOST", "PlayOptions"]

MOST = 9e9  # [s], 285 years, the largest log time in nanoseconds


@dataclass(frozen=True)
class PlayOptions:
    """Options of one playback."""

    file: Path
    rate: float = 1.0
    start_offset: float = 0.0  #: [s]
    playback_duration: float | None = None  #: [s]; None: to the end
    topics: tuple[str, ...] | None = None  #: None: all
    start_paused: bool = False
    clock: float | None = None  #: [Hz]
