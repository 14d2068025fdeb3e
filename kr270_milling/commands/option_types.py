"""Types of options for argparse: numbers within bounds, stretches of time and bands of frequency."""

from __future__ import annotations

import argparse

__all__ = ["bounded", "stretch"]


def bounded(low: float, high: float, kind: type = float):
    """A number from low to high; NaN is none."""

    def parse(text: str):
        try:
            value = kind(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            what = "whole number" if kind is int else "number"
            raise argparse.ArgumentTypeError(f"{text!r} is not a {what} from {low:g} to {high:g}")
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
