"""Types of command line options, and the options of a playback for the node and the command ``replay``."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from kr270_milling.recordings.bag.play_options import MOST, PlayOptions

__all__ = ["PLAY", "bounded", "grid", "numbers", "play_options", "stretch"]

CLOCK_RATE = 40.0  # [Hz], of --clock without a number, as in ros2 bag play
MOST_RATE = 1e6  # and of --clock [Hz]


def bounded(low: float, high: float, kind: type = float, above: bool = False):
    """Return a parser of a number from low to high, or above low; NaN is refused. A whole number has digits only."""

    def parse(text: str):
        try:
            value = kind(text)
        except ValueError:
            value = None
        if kind is int and not (text.isascii() and text.lstrip("-").isdecimal()):
            value = None
        if value is None or not low <= value <= high or (above and value == low):
            what = "whole number" if kind is int else "number"
            bounds = f"above {low:g}, at most {high:g}" if above else f"from {low:g} to {high:g}"
            raise argparse.ArgumentTypeError(f"{text!r} is not a {what} {bounds}")
        return value

    return parse


def _floats(text: str, separator: str, count: int) -> list[float]:
    """Return ``count`` finite numbers, or an empty list."""
    try:
        values = [float(word) for word in text.split(separator)]
    except ValueError:
        return []
    return values if len(values) == count and all(map(math.isfinite, values)) else []


def stretch(low: float, high: float):
    """Return a parser of START:STOP, two numbers within bounds, the second above the first."""

    def parse(text: str) -> tuple[float, ...]:
        values = _floats(text, ":", 2)
        if not values or not low <= values[0] < values[1] <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not START:STOP from {low:g} to {high:g}")
        return tuple(values)

    return parse


def numbers(count: int, most: float = math.inf):
    """Return a parser of ``count`` finite numbers of at most ``most``, separated by commas."""

    def parse(text: str) -> list[float]:
        values = _floats(text, ",", count)
        if not values:
            raise argparse.ArgumentTypeError(f"{text!r} is not {count} finite numbers separated by commas")
        if max(map(abs, values)) > most:
            raise argparse.ArgumentTypeError(f"{text!r} goes beyond {most:g}")
        return values

    return parse


def grid(low: float, high: float, most: int):
    """Return a parser of LOW:HIGH:COUNT, two numbers within bounds and the number of values between them."""

    def parse(text: str) -> tuple[float, float, int]:
        ends, _, count = text.rpartition(":")
        values = _floats(ends, ":", 2)
        if not values or not low <= values[0] <= values[1] <= high or not count.strip().isdecimal():
            raise argparse.ArgumentTypeError(f"{text!r} is not LOW:HIGH:COUNT from {low:g} to {high:g}")
        if not 1 <= int(count) <= most:
            raise argparse.ArgumentTypeError(f"{text!r} has a COUNT that is not from 1 to {most}")
        return values[0], values[1], int(count)

    return parse


_ABOVE, _LEAST = bounded(0.0, MOST_RATE, above=True), bounded(0.0, MOST)
#: names and keywords for ``add_argument`` of the options of ``ros2 bag play`` that the player has
PLAY: tuple[tuple[tuple[str, ...], dict], ...] = (
    (("-r", "--rate"), dict(type=_ABOVE, default=1.0, help="how many times as fast as recorded")),
    (("--start-offset",), dict(
        type=_LEAST, default=0.0, metavar="S",
        help="start so many seconds into the recording; latched messages from before come first")),
    (("--playback-duration",), dict(type=_LEAST, metavar="S", help="play so many seconds of the recording")),
    (("-l", "--loop"), dict(action="store_true", help="begin again at the end")),
    (("--topics",), dict(nargs="+", metavar="TOPIC", help="only these")),
    (("-p", "--start-paused"), dict(action="store_true", help="wait for the service ~/resume")),
    (("--clock",), dict(
        type=_ABOVE, nargs="?", const=CLOCK_RATE, metavar="HZ",
        help=f"publish /clock at this rate ({CLOCK_RATE:g} without a number) in place of the recorded one")),
    (("-d", "--delay"), dict(type=_LEAST, default=0.0, metavar="S", help="wait before the playback begins")),
)  # fmt: skip


def play_options(args: argparse.Namespace) -> PlayOptions:
    """Return the options of a playback; args has ``file`` and the options of ``PLAY``."""
    topics = None if args.topics is None else tuple(args.topics)
    return PlayOptions(
        Path(args.file), args.rate, args.start_offset, args.playback_duration, args.loop, topics, args.start_paused,
        args.clock, args.delay,
    )  # fmt: skip
