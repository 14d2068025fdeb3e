"""What Fast DDS leaves in shared memory when a process is killed; removed as ``fastdds shm clean`` does."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import itertools
import os
import re
import time

__all__ = ["SHARED", "remove_litter"]

SHARED = "/dev/shm/"
WHOLE = re.compile(r"(?:sem\.)?(fastrtps_(?:port\d{1,5}|[0-9a-f]{16}))(?:_el|_sl|_mutex)?")
PORT = re.compile(SHARED + r"(fastrtps_port\d{1,5})\b")
LOCKS = ("_el", "_sl")  # behind the name of a port or segment: locked by its one listener or owner, or by several
SEMAPHORE = 32  # [bytes], sizeof(sem_t) of a 64-bit Linux; another file must not be taken for one
MAKING = 10.0  # [s] of the wall after which whoever makes or opens one has done so, or is dead


def remove_litter() -> list[str]:
    """Remove the ports and segments whose owner is dead; returns the files.

    Fast DDS holds a lock (flock) beside each for as long as its owner lives. The kernel gives it back whatever becomes
    of him, and unlike /proc it also tells of processes in other containers that share /dev/shm. A port may have no
    lock because only senders have opened it, who wait for a listener to come and would never reach one that made it
    anew: such a port stays while a process has it mapped. Whoever opens one holds its mutex, a semaphore. A segment
    without a lock may be in the making while it is young; who has mapped one keeps it when its name goes.
    """
    names = os.listdir(SHARED) if os.path.isdir(SHARED) else []
    found = sorted((match[1], match[0]) for match in map(WHOLE.fullmatch, names) if match)
    removed: list[str] = []
    for whole, group in itertools.groupby(found, lambda pair: pair[0]):
        files = [SHARED + name for _, name in group]
        with contextlib.suppress(OSError), contextlib.ExitStack() as stack:
            if not _is_dead(whole, files, stack):
                continue
            for file in files:
                os.unlink(file)
                removed.append(file)
    return removed


def _mapped_ports() -> set[str]:
    """Names of the ports that a process of this host has mapped, of those that may be looked into."""
    found: set[str] = set()
    for pid in filter(str.isdigit, os.listdir("/proc")):
        with contextlib.suppress(OSError), open(f"/proc/{pid}/maps", errors="replace") as maps:
            found.update(PORT.findall(maps.read()))
    return found


def _is_dead(whole: str, files: list[str], stack: contextlib.ExitStack) -> bool:
    """Whether nobody owns it or opens it any more; it stays so until the stack is closed. Raises OSError."""
    locks = [file for file in files if file.removeprefix(SHARED + whole) in LOCKS]
    if not all(_is_claimed(file, stack) for file in locks):
        return False
    is_port = whole.startswith("fastrtps_port")
    settled = _take_mutex(whole, stack) if is_port else bool(locks)
    if is_port and not locks and whole in _mapped_ports():
        return False
    age = time.time() - max(os.stat(file).st_mtime for file in files)  # noqa: TID251 - of files
    return settled or age > MAKING


def _is_claimed(file: str, stack: contextlib.ExitStack) -> bool:
    """Whether a lock could be taken, and is still the one of this name."""
    lock = os.open(file, os.O_RDONLY | os.O_NOFOLLOW)
    stack.callback(os.close, lock)
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return os.stat(file).st_ino == os.fstat(lock).st_ino


def _take_mutex(port: str, stack: contextlib.ExitStack) -> bool:
    """Whether nobody is about to open the port; then nobody can before the stack is closed."""
    file = f"{SHARED}sem.{port}_mutex"
    if not os.path.exists(file):
        return True
    if os.stat(file).st_size != SEMAPHORE:
        return False
    libc = ctypes.CDLL(None)
    libc.sem_open.restype = ctypes.c_void_p
    semaphore = libc.sem_open(f"/{port}_mutex".encode(), 0)
    if semaphore is None:
        return True
    stack.callback(libc.sem_close, ctypes.c_void_p(semaphore))
    if libc.sem_trywait(ctypes.c_void_p(semaphore)):
        return False
    stack.callback(libc.sem_post, ctypes.c_void_p(semaphore))
    return True
