"""The options of a playback, for the node and for the command ``replay``."""

from __future__ import annotations

from kr270_milling.base.arguments import bounded

__all__ = ["PLAY"]

MOST = 9e9  # [s], 285 years, the largest log time in nanoseconds
CLOCK_RATE = 40.0  # [Hz], of --clock without a number, as in ros2 bag play
_ABOVE, _LEAST = bounded(0.0, 1e6, above=True), bounded(0.0, MOST)
#: names and keywords for ``add_argument`` of the options of ``ros2 bag play`` that the player has
PLAY: tuple[tuple[tuple[str, ...], dict], ...] = (
    (("-r", "--rate"), dict(type=_ABOVE, default=1.0, help="how many times as fast as recorded")),
    (("--start-offset",), dict(
        type=_LEAST, default=0.0, metavar="S",
        help="start so many seconds into the recording; latched messages from before come first")),
    (("--playback-duration",), dict(type=_LEAST, metavar="S", help="play so many seconds of the recording")),
    (("--topics",), dict(nargs="+", metavar="TOPIC", help="only these")),
    (("-p", "--start-paused"), dict(action="store_true", help="wait for the service ~/resume")),
    (("--clock",), dict(
        type=_ABOVE, nargs="?", const=CLOCK_RATE, metavar="HZ",
        help=f"publish /clock at this rate ({CLOCK_RATE:g} without a number) in place of the recorded one")),
)  # fmt: skip
