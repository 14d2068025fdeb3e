"""Types of options for argparse: numbers within bounds, stretches of time and bands of frequency."""

from __future__ import annotations

import argparse

__all__ = ["bounded", "stretch"]


def bounded(low: float, high: float, kind: type = float, above: bool = False):
    """A number from low to high, or above low; NaN is none. A whole number has nothing but digits."""

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


def stretch(low: float, high: float):
    """START:STOP, two numbers within bounds, the second above the first."""

    def parse(text: str) -> tuple[float, float]:
        start, _, stop = text.partition(":")
        try:
            found = float(start), float(stop)
        except ValueError:
            found = (1.0, 0.0)
        if not low <= found[0] < found[1] <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not START:STOP from {low:g} to {high:g}")
        return found

    return parse
