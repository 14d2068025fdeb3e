"""Errors; ``str(error)`` is one sentence for the user, with the numbers in it.

An error has a separate class only where code catches it alone::

    MillingError            base; exit code 2; the graph of nodes, the command line
      ConfigError           file, key, value, allowed values
      ParameterError        key, value, allowed values; of a record without a file
      InputError            file or option, line
        ProgramError        a program of tool paths (path)
      RecordingError        file, byte
        MessageRefused      one message; the recording continues (recordings)
      MessageError          a message of another node
      ExchangeError         a message out of turn (exchange)
      ModelError            a computation without a result
      ReachError, JointLimitError, SingularityError, UnstableLoadError, DeflectionError, EquilibriumError
                            postures and loads of the arm (physics.robot)
      PassError             an arm that the cut pushes away (physics.motion)
      TrajectoryError, ToolpathError
                            numbers that are no path (path)
      OneFeedError          tests that do not identify a law (studies)
"""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Collection


class MillingError(Exception):
    """Base class of every error that this package raises on purpose; the command line exits with 2 on it."""


_short = reprlib.Repr()
_short.maxlevel, _short.maxstring, _short.maxother, _short.maxlist, _short.maxdict = 3, 100, 100, 8, 4


def _shown(value) -> str:
    """Return the value as text on one line, at most 200 characters."""
    if getattr(value, "ndim", None) == 0:  # a NumPy number
        value = value.item()
    try:
        text = " ".join(map(str.strip, _short.repr(value).splitlines()))
    except ValueError:  # Python does not write out whole numbers of thousands of digits
        return "a number of thousands of digits"
    return text if len(text) <= 200 else text[:197] + "..."


def one_line(text: str) -> str:
    """Escape control characters and line breaks: names and values in messages come from files."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def nearest(word: str, known: Collection[str], otherwise: str = "") -> str:
    """Return "; did you mean NAME?" for the most similar known name; a text otherwise, where no name is similar."""
    near = difflib.get_close_matches(word, known, 1)
    return f"; did you mean {near[0]}?" if near else otherwise


class ParameterError(MillingError):
    """A value that a parameter record refuses.

    key: name of the parameter in a parameter file; value: the refused value in the file's unit; allowed: the allowed
    values as text.
    """

    def __init__(self, key: str, value, allowed: str):
        self.key, self.value, self.allowed = key, value, allowed
        super().__init__(f"{key} is {_shown(value)}, but must be {allowed}")


class ConfigError(MillingError):
    """A parameter file that cannot be used: file, key, value and the allowed values as text."""

    def __init__(self, file, key: str, value, allowed: str):
        self.file, self.key, self.value, self.allowed = str(file), key, value, allowed
        what = f"{self.file}: " + (f"{key}: " if key else "")
        what += f"{_shown(value)} is not usable, it must be {allowed}" if value is not None else allowed
        super().__init__(one_line(what))


class InputError(MillingError):
    """A file or a command-line value that cannot be used; line: the line number in a text file."""

    def __init__(self, source, reason: str, line: int | None = None):
        self.source, self.reason, self.line = str(source), reason, line
        super().__init__(f"{self.source}{'' if line is None else f', line {line}'}: {reason}")


class RecordingError(MillingError):
    """A recording that cannot be written or read; offset: byte of the fault in the file, if known."""

    def __init__(self, path, reason: str, offset: int | None = None):
        self.path, self.reason, self.offset = str(path), reason, offset
        super().__init__(f"{self.path}: {reason}" + ("" if offset is None else f" (at byte {offset})"))


class ModelError(MillingError):
    """A computation without a result: no equilibrium, no convergence, a full grid, too few measurements."""


class MessageError(MillingError):
    """A message that cannot be used; the node reports the error and ignores the message."""
