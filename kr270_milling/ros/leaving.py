"""Leave with the exit code that was earned, whatever the middleware does meanwhile.

Fast DDS now and then blocks a process for ever while partners leave (eProsima/Fast-DDS#6502), and seldom ends with a
segmentation fault. It does so inside of compiled code that holds Python's lock, where no handler and no thread of
Python runs any more. So the clock is one of POSIX (``timer_create`` with SIGEV_THREAD), which calls ``_exit(code)`` in
a thread of its own, and a thread that crashes waits there for that: the handler of the signal is ``pause``.
"""

from __future__ import annotations

import contextlib
import ctypes
import signal
from collections.abc import Iterator

from kr270_milling.base.process import flush

__all__ = ["leaving"]

CRASHES = (signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE)
SIGEV_THREAD = 2  # <bits/sigevent-consts.h>
CLOCK_MONOTONIC = 1  # <time.h>


class _Event(ctypes.Structure):
    """``struct sigevent`` of a 64-bit Linux (64 bytes)."""

    _fields_ = [
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("rest", ctypes.c_byte * 32),
    ]


class _Times(ctypes.Structure):
    """``struct itimerspec``: period and first expiry, each in seconds and nanoseconds."""

    _fields_ = [(name, ctypes.c_long) for name in ("period", "period_ns", "first", "first_ns")]


@contextlib.contextmanager
def leaving(code: int, within: float) -> Iterator[None]:
    """A block in which the middleware is torn down: after ``within`` [s] the process ends with ``code``.

    What is to be told or written has been before. Crashes within the block end the process in the same way.
    """
    flush()
    libc = ctypes.CDLL(None, use_errno=True)
    timer = _arm(libc, code, within)
    if timer is None:  # no such timer here: a signal that nobody handles ends the process at least
        signal.setitimer(signal.ITIMER_REAL, within)
    libc.signal.restype, libc.signal.argtypes = ctypes.c_void_p, (ctypes.c_int, ctypes.c_void_p)
    pause = ctypes.cast(libc.pause, ctypes.c_void_p)
    before = {number: libc.signal(number, pause) for number in CRASHES} if timer is not None else {}
    try:
        yield
    finally:
        for number, handler in before.items():
            libc.signal(number, handler)
        if timer is None:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        else:
            libc.timer_delete(timer)


def _arm(libc, code: int, within: float) -> ctypes.c_void_p | None:
    """A timer that calls ``_exit(code)`` after ``within`` [s]; None where there is none."""
    try:
        libc.timer_create, libc.timer_settime, libc.timer_delete  # noqa: B018 - glibc before 2.34 has them elsewhere
    except AttributeError:
        return None
    event = _Event(value=code, notify=SIGEV_THREAD, function=ctypes.cast(libc._exit, ctypes.c_void_p))  # noqa: SLF001
    timer, seconds = ctypes.c_void_p(), int(within)
    if libc.timer_create(CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)):
        return None
    expiry = _Times(first=seconds, first_ns=round((within - seconds) * 1e9))
    libc.timer_settime(timer, 0, ctypes.byref(expiry), None)
    return timer
