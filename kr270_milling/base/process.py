"""The end of this process: exit codes, and an exit without Python's finalisation."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from typing import NoReturn

__all__ = ["end_process", "exit_code", "flush"]


def exit_code(error: BaseException | None) -> int:
    """Of a process that an error is about to end; 0 without one."""
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(error.code is not None)
    if isinstance(error, KeyboardInterrupt):
        return 128 + signal.SIGINT
    return 0 if error is None else 2


def end_process(code: int) -> NoReturn:
    """End without Python's own finalisation.

    In it the static objects of a middleware could still crash, and an interrupt within compiled code turns any exit
    code into a death by SIGINT.
    """
    flush()
    os._exit(code)


def flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # a reader that has gone, a stream that is closed
            stream.flush()
