"""End this process: exit codes, and an exit without Python's finalisation."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from typing import NoReturn

__all__ = ["STOPS", "end_process", "exit_code", "flush"]

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
