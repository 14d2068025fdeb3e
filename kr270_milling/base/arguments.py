"""Command line of a process: parser, types of options, options of a playback, exit codes and the end."""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import signal
import sys
from collections.abc import MutableMapping
from typing import NoReturn

from kr270_milling.base.errors import MillingError, nearest


def one_thread_each(environment: MutableMapping[str, str]) -> None:
    """Let the linear algebra of a process use one thread, unless its user says otherwise; before NumPy is imported.

    The matrices are small, and threads of OpenBLAS that wait spin: the depth limits of a program of 7 hours take 2.8 s
    of a processor with one thread, 19 to 21 s with two.
    """
    for library in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        environment.setdefault(library, "1")


class Parser(argparse.ArgumentParser):
    """A parser that raises MillingError with one sentence instead of printing its usage."""

    def error(self, message: str):
        sentence = message.removeprefix("argument ").replace("the following arguments are required:", "needs")
        raise MillingError(f"{sentence} ({self.prog} --help)")

    def parse_args(self, args=None, namespace=None):
        """Parse every word; an unknown option is answered by the nearest one of the command that was chosen."""
        parsed, unknown = self.parse_known_args(args, namespace)
        chosen = getattr(parsed, "parser", self)
        for word in unknown:
            if word.startswith("-"):
                name = word.partition("=")[0]
                chosen.error(f"there is no option {name}{nearest(name, chosen.option_names)}")
        if unknown:
            chosen.error(f"{unknown[0]!r} is one argument too many")
        return parsed

    @property
    def option_names(self) -> list[str]:
        return [name for action in self._actions for name in action.option_strings]

    def show_defaults(self) -> None:
        """End the help of each option with its default, unless that is nothing or a list, or the help states it."""
        for action in self._actions:
            default = action.default
            if isinstance(default, (int, float, str)) and default not in (False, "", argparse.SUPPRESS):
                shown = f"{default:g}" if isinstance(default, float) else default
                action.help = f"{action.help}{'' if 'default' in (action.help or '') else f' (default: {shown})'}"

    def _check_value(self, action, value):
        if action.choices is None or value in action.choices:
            return
        near = nearest(str(value), action.choices)
        if action.nargs == argparse.PARSER:
            raise argparse.ArgumentError(None, f"there is no command {value!r}{near}")
        raise argparse.ArgumentError(action, f"{value!r} is not one of {', '.join(action.choices)}{near}")


def bounded(low: float, high: float, kind: type = float, above: bool = False):
    """Return a parser of a number from low to high, or above low; NaN is refused. A whole number has digits only."""
    what = "whole number" if kind is int else "number"
    bounds = f"above {low:.10g}, at most {high:.10g}" if above else f"from {low:.10g} to {high:.10g}"

    def parse(text: str):
        plain = kind is float or (text.isascii() and text.lstrip("-").isdecimal())
        try:
            value = kind(text) if plain else math.nan
        except ValueError:
            value = math.nan
        if not low <= value <= high or (above and value == low):
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


def numbers(count: int, most: float = math.inf):
    """Return a parser of ``count`` finite numbers of at most ``most``, separated by commas."""

    def parse(text: str) -> list[float]:
        values = _floats(text, ",", count)
        if not values or max(map(abs, values)) > most:
            limit = "" if math.isinf(most) else f" of at most {most:.10g}"
            raise argparse.ArgumentTypeError(f"{text!r} is not {count} finite numbers{limit} separated by commas")
        return values

    return parse


def stretch(low: float, high: float):
    """Return a parser of START:STOP, two numbers within bounds, the second above the first."""

    def parse(text: str) -> tuple[float, ...]:
        values = _floats(text, ":", 2)
        if not values or not low <= values[0] < values[1] <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not START:STOP from {low:.10g} to {high:.10g}")
        return tuple(values)

    return parse


def words(*known: str):
    """Return a parser of words that are separated by commas, each one of ``known``."""

    def parse(text: str) -> tuple[str, ...]:
        for word in text.split(","):
            if word not in known:
                allowed = f"is not {'one of ' if len(known) > 1 else ''}{', '.join(known)}"
                raise argparse.ArgumentTypeError(f"{word!r} {allowed}{nearest(word, known)}")
        return tuple(text.split(","))

    return parse


def grid(low: float, high: float, most: int):
    """Return a parser of LOW:HIGH/COUNT, two numbers within bounds and the number of values; a number is itself."""

    def parse(text: str) -> tuple[float, float, int]:
        ends, _, count = (f"{text}:{text}/1" if _floats(text, ":", 1) else text).rpartition("/")
        values = _floats(ends, ":", 2)
        if not values or not low <= values[0] <= values[1] <= high or not count.strip().isdecimal():
            before, _, last = text.rpartition(":")
            advice = f": write {before}/{last}" if _floats(before, ":", 2) and last.isdecimal() else ""
            raise argparse.ArgumentTypeError(f"{text!r} is not LOW:HIGH/COUNT from {low:.10g} to {high:.10g}{advice}")
        if not 1 <= int(count) <= most:
            raise argparse.ArgumentTypeError(f"{text!r} has a COUNT that is not from 1 to {most}")
        return values[0], values[1], int(count)

    return parse


#: signals that end a process in order; a terminal that closes sends SIGHUP, which nohup ignores
STOPS = (signal.SIGINT, signal.SIGTERM, *[signal.SIGHUP][: signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN])


def exit_code(error: BaseException | None) -> int:
    """Return the exit code of a process that ends with this error; 0 for None."""
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(error.code is not None)
    if isinstance(error, KeyboardInterrupt):
        return 128 + signal.SIGINT
    return 0 if error is None else 2


def end_process(code: int) -> NoReturn:
    """Flush the outputs and end this process without Python's finalisation.

    During finalisation static objects of a middleware can crash, and an interrupt in compiled code replaces the exit
    code by SIGINT.
    """
    flush()
    os._exit(code)


def flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # the reader has ended, or the stream is closed
            stream.flush()


CLOCK_RATE = 40.0  # [Hz], of --clock without a number, as in ros2 bag play
_ABOVE, _LEAST = bounded(0.0, 1e6, above=True), bounded(0.0, 9e9)  # [s], 285 years, the largest log time in ns
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
