"""Errors that carry their numbers; ``str(error)`` is one sentence for the user."""

__all__ = ["MillingError", "ParameterError", "ConfigError", "InputError"]


class MillingError(Exception):
    """Base class of every error that this package raises on purpose; the command line exits with 2 on it."""


class ParameterError(MillingError):
    """A value that its record refuses.

    key: the parameter's name as it stands in a parameter file; value: what was given, in the file's unit;
    allowed: what would have been right.
    """

    def __init__(self, key: str, value, allowed: str):
        self.key, self.value, self.allowed = key, value, allowed
        super().__init__(f"{key} is {value!r}, but must be {allowed}")


class ConfigError(MillingError):
    """A parameter file that cannot be used: which file, which key, what it says, what would have been right."""

    def __init__(self, file, key: str, value, allowed: str):
        self.file, self.key, self.value, self.allowed = str(file), key, value, allowed
        what = f"{self.file}: " + (f"{key}: " if key else "")
        super().__init__(what + (f"{value!r} is not usable, it must be {allowed}" if value is not None else allowed))


class InputError(MillingError):
    """A file or a command-line value that cannot be used; line is the line number where there is one."""

    def __init__(self, source, reason: str, line: int | None = None):
        self.source, self.reason, self.line = str(source), reason, line
        super().__init__(f"{self.source}{'' if line is None else f', line {line}'}: {reason}")
