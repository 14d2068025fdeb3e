"""Types of options for argparse: numbers within bounds, lists of them, stretches of time and bands of frequency."""

from __future__ import annotations

import argparse
import math

__all__ = ["bounded", "grid", "numbers", "stretch"]


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


def numbers(count: int, most: float = math.inf):
    """So many finite numbers of at most that size, separated by commas."""

    def parse(text: str) -> list[float]:
        try:
            values = [float(v) for v in text.split(",")]
        except ValueError:
            values = []
        if len(values) != count or not all(map(math.isfinite, values)):
            raise argparse.ArgumentTypeError(f"{text!r} is not {count} finite numbers separated by commas")
        if max(map(abs, values)) > most:
            raise argparse.ArgumentTypeError(f"{text!r} goes beyond {most:g}")
        return values

    return parse


def grid(low: float, high: float, most: int):
    """LOW:HIGH:COUNT, two numbers within bounds and how many values there are from one to the other."""

    def parse(text: str) -> tuple[float, float, int]:
        try:
            first, last, count = text.split(":")
            found = float(first), float(last), int(count)
        except ValueError:
            found = (math.nan, math.nan, 0)
        if not (low <= found[0] <= found[1] <= high and 1 <= found[2] <= most):
            raise argparse.ArgumentTypeError(f"{text!r} is not LOW:HIGH:COUNT from {low:g} to {high:g}")
        return found

    return parse
