"""What Fast DDS leaves in shared memory when a process is killed; removed as ``fastdds shm clean`` does."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import re
import time

__all__ = ["SHARED", "remove_litter"]

SHARED = "/dev/shm/"
WHOLE = re.compile(r"(?:sem\.)?(fastrtps_(?:port\d{1,5}|[0-9a-f]{16}))(?:_el|_sl|_mutex)?")
LOCKS = ("_el", "_sl")  # behind the name of a port or segment: locked by its one listener or owner, or by several
MAKING = 10.0  # [s] of the wall in which whoever makes a port or segment has locked it as well


def remove_litter() -> list[str]:
    """Remove the ports and segments whose owner is dead; returns the files.

    Fast DDS holds a lock (flock) beside each for as long as its owner lives. The kernel gives it back whatever becomes
    of him, and unlike /proc it also tells of processes in other containers that share /dev/shm. One without a lock
    may be in the making, and is left alone while it is young. Who has mapped a file keeps it when its name goes.
    """
    names = os.listdir(SHARED) if os.path.isdir(SHARED) else []
    found = sorted((match[1], match[0]) for match in map(WHOLE.fullmatch, names) if match)
    removed: list[str] = []
    for whole, group in itertools.groupby(found, lambda pair: pair[0]):
        files = [SHARED + name for _, name in group]
        with contextlib.suppress(OSError), contextlib.ExitStack() as stack:
            if not _is_dead(files, [SHARED + whole + kind for kind in LOCKS], stack):
                continue
            for file in files:
                os.unlink(file)
                removed.append(file)
    return removed


def _is_dead(files: list[str], locks: list[str], stack: contextlib.ExitStack) -> bool:
    """Whether nobody owns it any more; it stays so until the stack is closed. Raises OSError."""
    there = [file for file in files if file in locks]
    if there:
        return all(_is_claimed(file, stack) for file in there)
    return time.time() - max(os.stat(file).st_mtime for file in files) > MAKING  # noqa: TID251 - the age of a file


def _is_claimed(file: str, stack: contextlib.ExitStack) -> bool:
    """Whether a lock could be taken, and is still the one of this name."""
    lock = os.open(file, os.O_RDONLY | os.O_NOFOLLOW)
    stack.callback(os.close, lock)
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return os.stat(file).st_ino == os.fstat(lock).st_ino
